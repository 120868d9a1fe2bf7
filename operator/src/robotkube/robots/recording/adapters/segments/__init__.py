"""Large messages in MCAP files below a volume claim, readable at any moment and after a crash.

Written without chunks: every message is a record of its own in the file, so an index entry (file, offset) finds it
without the file's own index, and a file whose writer was killed lacks only its footer (MCAP specification, "Message
record"). Layout on the volume: `<recording>/<ns>-<number>.mcap`; ns is when the writer started, so a second writer of
the same recording never touches the first one's files. A writer holds a lock on its file (flock): what is not locked
and has no footer was left by a killed one, and is repaired.
"""

from robotkube.robots.recording.adapters.segments.reading import McapSegmentReader
from robotkube.robots.recording.adapters.segments.recovery import McapRepair
from robotkube.robots.recording.adapters.segments.writing import McapSegments

__all__ = ["McapRepair", "McapSegmentReader", "McapSegments"]
