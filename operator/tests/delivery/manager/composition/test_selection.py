"""Which application and which chart version answer a demand: platforms, pins, what is provided and guaranteed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.manager.core.composition.composer import Demand, Met, compose
from robotkube.registry.catalogue.core.guarantees import GuaranteeRequirement
from tests.stages.delivery.manager.placement import (
    NODES,
    ONE,
    application,
    catalogue,
    chart,
    choices,
    demand,
    inputs,
    places,
    refusal,
    task,
)

# -- platforms and versions -------------------------------------------------------------------------------------------

ARM = {"platforms": ["linux/arm64"]}


def test_a_chart_runs_on_nodes_of_its_platforms_only() -> None:
    mixed = [replace(node, platform="linux/arm64" if node.name == "roadside-0" else "linux/amd64") for node in NODES]
    composition = compose([demand(task())], inputs(nodes=mixed))
    assert places(composition) == {"a-t": "roadside-1"}
    assert "roadside-0: is linux/arm64, the chart runs on linux/amd64" in choices(composition)
    foreign = [replace(node, platform="linux/arm64") for node in NODES]
    outcome = refusal(compose([demand(task())], inputs(nodes=foreign)))
    assert outcome.reason == "NoVerifiedVersion"
    assert "worker 0.1.0 (staged): runs on linux/amd64, the nodes are linux/arm64" in outcome.message


def test_the_highest_version_that_runs_there_is_taken() -> None:
    both = catalogue(application(ONE), chart(version="0.2.0", **ARM))
    amd = [replace(node, platform="linux/amd64") for node in NODES]
    composition = compose([demand(task())], inputs(both, amd))
    assert next(iter(composition.releases.values())).version == "0.1.0"
    assert "worker 0.2.0 (staged): runs on linux/arm64, the nodes are linux/amd64" in choices(composition)


def test_a_pinned_release_keeps_its_version_while_it_may() -> None:
    both = catalogue(application(ONE), chart(version="0.2.0"))
    before = compose([demand(task())], inputs()).releases
    pins = {"roadside-0/a-t": ("worker", "0.1.0")}
    kept = compose([demand(task())], inputs(both, present=before, pins=pins))
    assert kept.releases == before
    assert "worker 0.1.0 (staged): kept: the release runs it" in choices(kept)
    assert "worker 0.2.0 (staged): possible; the release keeps its version" in choices(kept)
    gone = replace(
        both,
        charts={
            "worker": tuple(replace(c, state="withdrawn") if c.version == "0.1.0" else c for c in both.charts["worker"])
        },
    )
    moved = compose([demand(task())], inputs(gone, present=before, pins=pins))
    assert next(iter(moved.releases.values())).version == "0.2.0"


def test_a_withheld_version_is_taken_by_nobody_who_is_not_pinned_to_it() -> None:
    both = catalogue(application(ONE), chart(version="0.2.0"))
    withheld = {("worker", "0.2.0"): "it failed on roadside-1"}
    composition = compose([demand(task())], inputs(both, withheld=withheld))
    assert next(iter(composition.releases.values())).version == "0.1.0"
    assert "worker 0.2.0 (staged): it failed on roadside-1" in choices(composition)
    pinned = inputs(both, withheld=withheld, present=composition.releases, pins={"roadside-0/a-t": ("worker", "0.2.0")})
    assert next(iter(compose([demand(task())], pinned).releases.values())).version == "0.2.0"


# -- by what is provided ----------------------------------------------------------------------------------------------


def delayed(name: str, version: str, delay: float) -> tuple[str, str]:
    return chart(name, version, guarantees=[{"name": "delay", "atMost": delay, "unit": "ms"}])


def see(name: str) -> tuple[str, str]:
    return application(
        {**ONE, "chart": {"name": name, "version": ">=0.1.0"}}, name=f"see-{name}", word="perception/detection"
    )


SEEING = catalogue(
    see("fast"), see("slow"), delayed("fast", "0.2.0", 10), delayed("slow", "0.3.0", 100), delayed("fast", "0.1.0", 5)
)


def wants(name: str, at_most: float, unit: str) -> GuaranteeRequirement:
    return GuaranteeRequirement(name, "atMost", at_most, unit)


def provided(*requirements: GuaranteeRequirement, **more: Any) -> Demand:
    return demand(task(application="", provides="perception/detection", requirements=requirements, **more))


def test_the_application_with_the_highest_version_that_satisfies_everything_answers() -> None:
    composition = compose([provided()], inputs(SEEING))
    outcome = composition.outcomes["ops/t"]
    assert isinstance(outcome, Met)
    assert outcome.application == "see-slow"
    assert outcome.choices[0] == "application see-slow: taken, it provides perception/detection"
    release = next(iter(composition.releases.values()))
    assert [cause.application for cause in release.causes] == ["see-slow"]
    strict = compose([provided(wants("delay", 20, "ms"))], inputs(SEEING))
    assert next(iter(strict.releases.values())).chart == "fast"
    assert any(text.startswith("application see-slow: GuaranteeNotMet") for text in choices(strict))
    strictest = compose([provided(wants("delay", 7, "ms"))], inputs(SEEING))
    assert next(iter(strictest.releases.values())).version == "0.1.0"


def test_the_application_that_answers_already_stays() -> None:
    fast = catalogue(see("fast"), delayed("fast", "0.1.0", 5))
    before = compose([provided()], inputs(fast)).releases
    composition = compose([provided()], inputs(SEEING, present=before))
    assert {release.chart for release in composition.releases.values()} == {"fast"}


@pytest.mark.parametrize(
    ("wanted", "reason", "text"),
    [
        (demand(task(application="", provides="a/b")), "UnknownApplication", "provides a/b"),
        (provided(wants("delay", 1, "ms")), "GuaranteeNotMet", "delay at most 1 ms (asked by"),
        (provided(wants("loss", 1, "%")), "GuaranteeNotMet", "a guarantee for loss at most 1 %"),
    ],
)  # fmt: skip
def test_what_nobody_provides_is_refused(wanted: Demand, reason: str, text: str) -> None:
    outcome = refusal(compose([wanted], inputs(SEEING)))
    assert outcome.reason == reason
    assert text in outcome.message
