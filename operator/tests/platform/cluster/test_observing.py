"""What stands between main and the cluster breaks, and is repaired: what was asked for meanwhile is observed, and the
manager's own asking is what brings it, long before Argo CD would look by itself.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from scenarios.runner.inputs import Commit
from tests.stages.platform.running_platform import Platform, asleep, eventually
from tests.stages.platform.table_one import Stage

OBSERVED_SECONDS_MAX = 60.0  # Argo CD looks by itself every 300 s
REPAIRED_SECONDS_MAX = 60.0
READY, COMMITTED = "Ready", "Committed"
BROKEN = "releases/vehicle-02/broken.yaml"
CONNECT = """
import socket
try:
    socket.create_connection(("argocd-applicationset-controller.argocd.svc.cluster.local", 7000), 2).close()
    print("connected")
except OSError as error:
    print(error)
"""


def asked(stage: Stage, name: str, sensor: str) -> str:
    """A small demand: one pod in the cloud."""
    placement = {"roles": ["cloud"]}
    return stage.submit(
        "cloud-0", name, application="object-detection", parameters={"sensor": sensor}, placement=placement
    )


def await_observed(stage: Stage, key: str) -> None:
    """Wait until the cluster has the plan of a task."""
    eventually(
        f"{key} is observed", lambda: stage.condition(key, READY).get("reason") == "Observed", OBSERVED_SECONDS_MAX
    )


@contextmanager
def hooks_lost(platform: Platform) -> Iterator[None]:
    """Nobody reaches the ApplicationSet controller's hook: neither the gate with its push nor the manager."""
    name = "argocd-applicationset-controller"
    selector = platform.get("-n", "argocd", "service", name)["spec"]["selector"]

    def select(words: Mapping[str, str]) -> None:
        patch = json.dumps({"spec": {"selector": words}})
        platform.kubectl("-n", "argocd", "patch", "service", name, "--type=merge", "-p", patch)

    assert hook_is_reachable(platform)
    select(dict.fromkeys(selector, "nobody"))
    try:
        eventually("the gate reaches no hook", lambda: not hook_is_reachable(platform))
        yield
    finally:
        select(selector)


def hook_is_reachable(platform: Platform) -> bool:
    """Return whether the gate's pod can connect to the hook's Service: its nodes' rules follow the selector later."""
    answer = platform.kubectl("-n", "robotkube-gate", "exec", "deployment/gate", "--", "python3", "-c", CONNECT)
    return answer.strip() == "connected"


def test_a_plan_is_observed_whose_hook_was_lost(platform: Platform, stage: Stage) -> None:
    """The manager asks again by itself until Argo CD has heard of the plan."""
    with hooks_lost(platform):
        with asleep(platform, "gate"):  # the one that comes keeps no connection to the hook
            key = asked(stage, "hook-lost", "vehicle-00")
        eventually(f"{key} is merged", lambda: stage.condition(key, COMMITTED).get("reason") == "Merged")
        eventually("the manager asks for it by itself", lambda: asks_for(platform, stage, key))
    await_observed(stage, key)


def asks_for(platform: Platform, stage: Stage, key: str) -> bool:
    """Return whether the manager's log says that it has asked Argo CD again for a task's commit, or for a later one."""
    commits = stage.commits()
    made = [key in commit.trailers.get("Task", ()) for commit in commits].index(True)
    names = [f'"after": "{commit.sha[:12]}"' for commit in commits[: made + 1]]
    lines = platform.kubectl("-n", "robotkube", "logs", "deployment/manager", "--tail=500").splitlines()
    return any('"event": "asking again"' in line and any(name in line for name in names) for line in lines)


def test_a_broken_file_is_named_reverted_and_the_next_plan_observed(
    platform: Platform, stage: Stage, tmp_path: Path
) -> None:
    """A file that is no release stops all of Argo CD's releases. The gate's account alone can push past the gate."""
    gate = platform.writer("gate", tmp_path / "gate")
    with asleep(platform, "gate"):  # so that nothing is repaired before it is named
        broken = gate.push({BROKEN: "apiVersion: [\n"}, "test: a file that is no release\n")
        key = asked(stage, "after-the-repair", "vehicle-01")
        eventually("the broken file is named", lambda: named(stage, key))
        assert repair_of(stage, broken) is None
    repair = eventually("the repair is on main", lambda: repair_of(stage, broken), REPAIRED_SECONDS_MAX)
    assert repair.paths == (BROKEN,)
    await_observed(stage, key)


def named(stage: Stage, key: str) -> bool:
    """Return whether the task's conditions name the broken file."""
    conditions = (stage.condition(key, COMMITTED), stage.condition(key))
    return any(condition.get("reason") == "MainBroken" and BROKEN in condition["message"] for condition in conditions)


def repair_of(stage: Stage, broken: str) -> Commit | None:
    """The commit on main that repairs and reverts `broken`, if there is one."""
    repairs = [commit for commit in stage.commits()[:20] if "repair" in commit.trailers.get("Cause", ())]
    return next((commit for commit in repairs if commit.trailers["Reverts"] == (broken,)), None)


def test_after_the_forge_was_away_the_demands_are_carried_out_in_their_order(platform: Platform, stage: Stage) -> None:
    with forge_away(platform):
        keys = [asked(stage, f"forge-away-{vehicle}", f"vehicle-0{vehicle}") for vehicle in (0, 1)]
        eventually("both tasks say that the forge is away", lambda: all(waits(stage, key) for key in keys))
    for key in keys:
        await_observed(stage, key)
    commits = eventually("main can be read again", stage.commits)
    made = [commit for commit in commits if set(keys) & set(commit.trailers.get("Task", ()))]
    assert {task for commit in made for task in commit.trailers["Task"]} == set(keys)
    assert keys[0] in made[-1].trailers["Task"]


def waits(stage: Stage, key: str) -> bool:
    """Return whether the task's conditions say that the forge is away."""
    return "ForgeUnavailable" in {stage.condition(key, kind).get("reason") for kind in ("Accepted", COMMITTED)}


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
