"""From a plan on main to Argo CD's having compared and applied it, on the whole platform: a cluster of five nodes.

PLANS tasks, one after the other and each alone; the manager's own record of the plan says when it was on main and when
every release of it was synced. `commit_to_synced_s` goes to build/bench/application-manager.json. Like `publication` it
needs the machine for itself: it stops a cluster that runs, and its own at the end.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from benchmarks.delivery.application_manager import RECORD
from benchmarks.measuring.comparisons import Comparison, quantiles, record
from benchmarks.platform.publication import CLUSTER, UNTIL, new_cluster
from ci.errors import SetUpError
from ci.steps import Steps
from scenarios import demo
from scenarios.runner.observing.collecting import MANAGER_PORT
from scenarios.runner.platform.access import Access

PLANS = 20
GOAL_SECONDS = 5.0  # what the paper says of its reconciliation
WAIT_SECONDS_MAX = 120.0
POLL_SECONDS = 0.5
NAMESPACE = "cloud-0"
APPLICATION = "pose-point-cloud-recording"
VEHICLES = ("vehicle-00", "vehicle-01")

Plan = Mapping[str, Any]


def task(number: int) -> dict[str, Any]:
    """One demand; all ask for the same, so that every plan is of one size."""
    event = {"rule": "benchmark", "id": f"e{number}", "trace": f"{number + 1:032x}", "time": "2026-11-21T10:00:00Z"}
    return {
        "apiVersion": "robotkube.io/v1alpha1",
        "kind": "TaskDescription",
        "metadata": {"namespace": NAMESPACE, "name": f"benchmark-{number}"},
        "spec": {
            "requester": "benchmark",
            "event": event,
            "reason": f"round {number}",
            "application": APPLICATION,
            "parameters": {"vehicles": list(VEHICLES)},
        },
    }


def wait_for(access: Access, key: str, cause: str, step: str) -> Plan:
    """The plan of a task with that cause, once it has reached the step."""
    end = time.monotonic() + WAIT_SECONDS_MAX
    while time.monotonic() < end:
        plans = access.service_json("manager", "plans", MANAGER_PORT)["plans"]
        for plan in plans:
            if key in plan["tasks"] and plan["cause"] == cause and plan[step] is not None:
                return dict(plan)
        time.sleep(POLL_SECONDS)
    raise SetUpError(f"no plan ({cause}) of task {key} was {step} within {WAIT_SECONDS_MAX:.0f} s")


def one(access: Access, number: int) -> float:
    """Seconds from the commit to its being synced; the demand is gone afterwards."""
    document = task(number)
    name = document["metadata"]["name"]
    access.create_task(document)
    plan = wait_for(access, f"{NAMESPACE}/{name}", "task", "observed")
    access.delete_task(NAMESPACE, name)
    wait_for(access, f"{NAMESPACE}/{name}", "withdrawal", "observed")
    return float(plan["synced"] - plan["merged"]) / 1e9


def compare() -> list[Comparison]:
    """The latency from main to the cluster, against its goal."""
    with new_cluster(None, Steps(demo.STEPS[UNTIL])) as kubeconfig:
        access = Access(kubeconfig)
        try:
            seconds = quantiles([one(access, number) for number in range(PLANS)])
        finally:
            access.disconnect()
    record(RECORD, {"commit_to_synced_s": asdict(seconds), "commit_to_synced_p95_s": seconds.p95})
    name = f"commit to synced on {CLUSTER.name}, p95 of {seconds.n}"
    return [Comparison(name, "s", seconds.p95, GOAL_SECONDS, 1.0, "the goal")]
