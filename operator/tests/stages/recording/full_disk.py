"""A recording without database on a disk that is too small, and what is left of it when the database is back.

    python -m tests.stages.recording.full_disk CLAIM SECONDS_MAX

Prints a JSON document: counts, found messages by topic, audits.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from robotkube.robots.recording.adapters.volume_claim import MountedVolumeClaim
from robotkube.robots.recording.core.plans import RecordedTopic, RecordingPlan
from robotkube.robots.recording.loops.destinations import RecorderPlace, RecordingBounds
from robotkube.robots.recording.loops.recordings import Recordings
from robotkube.robots.ros.core.ring_buffers import Sample
from robotkube.robots.ros.core.topic_patterns import TopicPattern
from robotkube.testing.recordings import RecordingDatabase

PLAN = RecordingPlan("r", "task-1", "claim", (RecordedTopic(TopicPattern("/pose"), "t", "document", latched=True),))
MESSAGES, BYTES, BATCH = 12_000, 1000, 400


def main() -> None:
    """Offer 12 MB, wait until they are spooled or given up, bring the database back."""
    claim = Path(sys.argv[1])
    deadline = time.monotonic() + float(sys.argv[2])
    database = RecordingDatabase(away=True)
    place = RecorderPlace(
        "n/claim",
        lambda: database,
        lambda: MountedVolumeClaim(claim, "task-1", time.time_ns),
        time.time_ns,
        time.monotonic,
    )
    recordings = Recordings(PLAN, place, {}, RecordingBounds(waiting_bytes=300_000))
    recordings.start()
    for number in range(MESSAGES):
        recordings.offer("/pose", "t", Sample(number, number, bytes(BYTES)))
        while number % BATCH == 0 and recordings.counts()["documents"] < number and time.monotonic() < deadline:
            time.sleep(0.01)
    while recordings.waiting and time.monotonic() < deadline:
        time.sleep(0.01)
    database.away = False
    complete = recordings.stop(10.0)
    stamps = sorted(sample["stamp"] for bucket in database.buckets("task-1") for sample in bucket["samples"])
    audits = list(database.audits("task-1"))
    json.dump({"complete": complete, "found": stamps, "audits": audits, "counts": recordings.counts()}, sys.stdout)


if __name__ == "__main__":
    main()
