"""What the gate counts since its start, and its metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from robotkube.delivery.gate.loops.unchecked_report import UncheckedCounts
from robotkube.foundation.runtime.ports import Series, by_one

VERDICTS = ("accepted", "refused", "stale", "checked", "failed")
HOOKS = ("received", "lost")
SOURCES = ("sent", "fetched")


@dataclass
class GateStatistics:
    """The gate's counters since its start; `decision_seconds` is the sum over all decided proposals, from the moment
    the round turned to it until main moved or the refusal stood."""

    verdicts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(VERDICTS, 0))
    hooks: dict[str, int] = field(default_factory=lambda: dict.fromkeys(HOOKS, 0))
    sources: dict[str, int] = field(default_factory=lambda: dict.fromkeys(SOURCES, 0))
    decision_seconds: float = 0.0
    rounds: int = 0
    unchecked: UncheckedCounts = field(default_factory=UncheckedCounts)


def gate_metrics(statistics: GateStatistics) -> Sequence[Series]:
    """The statistics as metrics."""
    prefix = "robotkube_gate_"
    return (
        Series(
            f"{prefix}proposals_total",
            "counter",
            "Decided heads of pull requests by verdict.",
            by_one(statistics.verdicts),
            ("verdict",),
        ),
        Series(
            f"{prefix}proposals_read_total",
            "counter",
            "Decided heads by where their objects came from.",
            by_one(statistics.sources),
            ("source",),
        ),
        Series(
            f"{prefix}hooks_total",
            "counter",
            "Announcements of merged commits to Argo CD.",
            by_one(statistics.hooks),
            ("result",),
        ),
        Series(
            f"{prefix}decision_seconds_total",
            "counter",
            "Time from reading proposals to decisions.",
            {(): statistics.decision_seconds},
        ),
        Series(
            f"{prefix}break_glass_commits",
            "gauge",
            "Commits of main that two registered people signed, and no checked commit has replaced or accepted.",
            {(): statistics.unchecked.break_glass_commits},
        ),
        Series(
            f"{prefix}break_glass_files",
            "gauge",
            "Files that main still has as such commits brought them.",
            {(): statistics.unchecked.break_glass_files},
        ),
        Series(
            f"{prefix}unchecked_commits",
            "gauge",
            "Other commits of main that the gate did not check, by how: without its record, or with signatures that do "
            "not hold.",
            by_one(statistics.unchecked.others),
            ("how",),
        ),
        Series(f"{prefix}rounds_total", "counter", "Rounds over the open proposals.", {(): statistics.rounds}),
    )
