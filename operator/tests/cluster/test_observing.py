"""What stands between main and the cluster breaks, and is repaired: the next plan is observed within 10 s of that.

Work of others on the machine only adds to a measured time: a repair that took longer is tried again, at most twice.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from running_platform import Platform, eventually
from stage import Stage

from scenarios.runner.inputs import Commit

OBSERVED_SECONDS_MAX = 10.0
NAMED_SECONDS_MAX = 10.0
REPAIRED_SECONDS_MAX = 60.0
TRIES = 3
READY, COMMITTED = "Ready", "Committed"
BROKEN = "releases/vehicle-02/broken.yaml"


def asked(stage: Stage, name: str, sensor: str) -> str:
    """A small demand: one pod on the road-side unit."""
    placement = {"roles": ["roadside"]}
    return stage.submit(
        "cloud-0", name, application="object-detection", parameters={"sensor": sensor}, placement=placement
    )


def seconds_until_observed(stage: Stage, key: str, repaired: float) -> float:
    """How long after the repair (`repaired`: monotonic time) the plan of a task is observed."""
    eventually(f"{key} is observed", lambda: stage.told(key, READY).get("reason") == "Observed", REPAIRED_SECONDS_MAX)
    return time.monotonic() - repaired


def withdraw(stage: Stage, *keys: str) -> None:
    """Take the demands back and wait until main has none of them, so that the next try begins as the first did."""
    for key in keys:
        stage.withdraw(key)
    eventually("main has none of them", lambda: not any(stage.seats(key) for key in keys))


def in_time(repair: Callable[[int], float]) -> None:
    """`repair` (given the number of the try) says after how many seconds the next plan was observed."""
    taken: list[float] = []
    while len(taken) < TRIES and not any(seconds <= OBSERVED_SECONDS_MAX for seconds in taken):
        taken.append(repair(len(taken)))
    assert min(taken) <= OBSERVED_SECONDS_MAX, taken


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

    def repair(number: int) -> float:
        with hooks_lost(platform):
            key = asked(stage, f"hook-lost-{number}", "vehicle-00")
            eventually(f"{key} is merged", lambda: stage.told(key, COMMITTED).get("reason") == "Merged")
        taken = seconds_until_observed(stage, key, time.monotonic())
        withdraw(stage, key)
        return taken

    in_time(repair)


def test_a_broken_file_is_named_reverted_and_the_next_plan_observed(
    platform: Platform, stage: Stage, tmp_path: Path
) -> None:
    """A file that is no release stops all of Argo CD's releases. The gate's account alone can push past the gate."""
    gate = platform.writer("gate", tmp_path / "gate")

    def repair(number: int) -> float:
        broken = gate.push({BROKEN: "apiVersion: [\n"}, "test: a file that is no release\n")
        key = asked(stage, f"after-the-repair-{number}", "vehicle-01")
        eventually(
            "the broken file is named, or its repair is already there",
            lambda: named(stage, key) or repair_of(stage, broken),
            NAMED_SECONDS_MAX,
        )
        commit = eventually("the repair is on main", lambda: repair_of(stage, broken), REPAIRED_SECONDS_MAX)
        taken = seconds_until_observed(stage, key, time.monotonic())
        assert commit.paths == (BROKEN,)
        withdraw(stage, key)
        return taken

    in_time(repair)


def named(stage: Stage, key: str) -> bool:
    """Whether the task's conditions name the broken file."""
    conditions = (stage.told(key, COMMITTED), stage.told(key))
    return any(one.get("reason") == "MainBroken" and BROKEN in one["message"] for one in conditions)


def repair_of(stage: Stage, broken: str) -> Commit | None:
    """The commit on main that repairs and reverts `broken`, if there is one."""
    repairs = [commit for commit in stage.commits()[:20] if "repair" in commit.trailers.get("Cause", ())]
    return next((commit for commit in repairs if commit.trailers["Reverts"] == (broken,)), None)


def test_after_the_forge_was_away_the_demands_are_carried_out_in_their_order(platform: Platform, stage: Stage) -> None:
    def repair(number: int) -> float:
        with forge_away(platform):
            keys = [asked(stage, f"forge-away-{number}-{vehicle}", f"vehicle-0{vehicle}") for vehicle in (0, 1)]
            eventually("both tasks say that the forge is away", lambda: all(waits(stage, key) for key in keys))
        back = time.monotonic()
        taken = seconds_until_observed(stage, keys[0], back)
        seconds_until_observed(stage, keys[1], back)
        commits = eventually("main can be read again", stage.commits)
        made = [commit for commit in commits if set(keys) & set(commit.trailers.get("Task", ()))]
        assert {task for commit in made for task in commit.trailers["Task"]} == set(keys)
        assert keys[0] in made[-1].trailers["Task"]
        withdraw(stage, *keys)
        return taken

    in_time(repair)


def waits(stage: Stage, key: str) -> bool:
    """Whether the task's conditions say that the forge is away."""
    return "ForgeUnavailable" in {stage.told(key, kind).get("reason") for kind in ("Accepted", COMMITTED)}


@contextmanager
def forge_away(platform: Platform) -> Iterator[None]:
    """No forge; at the end it is there and ready."""
    platform.kubectl("-n", "robotkube", "scale", "statefulset/forge", "--replicas=0")
    chosen = ("-n", "robotkube", "wait", "--for=delete", "pod", "-l", "app.kubernetes.io/name=forge")
    platform.kubectl(*chosen, "--timeout=60s")
    try:
        yield
    finally:
        platform.kubectl("-n", "robotkube", "scale", "statefulset/forge", "--replicas=1")
        platform.kubectl("-n", "robotkube", "rollout", "status", "statefulset/forge", "--timeout=120s", seconds=130)
