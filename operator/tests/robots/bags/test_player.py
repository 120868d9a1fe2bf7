"""The player on a clock that the test moves."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from benchmarks.measuring.bags import Track, lidar_tracks, message, pose_track, write_bag
from robotkube.errors import InputError, UnavailableError
from robotkube.robots.bags.adapters.ledger_files import LedgerFiles
from robotkube.robots.bags.adapters.reading import open_bag
from robotkube.robots.bags.core.playback import BagTopic, PlaybackRun, restamped
from robotkube.robots.bags.loops.player import Player
from robotkube.robots.ros.core.common_messages import header_stamp
from tests.stages.bridge.memory_network import Network

START = 1_795_250_000_000_000_000
POSE = BagTopic("/p", "geometry_msgs/msg/PoseStamped", "reliable", "volatile", 10)
LATCHED = BagTopic("/t", "geometry_msgs/msg/TransformStamped", "reliable", "transient_local", 1)


class Clock:
    """Sleeping moves it; `stall` makes one sleep longer. `acts` are done when their time has come."""

    def __init__(self, now: int) -> None:
        self.time = now
        self.stall_at = -1
        self.stall = 0
        self.acts: list[tuple[int, Callable[[], None]]] = []

    def now(self) -> int:
        return self.time

    def sleep(self, nanoseconds: int) -> None:
        self.time += nanoseconds
        if self.time >= self.stall_at >= 0:
            self.time, self.stall_at = self.time + self.stall, -1
        for act in [act for act in self.acts if act[0] <= self.time]:
            self.acts.remove(act)
            act[1]()


class Bag:
    def __init__(self, count: int) -> None:
        self.topics = [POSE, LATCHED]
        self.count = count

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        yield LATCHED.name, 0, message(0, 0, 40)
        for k in range(self.count):
            yield POSE.name, k * 10_000_000, message(k, 0, 76)


class PlayerStage:
    def __init__(self, folder: Path, now: int, count: int = 500) -> None:
        self.clock = Clock(now)
        self.folder = folder
        self.network = Network(self.clock)
        self.ended = False
        self.player = Player(
            self.network, Bag(count), LedgerFiles(folder), self.clock, lambda *a, **k: None, lambda: self.ended
        )

    def at(self, moment: int, act: Callable[[], None]) -> None:
        self.clock.acts.append((moment, act))

    def end(self) -> None:
        self.ended = True

    def ledger(self, run: str, name: str) -> list[dict[str, object]]:
        return [json.loads(line) for line in (self.folder / run / f"{name}.jsonl").read_text().splitlines()]


def test_messages_are_stamped_on_the_grid_and_ledgered(tmp_path: Path) -> None:
    stage = PlayerStage(tmp_path, START - 2_000_000_000)
    stage.at(START - 10**9, lambda: stage.player.order(PlaybackRun("one", START)))
    stage.at(START + 6 * 10**9, stage.end)
    stage.player.serve()
    poses = stage.network.endpoint("/p").published
    assert [header_stamp(data) for data in poses] == [START + k * 10_000_000 for k in range(500)]
    ledger = stage.ledger("one", "__p")
    assert ledger[-1] == {"end": True, "count": 500}
    assert [(line["sequence"], line["stamp"], line["sha256"]) for line in ledger[:-1]] == [
        (k, START + k * 10_000_000, hashlib.sha256(data).hexdigest()) for k, data in enumerate(poses)
    ]
    assert stage.ledger("one", "__t")[-1] == {"end": True, "count": 1}
    assert stage.player.counts.late == 0
    assert 'robotkube_player_matched_subscriptions{topic="/p"} 1\n' in stage.player.metrics()


def test_it_is_silent_without_an_order(tmp_path: Path) -> None:
    stage = PlayerStage(tmp_path, START)
    stage.at(START + 5 * 10**9, stage.end)
    stage.player.serve()
    assert stage.network.endpoint("/p").published == []
    assert list(tmp_path.iterdir()) == []


def test_a_stall_is_made_up_for_in_order_and_counted(tmp_path: Path) -> None:
    stage = PlayerStage(tmp_path, START)
    stage.player.order(PlaybackRun("one", START))
    stage.clock.stall_at = START + 10**9
    stage.clock.stall = 2 * 10**9
    stage.at(START + 9 * 10**9, stage.end)
    stage.player.serve()
    assert [line.get("sequence") for line in stage.ledger("one", "__p")[:-1]] == list(range(500))
    assert stage.player.counts.late == 100


def test_a_new_run_starts_over(tmp_path: Path) -> None:
    stage = PlayerStage(tmp_path, START)
    stage.player.order(PlaybackRun("one", START))
    second = START + 20 * 10**9
    stage.at(START + 10**9, lambda: stage.player.order(PlaybackRun("two", second)))
    stage.at(second + 6 * 10**9, stage.end)
    stage.player.serve()
    assert "end" not in stage.ledger("one", "__p")[-1]
    assert stage.ledger("two", "__p")[0]["stamp"] == second
    assert stage.ledger("two", "__p")[-1] == {"end": True, "count": 500}


def test_laps_follow_each_other_on_the_grid_and_leave_no_ledger(tmp_path: Path) -> None:
    stage = PlayerStage(tmp_path, START - 10**9, count=50)
    lap = 2 * 10**9
    stage.player.order(PlaybackRun("round", START, 3, lap))
    stage.at(START + 9 * 10**9, stage.end)
    stage.player.serve()
    stamps = [header_stamp(data) for data in stage.network.endpoint("/p").published]
    assert stamps == [START + n * lap + k * 10_000_000 for n in range(3) for k in range(50)]
    assert stage.player.counts.runs == 3
    assert list(tmp_path.iterdir()) == []


def test_a_player_that_comes_back_joins_the_lap_that_is_due(tmp_path: Path) -> None:
    """All players drive on one clock: who was away misses what the others drove meanwhile."""
    lap = 10 * 10**9
    stage = PlayerStage(tmp_path, START + lap + 3 * 10**9)
    stage.player.order(PlaybackRun("round", START, 2, lap))
    stage.at(START + 3 * lap, stage.end)
    stage.player.serve()
    stamps = [header_stamp(data) for data in stage.network.endpoint("/p").published]
    assert stamps == [START + lap + k * 10_000_000 for k in range(200, 500)], "a second of what is late is made up for"
    assert len(stage.network.endpoint("/t").published) == 1, "who subscribes late still gets the latched one"


def test_laps_end_when_the_order_is_taken_back(tmp_path: Path) -> None:
    stage = PlayerStage(tmp_path, START)
    stage.player.order(PlaybackRun("round", START, 9, 10 * 10**9))
    stage.at(START + 11 * 10**9, lambda: stage.player.order(None))
    stage.at(START + 50 * 10**9, stage.end)
    stage.player.serve()
    assert header_stamp(stage.network.endpoint("/p").published[-1]) <= START + 12 * 10**9


def test_after_a_restart_it_goes_on_where_its_ledger_ends(tmp_path: Path) -> None:
    first = PlayerStage(tmp_path, START)
    first.player.order(PlaybackRun("one", START))
    first.at(START + 10**9, first.end)
    first.player.serve()
    written = len(first.ledger("one", "__p"))
    second = PlayerStage(tmp_path, START + 3 * 10**9)
    second.player.order(PlaybackRun("one", START))
    second.at(START + 9 * 10**9, second.end)
    second.player.serve()
    ledger = second.ledger("one", "__p")
    sequences = [line["sequence"] for line in ledger[:-1]]
    assert sequences == [*range(written), *range(200, 500)]
    assert ledger[-1] == {"end": True, "count": len(sequences)}
    assert second.player.counts.skipped == 200 - written
    assert second.network.endpoint("/t").published == [restamped(message(0, 0, 40), START)]
    assert len(second.ledger("one", "__t")) == 2


def test_after_a_signal_it_asks_for_the_rest(tmp_path: Path) -> None:
    stage = PlayerStage(tmp_path, START)
    stage.network.signals = [0, 3, 0, 50]
    stage.player.order(PlaybackRun("one", START))
    stage.at(START + 9 * 10**9, stage.end)
    stage.player.serve()
    assert [line.get("sequence") for line in stage.ledger("one", "__p")[:-1]] == list(range(500))
    assert [header_stamp(data) for data in stage.network.endpoint("/p").published] == [
        START + k * 10_000_000 for k in range(500)
    ]
    assert stage.player.counts.published == 501


def test_what_is_not_taken_is_not_in_the_ledger(tmp_path: Path) -> None:
    stage = PlayerStage(tmp_path, START)
    stage.network.refused = restamped(message(207, 0, 76), START + 207 * 10_000_000)
    stage.player.order(PlaybackRun("one", START))
    with pytest.raises(UnavailableError, match=r"topic /p: the middleware did not accept a message: no room"):
        stage.player.serve()
    assert [line["sequence"] for line in stage.ledger("one", "__p")] == list(range(207))
    assert len(stage.network.endpoint("/p").published) == 207


def test_a_run_far_away_is_waited_for_and_may_be_taken_back(tmp_path: Path) -> None:
    stage = PlayerStage(tmp_path, START - 60 * 10**9)
    stage.player.order(PlaybackRun("one", START))
    stage.at(START - 20 * 10**9, lambda: stage.player.order(None))
    stage.at(START + 10**9, stage.end)
    stage.player.serve()
    assert stage.network.endpoint("/p").published == []
    assert stage.clock.time < START + 2 * 10**9


def test_a_bag_is_read_with_topics_and_times(tmp_path: Path) -> None:
    tracks = [pose_track("vehicle-00"), *lidar_tracks("vehicle-00", 5000)]
    counts = write_bag(tmp_path / "bag", tracks, 3)
    bag = open_bag(tmp_path / "bag")
    assert {(t.name, t.type, t.durability, t.depth) for t in bag.topics} == {
        (t.name, t.type, t.durability, t.depth) for t in tracks
    }
    offsets: dict[str, list[int]] = {}
    for topic, moment, data in bag.messages():
        offsets.setdefault(topic, []).append(moment)
        assert len(data) == next(t.size for t in tracks if t.name == topic)
    assert {topic: len(moments) for topic, moments in offsets.items()} == counts
    bag.close()
    assert offsets["/vehicles/vehicle_00/pose"] == [k * 10_000_000 for k in range(300)]


def test_players_refuse_damaged_bags(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="name a rosbag2 folder"):
        open_bag(tmp_path / "nothing")
    write_bag(tmp_path / "bag", [Track("/p", POSE.type, 100, 76)], 1)
    file = tmp_path / "bag" / "bag.mcap"
    data = bytearray(file.read_bytes())
    data[2000] ^= 1
    file.write_bytes(data)
    with open_bag(tmp_path / "bag") as bag, pytest.raises(InputError, match="does not fit its checksum"):
        list(bag.messages())
    file.write_bytes(data[:5000])
    with pytest.raises(InputError, match="was not finished or is cut off"):
        open_bag(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").write_text("a: 1")
    with pytest.raises(InputError, match="is not the metadata of a rosbag2 bag"):
        open_bag(tmp_path / "bag")
