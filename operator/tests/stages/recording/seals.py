"""What the manifests of a recording say of everything that is stored of it."""

from __future__ import annotations

from robotkube.robots.recording.core.seals import SealExamination
from robotkube.robots.recording.loops.reading import begin_examination, stored_messages
from robotkube.robots.recording.ports import RecordingReader, SegmentReader


def examined(reader: RecordingReader, segments: SegmentReader, recording: str) -> SealExamination:
    """The examination of a recording that is there, after everything was checked."""
    (document,) = (one for one in reader.recordings() if one["_id"] == recording)
    seals = begin_examination(reader, segments, document)
    for _ in stored_messages(reader, segments, recording, seen=seals.check):
        pass
    return seals
