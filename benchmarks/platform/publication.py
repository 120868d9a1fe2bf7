"""What a publication costs: all charts through the gate and its suites, on the small embedded cluster of the tests,
without any kept evidence, against publishing them again unchanged.

To build/bench/registry.json go `publish_seconds` (suite -> seconds, the mean over the charts, as the signed statements
in the catalogue say), `publish_all_s` (images, charts and applications, from first to last) and `publish_unchanged_s`.
Only one cluster can run, and this one must be new: those that run are stopped, and this one is at the end.
"""

from __future__ import annotations

import base64
import json
import statistics
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from benchmarks.measuring.comparisons import Comparison, seconds
from benchmarks.registry.catalogue import record
from ci import publish
from ci.cluster import choosing
from ci.cluster.choosing import Choice
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.steps import Steps
from robotkube.registry.evidence.core.verification_policy import SUMMARY
from robotkube.registry.publication.loops.submitting import UNCHANGED
from scenarios import definition, demo

CLUSTER = Choice("test")
VARIANT = "small"
UNTIL = "platform"
SCENARIO = PROJECT / "scenarios" / "pose-point-cloud-db-recording"
PUBLISHING = "catalogue"  # the step of `bring_up` that publishes
REPETITIONS = 3  # of the unchanged publication
GOAL_SECONDS = 240.0  # for the first publication, on two cores
UNCHANGED_GOAL_SECONDS = 10.0
RATIO_MAX = GOAL_SECONDS / UNCHANGED_GOAL_SECONDS  # on a machine too slow for the second goal


@dataclass(frozen=True)
class Costs:
    """Wall seconds of publishing `charts` charts (everything) and of doing so again (unchanged, the median); seconds of
    each suite."""

    charts: int
    everything: float
    unchanged: float
    suites: Mapping[str, float]


def suite_seconds(evidence: Mapping[str, str]) -> dict[str, float]:
    """Suite -> seconds it took, the mean over the charts; `evidence` is path in the catalogue -> envelope."""
    times_by_suite: defaultdict[str, list[float]] = defaultdict(list)
    for path, envelope in evidence.items():
        suite = PurePosixPath(path).stem
        if suite != SUMMARY:
            times_by_suite[suite].append(_stated_seconds(envelope))
    return {suite: round(statistics.mean(times), 2) for suite, times in sorted(times_by_suite.items())}


def _stated_seconds(envelope: str) -> float:
    """What the statement in an envelope says about its own run."""
    statement = json.loads(base64.b64decode(json.loads(envelope)["payload"]))
    suite = next(one for one in statement["predicate"]["configuration"] if one["name"] == "suite")
    return float(suite["annotations"]["seconds"])


@contextmanager
def new_cluster(kept: Path | None, steps: Steps) -> Iterator[Path]:
    """The kubeconfig of a cluster on which everything was just published, with evidence from and to `kept` (None: the
    user's cache)."""
    parameters = definition.load(SCENARIO, [], VARIANT).parameters
    choosing.remove_running(lambda text: print(text, file=sys.stderr))
    try:
        request = demo.Request(SCENARIO, {"vehicles": str(parameters.vehicles)}, CLUSTER, UNTIL, kept)
        yield demo.bring_up(request, steps).kubeconfig
    finally:
        choosing.provider(CLUSTER).down()


def measure() -> Costs:
    """Publish, then publish the same again. SetUpError when the second time was no repetition."""
    again: list[publish.Published] = []
    steps = Steps(demo.STEPS[UNTIL])
    with tempfile.TemporaryDirectory(prefix="robotkube-evidence-") as folder:
        kept = Path(folder)
        with new_cluster(kept, steps) as kubeconfig:
            unchanged = seconds(lambda: again.append(publish.publish(kubeconfig, kept=kept)), REPETITIONS)
    outcome = again[-1].outcome
    if any(one.outcome.verdict != UNCHANGED for one in again) or not outcome.evidence:
        verdicts = ", ".join(one.outcome.verdict for one in again)
        raise SetUpError(f"publishing the same again gave {verdicts} with {len(outcome.evidence)} files of evidence")
    charts = len({PurePosixPath(path).parent for path in outcome.evidence})
    return Costs(charts, steps.seconds[PUBLISHING], unchanged, suite_seconds(outcome.evidence))


def comparison(costs: Costs) -> Comparison:
    """The first publication may take its goal, and more only where the unchanged one misses its own."""
    bound = max(GOAL_SECONDS / costs.unchanged, RATIO_MAX)
    name = f"publish {costs.charts} charts, every suite run"
    return Comparison(name, "s", costs.everything, costs.unchanged, bound, "publish them again, unchanged")


def compare() -> list[Comparison]:
    """The first publication against the unchanged one."""
    costs = measure()
    record(
        {
            "publish_seconds": costs.suites,
            "publish_all_s": round(costs.everything, 1),
            "publish_unchanged_s": round(costs.unchanged, 2),
        }
    )
    return [comparison(costs)]
