"""Poses and clouds from bag to ROS in the cloud, with the processes of the pods, in network namespaces, over mosquitto.

Loss, duplicates and equality are computed from the players' ledgers and what a ROS receiver at the cloud got.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path

import pytest

from benchmarks.bridges.data_path import DataPath
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

WAIT_SECONDS = 60.0
LEAD_SECONDS = 1.5
SECONDS = 8.0

Received = dict[str, list[tuple[int, str]]]


@pytest.fixture
def setting(tmp_path: Path) -> Iterator[DataPath]:
    made = DataPath(tmp_path, vehicles=3, lidars=1, seconds=SECONDS)
    made.hashes = True
    with made.api:
        try:
            yield made
        finally:
            made.close()


def unheard_with_logs(setting: DataPath) -> str:
    """What players lack, with the end of what their bridges and they logged."""
    lacks = setting.unheard()
    logs = [path for agent in lacks for path in sorted((setting.folder / agent).glob("*.log"))]
    return "\n".join([str(lacks), *(f"{path.name}: {path.read_text()[-2000:]}" for path in logs)])


def play(setting: DataPath, acts: dict[float, Callable[[], None]]) -> Received:
    """Plays all bags; `acts` are done at their seconds of the run. Returns what arrived."""
    setting.begin()
    until(lambda: all(setting.connected(a) for a in [*setting.agents, "cloud-0"]), "bridges connected", WAIT_SECONDS)
    until(lambda: not setting.unheard(), "players heard", WAIT_SECONDS, lambda: unheard_with_logs(setting))
    start = time.time() + LEAD_SECONDS
    setting.order(int(start * 1e9))
    for second, act in sorted(acts.items()):
        time.sleep(max(0.0, start + second - time.time()))
        act()
    poses = [setting.tracks[agent][0].name for agent in setting.agents]
    ledgers = setting.folder / "ledger"
    until(
        lambda: sum('"end"' in f.read_text() for f in ledgers.rglob("*pose.jsonl")) == len(poses),
        "bags' end",
        WAIT_SECONDS,
    )
    last = {name: ledger(setting, agent, name)[-1] for agent, name in zip(setting.agents, poses, strict=True)}
    until(
        lambda: all(line in received_now(setting).get(name, ()) for name, line in last.items()),
        "last poses",
        WAIT_SECONDS,
    )
    setting.close()
    received = received_now(setting)
    assert received, f"the receiver said:\n{(setting.folder / 'receiver.log').read_text()[-4000:]}"
    return received


def received_now(setting: DataPath) -> Received:
    """What had arrived when nothing more came; the receiver writes it then."""
    file = setting.folder / "received.json"
    result = json.loads(file.read_text()) if file.exists() else {}
    return {name: [(stamp, digest) for stamp, digest in topic["hashes"]] for name, topic in result.items()}


def configured(setting: DataPath, agent: str) -> int:
    """The time at which the agent's bridge took its present settings, ns."""
    lines = [json.loads(line) for line in (setting.folder / agent / "mqtt-bridge.log").read_text().splitlines()]
    last = [line["time"] for line in lines if line["event"] == "configured"][-1]
    return int(datetime.fromisoformat(last).timestamp() * 1000 + 1) * 1_000_000


def ledger(setting: DataPath, agent: str, topic: str) -> list[tuple[int, str]]:
    path = setting.folder / "ledger" / agent / "benchmark" / f"{topic.replace('/', '__')}.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert lines[-1] == {"end": True, "count": len(lines) - 1}
    assert [line["sequence"] for line in lines[:-1]] == list(range(len(lines) - 1))
    return [(line["stamp"], line["sha256"]) for line in lines[:-1]]


def assert_all_poses(setting: DataPath, received: Received) -> None:
    for agent in setting.agents:
        topic = setting.tracks[agent][0].name
        assert len(ledger(setting, agent, topic)) == int(SECONDS * 100)
        assert received[topic] == ledger(setting, agent, topic)


def test_every_pose_arrives_once_also_when_a_topic_is_added_in_mid_run(setting: DataPath) -> None:
    before: list[int | None] = []

    def add_lidar() -> None:
        setting.bridged["vehicle-00"] = setting.tracks["vehicle-00"]
        setting.configure()

    def take_lidar_away() -> None:
        setting.bridged["vehicle-00"] = setting.tracks["vehicle-00"][:1]
        setting.configure()
        before.extend(pod.process.poll() or 0 for pod in setting.pods)

    received = play(setting, {2.0: add_lidar, 6.0: take_lidar_away})
    assert_all_poses(setting, received)
    _, cloud, transform = (track.name for track in setting.tracks["vehicle-00"])
    clouds = received[cloud]
    played = ledger(setting, "vehicle-00", cloud)
    begin = played.index(clouds[0])
    assert clouds == played[begin : begin + len(clouds)]
    assert len(clouds) >= 20
    assert clouds[-1][0] <= configured(setting, "vehicle-00"), "clouds came of a topic that was taken away"
    assert clouds[-1] != played[-1]
    assert received[transform] == ledger(setting, "vehicle-00", transform)
    assert before == [0] * len(setting.pods), "a bridge ended when its settings changed"


@pytest.mark.thorough
def test_every_pose_arrives_once_over_a_restart_of_the_broker(setting: DataPath) -> None:
    def restart() -> None:
        setting.broker.stop()
        time.sleep(0.5)
        setting.broker.start()

    assert_all_poses(setting, play(setting, {3.0: restart}))


@pytest.mark.thorough
def test_every_pose_arrives_once_over_a_restart_of_the_cloud_bridge(setting: DataPath) -> None:
    assert_all_poses(setting, play(setting, {3.0: setting.restart_cloud_bridge}))
