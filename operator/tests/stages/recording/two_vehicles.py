"""The whole path of two vehicles' messages: players, bridges, broker, recorder and database, each a process, those of
the robots in network namespaces of their own. One vehicle has a lidar that sees the other one."""

from __future__ import annotations

import http.client
import signal
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.bridges.data_path import DataPath
from benchmarks.measuring import bags
from robotkube.foundation.database.adapters.connection import DatabaseLogin, connect
from robotkube.robots.bags.adapters.writing import BagWriter
from robotkube.robots.bags.core.playback import BagTopic
from robotkube.robots.recording.adapters.mongodb import PymongoRecordingReader
from robotkube.robots.recording.adapters.segments import McapSegmentReader
from robotkube.robots.recording.core.ledgers import LedgerLine
from robotkube.robots.recording.loops.reading import read_ledger
from scenarios.generator import messages, scene
from tests.stages.recording.database_server import DatabaseServer
from tests.stages.waiting import until

AGENTS = ("vehicle-00", "vehicle-01")
POSE, CLOUD = "/vehicles/{agent}/pose", "/vehicles/{agent}/lidar_center/pointcloud"
TRANSFORM = "/vehicles/{agent}/lidar_center/transform"
TOPICS = {
    POSE: (bags.POSE_TYPE, "document", "volatile"),
    CLOUD: (bags.CLOUD_TYPE, "segment", "volatile"),
    TRANSFORM: (bags.TRANSFORM_TYPE, "document", "transient_local"),
}
RECORDING, ENCOUNTER = "task-1", "encounter"
DATABASE, VOLUME = "recordings_cloud_0", "cloud-0/recordings"
FRAME = "vehicle_00/lidar_center"
MOUNT = scene.MOUNTS[0]
POINTS = 20_000
POSE_HZ, CLOUD_HZ = 100, 10
NEAR_M, BEFORE_SECONDS = 30, 1
SECOND = 1_000_000_000
LEAD_SECONDS, START_SECONDS_MAX, DRAIN_SECONDS_MAX = 2.0, 60.0, 60.0


class RecordedPath(DataPath):
    """Poses of two vehicles at 100 Hz and clouds of one at 10 Hz for `seconds`, recorded at the cloud from the begin
    to the end, and once more around their being near each other. `server` is a running database that pods reach."""

    def __init__(self, folder: Path, server: DatabaseServer, seconds: float, away: float) -> None:
        super().__init__(folder, vehicles=len(AGENTS), lidars=1, seconds=seconds, clouds=True)
        self.away = away
        self.claim = folder / "claim"
        self.claim.mkdir()
        server.create_account("recorder", "secret", DATABASE)
        self._account = DatabaseLogin("127.0.0.1", server.port, DATABASE, "recorder", "secret", DATABASE)
        self.database = connect(self._account)
        self.reader = PymongoRecordingReader(self.database)
        self.segments = McapSegmentReader({VOLUME: self.claim})

    def run(self, killed_after: float) -> None:
        """Play everything; the broker is killed after so many seconds and stays away for `away`. Returns when the
        recorder has ended by itself."""
        self.begin()
        until(lambda: all(map(self.connected, (*self.agents, "cloud-0"))), "bridges connected", START_SECONDS_MAX)
        until(lambda: answers(self.recorder_address), "the recorder is ready", START_SECONDS_MAX)
        until(lambda: not self.unheard(), "the players are heard", START_SECONDS_MAX, self.unheard)
        start = time.time() + LEAD_SECONDS
        self.order(int(start * SECOND))
        time.sleep(max(0.0, start + killed_after - time.time()))
        self.broker.stop(signal.SIGKILL)
        time.sleep(self.away)
        self.broker.start()
        until(lambda: len(list(self._ended())) == 4, "the bags end", self.seconds + START_SECONDS_MAX)
        until(self._drained, "the last messages are stored", DRAIN_SECONDS_MAX)
        self.recorder.process.terminate()
        self.recorder.process.wait(DRAIN_SECONDS_MAX)  # it bounds its end itself
        assert self.recorder.process.returncode == 0, (self.folder / "cloud-0" / "event-detector.log").read_text()

    def close(self) -> None:
        super().close()
        self.database.client.close()

    def ledgers(self) -> dict[str, list[LedgerLine]]:
        """Topic -> what its player says that it published."""
        ledgers = {}
        for path in self._ledger_files():
            with path.open() as file:
                ledgers[path.stem.replace("__", "/")] = read_ledger(file, str(path))
        return ledgers

    def ledger_folders(self) -> list[Path]:
        """One per player."""
        return sorted({path.parent for path in self._ledger_files()})

    def _ledger_files(self) -> list[Path]:
        return list((self.folder / "ledger").glob("*/benchmark/*.jsonl"))

    def _ended(self) -> Iterator[Path]:
        return (path for path in self._ledger_files() if '"end"' in path.read_text())

    def _drained(self) -> bool:
        """Return whether the last message of each topic is in the database."""
        last = {topic: lines[-1].stamp for topic, lines in self.ledgers().items()}
        cloud = CLOUD.format(agent="vehicle_00")
        poses = [POSE.format(agent=agent.replace("-", "_")) for agent in AGENTS]
        index, samples = self.database["segments_index"], self.database["samples"]
        return index.count_documents({"topic": cloud, "stamp": last[cloud]}) > 0 and all(
            samples.count_documents({"topic": pose, "samples.stamp": last[pose]}) for pose in poses
        )

    def _write_bag(self, folder: Path, agent: str) -> None:
        kinds = [(track.name, track.type, track.durability, track.depth) for track in self.tracks[agent]]
        topics = [BagTopic(name, kind, "reliable", durability, depth) for name, kind, durability, depth in kinds]
        with BagWriter(folder, topics) as writer:
            for topic, offset, data in drive(agent, self.seconds):
                writer.add(topic, offset, data)
            writer.finish()

    def _bridge_settings(self, agent: str) -> dict[str, object]:
        return {**super()._bridge_settings(agent), "publish_gaps": agent not in self.bridged}

    def _receiver(self, node: int) -> None:
        """The recorder in place of what only counts."""
        self._launch_recorder(node)

    def _launch_recorder(self, node: int) -> None:
        names = [
            (pattern, pattern.format(agent=agent.replace("-", "_")))
            for pattern in TOPICS
            for agent in (AGENTS if pattern == POSE else AGENTS[:1])
        ]
        topics, recorded = [], []
        for pattern, name in names:
            kind, storage, durability = TOPICS[pattern]
            topics.append({"name": name, "type": kind, "durability": durability})
            recorded.append({"name": name, "storage": storage})
        around = [{**topic, "before_seconds": BEFORE_SECONDS, "after_seconds": 1} for topic in recorded]
        recording = {"kind": "recording", "volume": "recordings"}
        settings = {
            "name": "cloud-0/recorder",
            "topics": [*topics, {"name": POSE, "type": bags.POSE_TYPE}],
            "rules": [
                {"name": "everything", "kind": "always"},
                {"name": "near", "kind": "proximity", "topic": POSE, "start_distance_m": NEAR_M, "stop_distance_m": 60},
            ],
            "reactions": [
                {**recording, "rule": "everything", "recording": RECORDING, "topics": recorded},
                {**recording, "rule": "near", "recording": ENCOUNTER, "topics": around},
            ],
        }
        place = self.nodes.pod(node)
        self.recorder_address = self.nodes.address(node, place)
        self.recorder = self._launch(
            "recorder", node, "cloud-0", "event-detector", "robotkube.robots.detector", settings, place
        )

    def _environment(self, agent: str, node: int, name: str) -> dict[str, str]:
        environment = super()._environment(agent, node, name)
        if name != "event-detector":
            return environment
        folder = Path(environment["ROBOTKUBE_SECRETS"]) / "database"
        folder.mkdir(exist_ok=True)
        values = {
            **vars(self._account),
            "host": self.nodes.gateway(node),
            "authenticationDatabase": self._account.authentication_database,
        }
        for key in ("username", "password", "host", "port", "database", "authenticationDatabase"):
            (folder / key).write_text(str(values[key]))
        return {**environment, "NODE_NAME": "cloud-0", "ROBOTKUBE_RECORDINGS": str(self.claim)}


def answers(address: str) -> bool:
    """Return whether the probe of a pod says that it is ready."""
    connection = http.client.HTTPConnection(address, 8081, timeout=1)
    try:
        connection.request("GET", "/readyz")
        return connection.getresponse().status == http.HTTPStatus.OK
    except OSError:
        return False
    finally:
        connection.close()


def place(agent: str, offset: int) -> scene.Place:
    """Two lanes, 40 m apart at the begin, 1 m/s each."""
    seconds = offset / SECOND
    if agent == AGENTS[0]:
        return scene.Place(seconds - 20.0, -4.0, 0.0)
    return scene.Place(20.0 - seconds, 4.0, 3.14159)


def drive(agent: str, seconds: float) -> Iterator[tuple[str, int, bytes]]:
    """Topic, time (ns) and message of a bag, in the order of the times."""
    stamps = [(offset, 0) for offset in range(0, int(seconds * SECOND), SECOND // POSE_HZ)]
    if agent == AGENTS[0]:
        stamps += [(offset, 1) for offset in range(5_000_000, int(seconds * SECOND), SECOND // CLOUD_HZ)] + [(0, 2)]
    poses = messages.PoseWriter()
    rays = scene.ray_directions(POINTS)
    clouds = messages.CloudWriter(FRAME, len(rays))
    noise = rays[:, 0] * 0
    base = agent.replace("-", "_")
    for offset, kind in sorted(stamps):
        own = place(agent, offset)
        if kind == 0:
            yield POSE.format(agent=base), offset, poses.message(offset, own.x, own.y, own.yaw)
        elif kind == 1:
            seen = scene.cast(rays, MOUNT, own, [place(AGENTS[1], offset)], noise)
            yield CLOUD.format(agent=base), offset, clouds.message(offset, seen)
        else:
            yield TRANSFORM.format(agent=base), offset, messages.transform(offset, base, FRAME, MOUNT)
