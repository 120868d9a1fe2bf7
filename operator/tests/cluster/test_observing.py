"""What stands between main and the cluster breaks, and is repaired: the next plan is observed within 10 s of that."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from running_platform import Platform, eventually
from stage import Stage

OBSERVED_SECONDS_MAX = 10.0
NAMED_SECONDS_MAX = 10.0
REPAIRED_SECONDS_MAX = 60.0
READY, COMMITTED = "Ready", "Committed"
BROKEN = "releases/vehicle-02/broken.yaml"


def asked(stage: Stage, name: str, sensor: str) -> str:
    """A small demand: one pod on the road-side unit."""
    placement = {"roles": ["roadside"]}
    return stage.submit(
        "cloud-0", name, application="object-detection", parameters={"sensor": sensor}, placement=placement
    )


def await_observed(stage: Stage, key: str, repaired: float) -> None:
    """The plan of a task is observed, at most 10 s after the repair (`repaired`: monotonic time)."""
    eventually(f"{key} is observed", lambda: stage.told(key, READY).get("reason") == "Observed", REPAIRED_SECONDS_MAX)
    assert time.monotonic() - repaired <= OBSERVED_SECONDS_MAX


@contextmanager
def hooks_lost(platform: Platform) -> Iterator[None]:
    """Nobody reaches the ApplicationSet controller's hook: neither the gate with its push nor the manager."""
    name = "argocd-applicationset-controller"
    selector = platform.get("-n", "argocd", "service", name)["spec"]["selector"]

    def select(words: Mapping[str, str]) -> None:
        patch = json.dumps({"spec": {"selector": words}})
        platform.kubectl("-n", "argocd", "patch", "service", name, "--type=merge", "-p", patch)

    select(dict.fromkeys(selector, "nobody"))
    try:
        yield
    finally:
        select(selector)


def test_a_plan_is_observed_whose_hook_was_lost(platform: Platform, stage: Stage) -> None:
    """The manager asks again by itself until Argo CD has heard of the plan."""
    with hooks_lost(platform):
        key = asked(stage, "hook-lost", "vehicle-00")
        eventually(f"{key} is merged", lambda: stage.told(key, COMMITTED).get("reason") == "Merged")
    await_observed(stage, key, time.monotonic())


def test_a_broken_file_is_named_reverted_and_the_next_plan_observed(
    platform: Platform, stage: Stage, tmp_path: Path
) -> None:
    """A file that is no release stops all of Argo CD's releases. The gate's account alone can push past the gate."""
    gate = platform.writer("gate", tmp_path / "gate")
    broken = gate.push({BROKEN: "apiVersion: [\n"}, "test: a file that is no release\n")
    key = asked(stage, "after-the-repair", "vehicle-01")

    def named() -> bool:
        conditions = (stage.told(key, COMMITTED), stage.told(key))
        return any(one.get("reason") == "MainBroken" and BROKEN in one["message"] for one in conditions)

    def repaired() -> bool:
        return any("repair" in commit.trailers.get("Cause", ()) for commit in stage.commits()[:10])

    eventually(
        "the broken file is named, or its repair is already there", lambda: named() or repaired(), NAMED_SECONDS_MAX
    )
    eventually("the repair is on main", repaired, REPAIRED_SECONDS_MAX)
    await_observed(stage, key, time.monotonic())
    repair = next(commit for commit in stage.commits() if "repair" in commit.trailers.get("Cause", ()))
    assert repair.paths == (BROKEN,)
    assert repair.trailers["Reverts"] == (broken,)


def test_after_the_forge_was_away_the_demands_are_carried_out_in_their_order(platform: Platform, stage: Stage) -> None:
    platform.kubectl("-n", "robotkube", "scale", "statefulset/forge", "--replicas=0")
    chosen = ("-n", "robotkube", "wait", "--for=delete", "pod", "-l", "app.kubernetes.io/name=forge")
    platform.kubectl(*chosen, "--timeout=60s")
    try:
        first, second = asked(stage, "forge-away-1", "vehicle-00"), asked(stage, "forge-away-2", "vehicle-01")

        def said() -> bool:
            reasons = [
                stage.told(key, kind).get("reason") for key in (first, second) for kind in ("Accepted", COMMITTED)
            ]
            return reasons.count("ForgeUnavailable") >= 2

        eventually("both tasks say that the forge is away", said)
    finally:
        platform.kubectl("-n", "robotkube", "scale", "statefulset/forge", "--replicas=1")
        platform.kubectl("-n", "robotkube", "rollout", "status", "statefulset/forge", "--timeout=120s", seconds=130)
    back = time.monotonic()
    for key in (first, second):
        await_observed(stage, key, back)
    commits = eventually("main can be read again", stage.commits)
    made = [commit for commit in commits if {first, second} & set(commit.trailers.get("Task", ()))]
    assert {task for commit in made for task in commit.trailers["Task"]} == {first, second}
    assert first in made[-1].trailers["Task"]
