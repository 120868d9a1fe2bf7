"""The verification policy: which suites a chart version has to pass before it counts as verified.

    policies/verification.yaml          kind VerificationPolicy, in the sources and in the catalogue repository

The policy's digest stands in every piece of evidence: a changed policy invalidates all evidence under the old one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.foundation.documents.core.entry_reader import EntryReader
from robotkube.foundation.documents.core.patterns import IMAGE_BY_DIGEST, NAME, SUITE_NAME, SUITE_VERSION
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping

API = "registry.robotkube.io/v1alpha1"
KIND = "VerificationPolicy"
PATH = "policies/verification.yaml"
PLATFORM_SUITES = ("static", "images", "interface", "install")  # the others bring their own image
PLAIN_SUITES = ("static", "images")  # they need no test namespace, and come first
SUMMARY = "summary"  # the name of the summary's file next to those of the suites
SUITES_MAX = 16
SECONDS_MAX = 3600
SOAK_SECONDS = 60
MEMORY_GROWTH_PERCENT = 10
SOAK_KEYS = ("soakSeconds", "memoryGrowthPercent")
SOAKING = "install"  # the suite that soaks
COMMAND_WORDS_MAX = 32
COMMAND_CHARACTERS_MAX = 1024


@dataclass(frozen=True)
class SuiteRule:
    """One suite that has to pass. `seconds` bounds a run; a user's own suite names the `image` (by digest) that is
    the suite and perhaps its `command`; `installs`: it needs the chart installed. `soak_seconds`: how long the suite
    `install` keeps the chart running under traffic, `memory_growth_percent`: how much of its memory limit a container
    may grow meanwhile."""

    name: str
    version: str
    seconds: int
    image: str = ""
    command: tuple[str, ...] = ()
    installs: bool = False
    soak_seconds: int = 0
    memory_growth_percent: int = 0


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
    rule = reader.mapping(value, path, ["name", "version", "seconds"], ["image", "command", "installs", *SOAK_KEYS])
    name = reader.word(rule.get("name"), f"{path}.name", SUITE_NAME)
    if name == SUMMARY:
        reader.problems.append(f"{path}.name: {SUMMARY!r} is taken; choose another")
    if rule.get("version") is not None and not isinstance(rule["version"], str):
        reader.problems.append(f"{path}.version: must be text; put it in quotes")
    return SuiteRule(
        name=name,
        version=reader.word(str(rule.get("version", "")), f"{path}.version", SUITE_VERSION),
        seconds=_seconds(reader, rule.get("seconds"), f"{path}.seconds"),
        image=_image(reader, name, rule, path),
        command=_command(reader, rule.get("command"), f"{path}.command"),
        installs=_installs(reader, rule.get("installs", False), f"{path}.installs"),
        soak_seconds=_soak_seconds(reader, name, rule, path),
        memory_growth_percent=_memory_growth_percent(reader, name, rule, path),
    )


def _seconds(reader: Reader, value: Any, path: str) -> int:
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= SECONDS_MAX:
        return value
    reader.problems.append(f"{path}: must be whole seconds from 1 to {SECONDS_MAX}")
    return 0


def _soak_seconds(reader: Reader, name: str, rule: Mapping[str, Any], path: str) -> int:
    """At most half of a run's time: the rest is for starting, stopping and upgrading."""
    if name != SOAKING:
        reader.problems += [f"{path}.soakSeconds: only {SOAKING} soaks; remove it"] if "soakSeconds" in rule else []
        return 0
    seconds = rule.get("seconds")
    most = seconds // 2 if isinstance(seconds, int) and not isinstance(seconds, bool) else SECONDS_MAX // 2
    value = rule.get("soakSeconds", min(SOAK_SECONDS, most))
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most:
        return value
    reader.problems.append(f"{path}.soakSeconds: must be whole seconds from 0 to {most}, half of `seconds`")
    return 0


def _memory_growth_percent(reader: Reader, name: str, rule: Mapping[str, Any], path: str) -> int:
    where = f"{path}.memoryGrowthPercent"
    if name != SOAKING:
        reader.problems += [f"{where}: only {SOAKING} soaks; remove it"] if "memoryGrowthPercent" in rule else []
        return 0
    value = rule.get("memoryGrowthPercent", MEMORY_GROWTH_PERCENT)
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= 100:
        return value
    reader.problems.append(f"{where}: must be a whole number from 1 to 100, a share of the memory limit")
    return 0


def _image(reader: Reader, name: str, rule: Mapping[str, Any], path: str) -> str:
    own = [key for key in ("image", "command", "installs") if key in rule]
    if name in PLATFORM_SUITES:
        reader.problems += [f"{path}.{key}: {name} is a suite of the platform; remove it" for key in own]
        return ""
    if "image" not in rule:
        reader.problems.append(
            f"{path}.image: missing; {name!r} is not one of {', '.join(PLATFORM_SUITES)}, so it names its own image"
        )
        return ""
    return reader.word(rule["image"], f"{path}.image", IMAGE_BY_DIGEST)


def _command(reader: Reader, value: Any, path: str) -> tuple[str, ...]:
    words = reader.sequence(value, path)
    if len(words) > COMMAND_WORDS_MAX or sum(len(str(word)) for word in words) > COMMAND_CHARACTERS_MAX:
        reader.problems.append(f"{path}: at most {COMMAND_WORDS_MAX} words and {COMMAND_CHARACTERS_MAX} characters")
    return tuple(reader.prose(word, f"{path}[{index}]") for index, word in enumerate(words[:COMMAND_WORDS_MAX]))


def _installs(reader: Reader, value: Any, path: str) -> bool:
    if not isinstance(value, bool):
        reader.problems.append(f"{path}: must be true or false")
    return value is True
