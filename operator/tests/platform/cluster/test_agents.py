"""vehicle-15 was declared before; its machine is switched on in mid-run, holds changes while it drives, and goes. And a
Node of an agent that nobody declared."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci.cluster_contract.topology import NodeSpec
from ci.installation import NAMESPACE
from tests.stages.platform.machines import declared, join, leave
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.platform.table_one import Stage

pytestmark = pytest.mark.thorough

AGENT = "vehicle-15"
MACHINE = NodeSpec(AGENT, "vehicle", AGENT, 500, 2**30, ())
BRIDGE = f"{AGENT}/mqtt-bridge"
NEIGHBOUR = "vehicle-00/mqtt-bridge"
STRANGER = "stranger-0"
STRANGER_AGENT = "vehicle-99"
REPORTED_SECONDS_MAX = 30.0
HELD_MINUTES = 20


@contextmanager
def switched_on(platform: Platform) -> Iterator[None]:
    """The machine joins; at the end it is switched off, and its Node is deleted."""
    join(platform, MACHINE)
    try:
        yield
    finally:
        leave(platform, AGENT)


@contextmanager
def driving(platform: Platform) -> Iterator[None]:
    """The vehicle holds changes."""
    until = (datetime.now(UTC) + timedelta(minutes=HELD_MINUTES)).strftime("%Y-%m-%dT%H:%M:%SZ")
    platform.kubectl("annotate", "node", AGENT, "robotkube.io/hold=driving", f"robotkube.io/hold-until={until}")
    try:
        yield
    finally:
        platform.kubectl("annotate", "node", AGENT, "robotkube.io/hold-", "robotkube.io/hold-until-")


def record(stage: Stage, name: str) -> str:
    return stage.submit(
        "cloud-0", name, application="pose-point-cloud-recording", parameters={"vehicles": ["vehicle-00", AGENT]}
    )


def common(releases: set[str]) -> set[str]:
    """What the new vehicle shall have: a release of each name that all other vehicles have one of."""
    vehicles = {release.partition("/")[0] for release in releases if release.startswith("vehicle-")}
    names = {release.partition("/")[2] for release in releases}
    return {f"{AGENT}/{name}" for name in names if all(f"{vehicle}/{name}" in releases for vehicle in vehicles)}


def test_a_declared_vehicle_joins_drives_and_goes(platform: Platform, stage: Stage, tmp_path: Path) -> None:
    with declared(platform, [{"name": AGENT, "role": "vehicle"}], tmp_path):
        eventually("the platform has settled", platform.settled)
        before = set(stage.releases())
        neighbour = stage.await_running(NEIGHBOUR)[NEIGHBOUR]
        assert not any(release.startswith(f"{AGENT}/") for release in before)
        with switched_on(platform):
            bridge = stage.await_running(BRIDGE)[BRIDGE]
            assert bridge.node == AGENT
            assert BRIDGE in common(before)
            assert set(stage.releases()) - before == common(before), "what every vehicle has"
            assert "initial" in stage.commit_of(BRIDGE).trailers["Cause"]
            with driving(platform):
                key = record(stage, "while-driving")
                eventually("it waits", lambda: stage.condition(key, "Committed").get("reason") == "HeldByAgent")
                assert "vehicle-15 holds changes until" in stage.condition(key, "Committed")["message"]
                assert key not in stage.annotation(BRIDGE, "tasks").split()
            eventually("it goes on", lambda: stage.condition(key, "Committed").get("reason") == "Merged")
            assert key in stage.annotation(BRIDGE, "tasks").split()
            stage.withdraw(key)
            eventually("it is withdrawn", lambda: set(stage.releases()) == before | common(before))
            assert stage.await_running(BRIDGE)[BRIDGE].uid == bridge.uid
        eventually("what it had goes", lambda: set(stage.releases()) == before)
        assert stage.await_running(NEIGHBOUR)[NEIGHBOUR] == neighbour, "its neighbours noticed nothing"


def test_a_node_of_an_undeclared_agent_gets_nothing_and_is_reported(platform: Platform, stage: Stage) -> None:
    labels = {"robotkube.io/agent": STRANGER_AGENT, "robotkube.io/role": "vehicle"}
    node = {"apiVersion": "v1", "kind": "Node", "metadata": {"name": STRANGER, "labels": labels}}
    before = set(stage.releases())
    platform.kubectl("create", "-f", "-", text=yaml.safe_dump(node))
    try:
        report = eventually("it is reported", lambda: reports(platform), REPORTED_SECONDS_MAX)
        assert [event["reason"] for event in report] == ["UnknownAgent"]
        assert f"agent '{STRANGER_AGENT}', which is not declared" in report[0]["note"]
        assert set(stage.releases()) == before
    finally:
        platform.kubectl("delete", "node", STRANGER)


def reports(platform: Platform) -> list[dict[str, Any]]:
    """Events about the Node in the platform's namespace."""
    events = platform.get("-n", NAMESPACE, "events.events.k8s.io")["items"]
    return [event for event in events if event["regarding"].get("name") == STRANGER]
