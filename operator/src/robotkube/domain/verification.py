"""The verification policy: which suites a chart version has to pass before it counts as verified.

    policies/verification.yaml          kind VerificationPolicy, in the sources and in the catalogue repository

The policy's digest stands in every piece of evidence: a changed policy makes all evidence under the old one doubtful.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from robotkube.domain.catalogue_entries import EntryReader
from robotkube.domain.charts_packing import canonical_json, sha256
from robotkube.domain.documents import Reader
from robotkube.domain.releases import NAME
from robotkube.domain.texts import read_mapping

API = "registry.robotkube.io/v1alpha1"
KIND = "VerificationPolicy"
PATH = "policies/verification.yaml"
PLATFORM_SUITES = ("static", "images", "interface", "install")  # the others bring their own image
SUMMARY = "summary"  # the name of the summary's file beside those of the suites
SUITES_MAX = 16
SECONDS_MAX = 3600
COMMAND_WORDS_MAX = 32
COMMAND_CHARACTERS_MAX = 1024

SUITE_NAME = re.compile(r"[a-z]([a-z0-9-]{0,38}[a-z0-9])?", re.ASCII)
SUITE_VERSION = re.compile(r"[0-9A-Za-z][0-9A-Za-z._-]{0,31}", re.ASCII)
IMAGE = re.compile(r"[A-Za-z0-9][A-Za-z0-9./:_-]{0,254}@sha256:[0-9a-f]{64}", re.ASCII)


@dataclass(frozen=True)
class SuiteRule:
    """One suite that has to pass. `seconds` bounds a run; a user's own suite names the `image` (by digest) that is
    the suite and perhaps its `command`; `installs`: it needs the chart installed."""

    name: str
    version: str
    seconds: int
    image: str = ""
    command: tuple[str, ...] = ()
    installs: bool = False


@dataclass(frozen=True)
class VerificationPolicy:
    """The suites in the order in which they run; `digest` (`sha256:<hex>`) is that of the spec as canonical JSON."""

    name: str
    suites: tuple[SuiteRule, ...]
    digest: str

    def rule(self, suite: str) -> SuiteRule | None:
        """The rule of a suite; None when the policy does not ask for it."""
        return next((rule for rule in self.suites if rule.name == suite), None)


@lru_cache(16)
def read_verification_policy(text: str, path: str = PATH) -> VerificationPolicy:
    """The policy in `text`; DocumentError names every problem with its key."""
    reader = EntryReader(path)
    document = reader.mapping(read_mapping(text, path), "", ["apiVersion", "kind", "metadata", "spec"])
    reader.equal(document.get("apiVersion"), "apiVersion", API)
    reader.equal(document.get("kind"), "kind", KIND)
    metadata = reader.mapping(document.get("metadata") or {}, "metadata", ["name"])
    spec = reader.mapping(document.get("spec") or {}, "spec", ["suites"])
    name = reader.word(metadata.get("name"), "metadata.name", NAME)
    listed = reader.sequence(spec.get("suites"), "spec.suites")
    if not 1 <= len(listed) <= SUITES_MAX:
        reader.problems.append(f"spec.suites: must list 1 to {SUITES_MAX} suites, not {len(listed)}")
    suites = tuple(_rule(reader, value, f"spec.suites[{index}]") for index, value in enumerate(listed[:SUITES_MAX]))
    names = [rule.name for rule in suites]
    reader.problems += [f"spec.suites: name {n!r} stands twice" for n in sorted(set(names)) if names.count(n) > 1]
    reader.finish()
    return VerificationPolicy(name, suites, sha256(canonical_json(spec)))


def _rule(reader: Reader, value: Any, path: str) -> SuiteRule:
    found = reader.mapping(value, path, ["name", "version", "seconds"], ["image", "command", "installs"])
    name = reader.word(found.get("name"), f"{path}.name", SUITE_NAME)
    if name == SUMMARY:
        reader.problems.append(f"{path}.name: {SUMMARY!r} is taken; choose another")
    if found.get("version") is not None and not isinstance(found["version"], str):
        reader.problems.append(f"{path}.version: must be text; put it in quotes")
    return SuiteRule(
        name=name,
        version=reader.word(str(found.get("version", "")), f"{path}.version", SUITE_VERSION),
        seconds=_seconds(reader, found.get("seconds"), f"{path}.seconds"),
        image=_image(reader, name, found, path),
        command=_command(reader, found.get("command"), f"{path}.command"),
        installs=_installs(reader, found.get("installs", False), f"{path}.installs"),
    )


def _seconds(reader: Reader, value: Any, path: str) -> int:
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= SECONDS_MAX:
        return value
    reader.problems.append(f"{path}: must be whole seconds from 1 to {SECONDS_MAX}")
    return 0


def _image(reader: Reader, name: str, found: Mapping[str, Any], path: str) -> str:
    own = [key for key in ("image", "command", "installs") if key in found]
    if name in PLATFORM_SUITES:
        reader.problems += [f"{path}.{key}: {name} is a suite of the platform; remove it" for key in own]
        return ""
    if "image" not in found:
        reader.problems.append(
            f"{path}.image: missing; {name!r} is not one of {', '.join(PLATFORM_SUITES)}, so it names its own image"
        )
        return ""
    return reader.word(found["image"], f"{path}.image", IMAGE)


def _command(reader: Reader, value: Any, path: str) -> tuple[str, ...]:
    words = reader.sequence(value, path)
    if len(words) > COMMAND_WORDS_MAX or sum(len(str(word)) for word in words) > COMMAND_CHARACTERS_MAX:
        reader.problems.append(f"{path}: at most {COMMAND_WORDS_MAX} words and {COMMAND_CHARACTERS_MAX} characters")
    return tuple(reader.prose(word, f"{path}[{index}]") for index, word in enumerate(words[:COMMAND_WORDS_MAX]))


def _installs(reader: Reader, value: Any, path: str) -> bool:
    if not isinstance(value, bool):
        reader.problems.append(f"{path}: must be true or false")
    return value is True
