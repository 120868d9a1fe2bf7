"""Charts and applications to be submitted, as they come from folders, and what tries applications."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.charts.core.packing import PackedChart
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.application_statements import TrialResult
from robotkube.registry.publication.core.submissions import (
    SubmittedChart,
    read_entry,
)


@dataclass(frozen=True)
class ChartSource:
    """A chart as it is submitted: `document` is its entry without a status, `images` the references it runs."""

    document: Mapping[str, Any]
    packed: PackedChart
    images: tuple[str, ...]

    @property
    def entry(self) -> str:
        """The entry's text as submitted."""
        status = {"state": "staged", "digest": self.packed.digest, "images": sorted(self.images)}
        return write_mapping({**self.document, "status": status})

    @property
    def submitted(self) -> SubmittedChart:
        """The submission as the gate reads it; DocumentError when the gate would refuse it."""
        return read_entry(self.entry, f"charts/{self.packed.name}/{self.packed.version}.yaml")


@dataclass(frozen=True)
class SubmittedSources:
    """What to submit: `applications` and `kept` are path in the catalogue -> text; of `kept` (evidence of earlier
    publications) only what belongs to these charts' digests is used."""

    charts: tuple[ChartSource, ...] = ()
    applications: Mapping[str, str] = field(default_factory=dict)
    kept: Mapping[str, str] = field(default_factory=dict)


class ApplicationTrials(Protocol):
    """What composes applications for samples of their parameters, renders what comes out and checks it."""

    def __call__(
        self, files: Mapping[str, str], names: Collection[str], submitted: Collection[ChartReference] = ()
    ) -> Mapping[str, TrialResult]:
        """The result for each application of `names` in a catalogue with these files (path -> text), in which the chart
        versions `submitted` count as verified; for none of them while the catalogue has no verification policy.

        UnavailableError when charts cannot be rendered now."""
        ...
