"""A process that records what it invents, for tests that kill it: writes a ledger line before each message it offers.

python -m tests.stages.recording.recording_writer PORT CLAIM SECONDS
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
from pathlib import Path

from robotkube.foundation.database.adapters.connection import DatabaseLogin, connect
from robotkube.robots.recording.adapters.mongodb import PymongoRecordingStore
from robotkube.robots.recording.adapters.volume_claim import MountedVolumeClaim
from robotkube.robots.recording.core.plans import RecordedTopic, RecordingPlan
from robotkube.robots.recording.loops.destinations import RecorderPlace
from robotkube.robots.recording.loops.recordings import Recordings
from robotkube.robots.ros.core.ring_buffers import Sample
from robotkube.robots.ros.core.topic_patterns import TopicPattern

RECORDING, VOLUME, DATABASE = "task-1", "cloud-0/recordings", "recordings_cloud_0"
SIZES = {"/pose": 100, "/cloud": 320_000}
PLAN = RecordingPlan(
    "everything",
    RECORDING,
    "recordings",
    (
        RecordedTopic(TopicPattern("/pose"), "geometry_msgs/msg/PoseStamped", "document"),
        RecordedTopic(TopicPattern("/cloud"), "sensor_msgs/msg/PointCloud2", "segment"),
    ),
)
PACE_SECONDS = 0.002
CLOUD_EVERY = 5


def main() -> None:
    """Record for SECONDS, then end as it should."""
    port = int(sys.argv[1])
    claim = Path(sys.argv[2])
    seconds = float(sys.argv[3])
    account = DatabaseLogin("127.0.0.1", port, DATABASE, "recorder", "secret", DATABASE)
    place = RecorderPlace(
        VOLUME,
        lambda: PymongoRecordingStore(connect(account)),
        lambda: MountedVolumeClaim(claim, RECORDING, time.time_ns),
        time.time_ns,
        time.monotonic,
    )
    recordings = Recordings(PLAN, place, {})
    recordings.start()
    end = time.monotonic() + seconds
    number = 0
    while time.monotonic() < end:
        for topic in ("/pose", "/cloud") if number % CLOUD_EVERY == 0 else ("/pose",):
            _publish(recordings, topic)
        number += 1
        time.sleep(PACE_SECONDS)
    if not recordings.stop(30.0):
        sys.exit(f"did not end: {recordings.failed or recordings.counts()}")


def _publish(recordings: Recordings, topic: str) -> None:
    data = os.urandom(SIZES[topic])
    stamp = time.time_ns()
    sys.stdout.write(f"{topic} {stamp} {hashlib.sha256(data).hexdigest()}\n")
    sys.stdout.flush()
    recordings.offer(topic, PLAN.topics[topic == "/cloud"].type, Sample(stamp, stamp, data))


if __name__ == "__main__":
    main()
