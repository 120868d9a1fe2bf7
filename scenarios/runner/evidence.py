"""Whether every release that ran had evidence: its annotation names a verification summary that the catalogue holds,
and that summary is about exactly the digest that ran."""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from scenarios.runner.inputs import ReleasedChart, RunInputs

SUMMARY = "summary.json"


@dataclass(frozen=True)
class Entry:
    """A chart as it ran, the evidence that its releases named, and whether the catalogue has it for this digest."""

    chart: str
    version: str
    digest: str
    evidence: str
    releases: tuple[str, ...]
    found: bool

    def row(self) -> Mapping[str, object]:
        """The entry by the names of the report."""
        return {**vars(self), "releases": list(self.releases)}


def entries(inputs: RunInputs) -> tuple[Entry, ...]:
    """One entry per chart, digest and evidence, by name."""
    grouped = groupby(sorted(set(inputs.released)), lambda one: (one.chart, one.version, one.digest, one.evidence))
    return tuple(_entry(list(released), inputs.summaries) for _, released in grouped)


def _entry(released: Sequence[ReleasedChart], summaries: Mapping[str, str]) -> Entry:
    first, releases = released[0], tuple(one.release for one in released)
    found = bool(first.digest) and summaries.get(first.evidence) == first.digest
    return Entry(first.chart, first.version, first.digest, first.evidence, releases, found)


def complete(inputs: RunInputs) -> bool | None:
    """Whether every entry has its evidence; None when no release was seen."""
    found = entries(inputs)
    return all(entry.found for entry in found) if found else None


def summaries(files: Mapping[str, bytes]) -> dict[str, str]:
    """Digest of each summary's envelope -> digest of the chart it is about; what cannot be read is about nothing."""
    return {
        f"sha256:{hashlib.sha256(data).hexdigest()}": _subject(data)
        for path, data in files.items()
        if path.rpartition("/")[2] == SUMMARY
    }


def _subject(envelope: bytes) -> str:
    try:
        statement = json.loads(base64.b64decode(json.loads(envelope)["payload"], validate=True))
        [subject] = statement["subject"]
        return f"sha256:{subject['digest']['sha256']}"
    except (ValueError, TypeError, KeyError, RecursionError, binascii.Error):
        return ""


def released(documents: Iterable[tuple[str, object]]) -> tuple[ReleasedChart, ...]:
    """The charts of release files: pairs of `<namespace>/<release>` and the file as it was read."""
    return tuple(sorted({_released(name, document) for name, document in documents}))


def _released(name: str, document: object) -> ReleasedChart:
    metadata = document.get("metadata") if isinstance(document, Mapping) else None
    found = metadata.get("annotations") if isinstance(metadata, Mapping) else None
    annotations = found if isinstance(found, Mapping) else {}

    def said(key: str) -> str:
        return str(annotations.get(f"robotkube.io/{key}", ""))

    return ReleasedChart(said("chart"), said("chart-version"), said("chart-digest"), said("evidence"), name)
