"""Versions of charts: as their sources describe them, and with the status that the gate writes when it publishes them;
and the images that a release of one may run: those that were verified with it, and nothing else."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.entry_reader import EntryReader, read_one_of, read_words
from robotkube.foundation.documents.core.patterns import (
    CAPABILITY,
    DIGEST,
    DOCUMENTS_CACHED_MAX,
    IMAGE_BY_DIGEST,
    NAME,
    VERSION,
)
from robotkube.foundation.documents.core.quantities import CPU, MEMORY
from robotkube.foundation.documents.core.reader import Reader
from robotkube.registry.catalogue.core.entries import read_description, read_head
from robotkube.registry.catalogue.core.guarantees import Guarantee, read_guarantees
from robotkube.registry.catalogue.core.interface_declarations import read_interfaces, read_suites
from robotkube.registry.catalogue.core.success.measures import SuccessMeasure, read_success
from robotkube.registry.charts.core.packing import published_digest
from robotkube.registry.charts.core.references import ChartReference

STATES = ("staged", "verified", "withdrawn")
CHANNELS = ("stable", "candidate")
PLATFORMS = ("linux/amd64", "linux/arm64")
WATCHED, RESTART = "watched", "restart"
SETTINGS = (WATCHED, RESTART)
"""How a chart's process takes changed settings: it follows its ConfigMap, or its pod is replaced."""
NO_EVIDENCE = "its evidence was not assessed"

_RESOURCES = {"cpu": CPU, "memory": MEMORY}
_OPTIONAL = (
    "settings", "provides", "replaces", "skips", "resources", "guarantees", "interfaces", "suites", "success",
)  # fmt: skip


@dataclass(frozen=True)
class ChartVersion:
    """One version of a chart.

    `state` and `digest` (OCI manifest digest) are empty in a source; `images` are names, `image_references` what the
    published status pins. `evidence` is the digest of the summary's envelope and `policy` that of its policy, as the
    status says it; `assured` only when that evidence was checked, else `evidence_problem` says what is missing;
    `findings` is what each suite found, and which key signed it.
    `settings` is one of SETTINGS, empty when the entry says nothing. `interfaces` and `suites` are written as
    templates over the chart's values. `entry` is the digest of everything that a published entry says
    (`packing.published_digest`).
    """

    chart: str
    version: str
    state: str
    digest: str
    description: str = ""
    channel: str = "stable"
    platforms: tuple[str, ...] = ()
    images: tuple[str, ...] = ()
    settings: str = ""
    provides: tuple[str, ...] = ()
    replaces: str = ""
    skips: tuple[str, ...] = ()
    resources: Mapping[str, str] = field(default_factory=dict)
    guarantees: tuple[Guarantee, ...] = ()
    interfaces: tuple[Mapping[str, Any], ...] = ()
    suites: Mapping[str, Any] = field(default_factory=dict)
    success: SuccessMeasure | None = None
    image_references: tuple[str, ...] = ()
    evidence: str = ""
    policy: str = ""
    entry: str = ""
    assured: bool = False
    evidence_problem: str = NO_EVIDENCE
    findings: tuple[Mapping[str, Any], ...] = ()

    @property
    def reference(self) -> ChartReference:
        """The version as trailers name it."""
        return ChartReference(self.chart, self.version, self.digest)


def is_compared(version: ChartVersion, assurance: str) -> bool:
    """Return whether the images of its releases are compared with those of the entry. One that names none, where
    nothing has to be verified, may run any."""
    return bool(version.image_references) or assurance != "none"


def coverage_problems(version: ChartVersion, images: Iterable[str]) -> Iterable[str]:
    """A sentence for each of `images` that was not verified with the version, which the signature over its entry
    covers. What counts is the digest: the same image may come from elsewhere."""
    covered = {_digest(reference) for reference in version.image_references}
    listed = ", ".join(version.image_references) or "none"
    for image in images:
        if _digest(image) not in covered:
            yield (
                f"a pod would run image {image or '(none)'}, which was not verified with chart {version.reference} "
                f"(images: {listed}); leave out the values that name an image, or publish a version with this one"
            )


def _digest(reference: str) -> str:
    """What an image reference pins; the reference itself, which nothing covers, when it pins nothing."""
    return reference.rpartition("@")[2]


def read_chart_version(text: str, path: str, published: bool = True) -> ChartVersion:
    """The chart version in `text`; its path says chart and version. DocumentError names every problem.

    `published`: it comes from the catalogue repository and must have a status; a source must not have one."""
    version, problems = read_chart_version_partly(text, path, published)
    if problems:
        raise DocumentError(path, problems)
    return version


@lru_cache(DOCUMENTS_CACHED_MAX)
def read_chart_version_partly(text: str, path: str, published: bool) -> tuple[ChartVersion, tuple[str, ...]]:
    """The chart version as far as it can be read, and every problem: what has one is empty. DocumentError when the text
    is no mapping in YAML."""
    reader = EntryReader(path)
    document, chart = read_head(reader, text, "ChartVersion", ["status"])
    spec = reader.mapping(
        document.get("spec") or {}, "spec", ["version", "description", "channel", "platforms", "images"], _OPTIONAL
    )
    version = reader.word(spec.get("version"), "spec.version", VERSION)
    if chart and version:
        reader.equal(path, "path", f"charts/{chart}/{version}.yaml")
    attributes = {**_spec(reader, spec), **_status(reader, document, published)}
    _suite_images(reader, attributes["images"], attributes["suites"])
    entry = published_digest(spec, attributes["image_references"]) if published and not reader.problems else ""
    return ChartVersion(chart, version, entry=entry, **attributes), tuple(reader.problems)


def _spec(reader: Reader, spec: Mapping[str, Any]) -> dict[str, Any]:
    version = spec.get("version")
    attributes = {
        "description": read_description(reader, spec.get("description"), "spec.description"),
        "channel": read_one_of(reader, spec.get("channel"), "spec.channel", CHANNELS),
        "platforms": tuple(
            read_one_of(reader, word, f"spec.platforms[{index}]", PLATFORMS)
            for index, word in enumerate(reader.sequence(spec.get("platforms"), "spec.platforms"))
        ),
        "images": read_words(reader, spec.get("images"), "spec.images", NAME),
        "settings": read_one_of(reader, spec["settings"], "spec.settings", SETTINGS) if "settings" in spec else "",
        "provides": read_words(reader, spec.get("provides"), "spec.provides", CAPABILITY),
        "replaces": reader.word(spec.get("replaces"), "spec.replaces", VERSION, default=""),
        "skips": read_words(reader, spec.get("skips"), "spec.skips", VERSION),
        "resources": _resources(reader, spec.get("resources")),
        "guarantees": read_guarantees(reader, spec.get("guarantees"), "spec.guarantees"),
        "interfaces": read_interfaces(reader, spec.get("interfaces"), "spec.interfaces"),
        "suites": read_suites(reader, spec.get("suites"), "spec.suites"),
        "success": read_success(reader, spec["success"]) if "success" in spec else None,
    }
    if "platforms" in spec and not attributes["platforms"]:
        reader.problems.append("spec.platforms: must name at least one platform")
    if version and version == attributes["replaces"]:
        reader.problems.append(f"spec.replaces: {version} is this version itself; name the one before it")
    return attributes


def _resources(reader: Reader, value: Any) -> Mapping[str, str]:
    if value is None:
        return {}
    resources = reader.mapping(value, "spec.resources", list(_RESOURCES))
    return {key: reader.word(resources.get(key), f"spec.resources.{key}", form) for key, form in _RESOURCES.items()}


def _suite_images(reader: Reader, images: tuple[str, ...], suites: Mapping[str, Any]) -> None:
    sets = suites.get("sets")
    for index, item in enumerate(sets if isinstance(sets, list) else []):
        prepare = item.get("prepare") if isinstance(item, Mapping) else None
        image = prepare.get("image") if isinstance(prepare, Mapping) else None
        if isinstance(image, str) and image not in images:
            reader.problems.append(f"spec.suites.sets[{index}].prepare.image: {image!r} is not among spec.images")


def _status(reader: Reader, document: Mapping[str, Any], published: bool) -> dict[str, Any]:
    if not published:
        if "status" in document:
            reader.problems.append("status: is written by the gate when it publishes; remove it from the source")
        return {"state": "", "digest": ""}
    status = reader.mapping(
        document.get("status") or {}, "status", ["state", "digest"], ["images", "evidence", "policy"]
    )
    return {
        "state": read_one_of(reader, status.get("state"), "status.state", STATES),
        "digest": reader.text(status.get("digest"), "status.digest", DIGEST),
        "image_references": read_words(reader, status.get("images"), "status.images", IMAGE_BY_DIGEST),
        "evidence": reader.word(status.get("evidence"), "status.evidence", DIGEST, default=""),
        "policy": reader.word(status.get("policy"), "status.policy", DIGEST, default=""),
    }
