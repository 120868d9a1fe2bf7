"""Evidence of every release that ran: its annotation names a verification summary that the catalogue holds, a
trusted key has signed that summary, and it is about exactly the digest that ran."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.evidence.adapters.dsse import TrustedKeys
from robotkube.registry.evidence.core.statements import PASSED, SUMMARY_PREDICATE, VerifiedStatement
from scenarios.runner.inputs import ReleasedChart, RunInputs

SUMMARY = "summary.json"
Verify = Callable[[bytes], VerifiedStatement]
"""The statement in an envelope; InputError says why it is not believed."""


@dataclass(frozen=True)
class EvidenceEntry:
    """A chart as it ran, the evidence that its releases named, and whether the catalogue has it, signed and
    for this digest."""

    chart: str
    version: str
    digest: str
    evidence: str
    releases: tuple[str, ...]
    found: bool

    def row(self) -> Mapping[str, object]:
        """The entry by the names of the report."""
        return {**vars(self), "releases": list(self.releases)}


def entries(inputs: RunInputs) -> tuple[EvidenceEntry, ...]:
    """One entry per chart, digest and evidence, by name."""
    grouped = groupby(sorted(set(inputs.released)), lambda one: (one.chart, one.version, one.digest, one.evidence))
    return tuple(_entry(list(released), inputs.summaries) for _, released in grouped)


def _entry(released: Sequence[ReleasedChart], summaries: Mapping[str, str]) -> EvidenceEntry:
    first = released[0]
    releases = tuple(one.release for one in released)
    named = bool(first.digest) and summaries.get(first.evidence) == first.digest
    return EvidenceEntry(first.chart, first.version, first.digest, first.evidence, releases, named)


def complete(inputs: RunInputs) -> bool | None:
    """Return whether every entry has its evidence; None when no release was seen."""
    charts = entries(inputs)
    return all(entry.found for entry in charts) if charts else None


def trusted_keys(texts: Mapping[str, str]) -> TrustedKeys:
    """The public keys whose signatures count (file name -> PEM); InputError when one of them is none, or there is
    none."""
    with tempfile.TemporaryDirectory(prefix="trusted-keys-") as folder:
        for name, text in texts.items():
            (Path(folder) / Path(name).name).write_text(text, encoding="utf-8")
        keys = TrustedKeys(Path(folder))
        if not keys.trusted():
            raise InputError("there is no public key, so nothing can be believed")
    return keys


def summaries(files: Mapping[str, bytes], verify: Verify) -> dict[str, str]:
    """Digest of each summary's envelope -> digest of the chart that it verifiably says has passed; of an envelope that
    is not believed, empty."""
    digests = {}
    for envelope in _envelopes(files):
        try:
            digests[sha256(envelope)] = _passed(verify(envelope).statement)
        except InputError:
            digests[sha256(envelope)] = ""
    return digests


def problems(files: Mapping[str, bytes], verify: Verify, released: Iterable[ReleasedChart]) -> Iterator[str]:
    """Why summaries that releases named are not believed, a sentence each."""
    named = {one.evidence for one in released}
    for envelope in _envelopes(files):
        try:
            if sha256(envelope) in named:
                _passed(verify(envelope).statement)
        except InputError as error:
            yield f"evidence {sha256(envelope)}: {error}"


def _envelopes(files: Mapping[str, bytes]) -> Iterator[bytes]:
    yield from (data for path, data in sorted(files.items()) if path.rpartition("/")[2] == SUMMARY)


def _passed(statement: Mapping[str, Any]) -> str:
    """Digest of the chart that a verified statement says has passed; InputError when it says something else."""
    if statement["predicateType"] != SUMMARY_PREDICATE or statement["predicate"]["verificationResult"] != PASSED:
        raise InputError("it does not say that a chart has passed its verification")
    if len(statement["subject"]) != 1:
        raise InputError("it must be about exactly one chart")
    return f"sha256:{statement['subject'][0]['digest'].get('sha256', '')}"


def released(documents: Iterable[tuple[str, object]]) -> tuple[ReleasedChart, ...]:
    """The charts of release files: pairs of `<namespace>/<release>` and the file as it was read."""
    return tuple(sorted({_released(name, document) for name, document in documents}))


def _released(name: str, document: object) -> ReleasedChart:
    metadata = document.get("metadata") if isinstance(document, Mapping) else None
    stated = metadata.get("annotations") if isinstance(metadata, Mapping) else None
    annotations = stated if isinstance(stated, Mapping) else {}

    def annotation(key: str) -> str:
        return str(annotations.get(f"robotkube.io/{key}", ""))

    return ReleasedChart(
        annotation("chart"), annotation("chart-version"), annotation("chart-digest"), annotation("evidence"), name
    )
