"""Segments are MCAP files that other readers understand, finished or not."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from robotkube.errors import UnavailableError
from robotkube.robots.bags.adapters.writing import BagWriter
from robotkube.robots.bags.core.playback import BagTopic
from robotkube.robots.recording.adapters.segments import McapRepair, McapSegmentReader, McapSegments
from robotkube.robots.recording.adapters.volume_claim import MountedVolumeClaim
from robotkube.robots.recording.core.documents import Received, SegmentPlace
from robotkube.robots.recording.loops.segment_repair import repair_segments
from robotkube.robots.ros.adapters.installed_definitions import definition
from robotkube.testing.recordings import RecordingDatabase

CLOUD = "sensor_msgs/msg/PointCloud2"


def message(number: int, topic: str = "/cloud", size: int = 1000) -> Received:
    return Received(topic, number, number + 5, "", bytes([number % 256]) * size)


@pytest.fixture
def open_segments(tmp_path: Path) -> Iterator[Callable[..., McapSegments]]:
    """Makes writers below tmp_path; what a test leaves open is closed after it."""
    made: list[McapSegments] = []

    def make(now: int = 1, bytes_max: int = 10**9) -> McapSegments:
        made.append(McapSegments(tmp_path, "task-1", lambda: now, bytes_max))
        return made[-1]

    yield make
    for segments in made:
        segments.close()


def test_every_message_is_found_by_its_place(tmp_path: Path, open_segments: Callable[..., McapSegments]) -> None:
    segments = open_segments(bytes_max=5000)
    sent = [message(n, f"/cloud{n % 2}", 500 + n) for n in range(20)]
    places = [place for item in sent for place in segments.append([(item, CLOUD)])]
    reader = McapSegmentReader({"cloud-0/recordings": tmp_path})
    assert len({place.segment for place in places}) > 2
    for item, place in zip(sent, places, strict=True):
        assert reader.read("cloud-0/recordings", place, len(item.data)) == item.data


def test_what_writers_noted_is_read_by_the_next_one_and_by_whoever_verifies(tmp_path: Path) -> None:
    volume = MountedVolumeClaim(tmp_path, "task-1", lambda: 1)
    assert volume.noted_of("cloud-0.task-1") == {}
    volume.note("cloud-0.task-1", "12", ["a", "b"])
    volume.note("cloud-0.task-1", "12", ["c"])
    volume.note("cloud-0.task-1", "13", ["d"])
    assert volume.noted_of("cloud-0.task-1") == {"12": ["a", "b", "c"], "13": ["d"]}
    reader = McapSegmentReader({"cloud-0/recordings": tmp_path})
    assert reader.notes("cloud-0/recordings", "cloud-0.task-1") == volume.noted_of("cloud-0.task-1")


def test_finished_segments_are_ordinary_mcap(tmp_path: Path, open_segments: Callable[..., McapSegments]) -> None:
    segments = open_segments()
    for n in range(5):
        segments.append([(message(n), CLOUD)])[0]
    segments.close()
    (path,) = tmp_path.rglob("*.mcap")
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 5
        (schema,) = summary.schemas.values()
        assert schema.name == CLOUD
        assert b"MSG: std_msgs/Header" in schema.data
        assert b"MSG: builtin_interfaces/Time" in schema.data
        assert [m.data for _, _, m in reader.iter_messages()] == [message(n).data for n in range(5)]
        file.seek(0)
        assert [m.publish_time for _, _, m in make_reader(file).iter_messages()] == list(range(5))


def test_an_unfinished_segment_is_read_record_by_record(
    tmp_path: Path, open_segments: Callable[..., McapSegments]
) -> None:
    segments = open_segments()
    for n in range(5):
        segments.append([(message(n), CLOUD)])[0]
    (path,) = tmp_path.rglob("*.mcap")
    with path.open("rb") as file:
        records = itertools.islice(StreamReader(file, record_size_limit=None).records, 3 + 5)
        messages = [record for record in records if isinstance(record, Message)]
    assert [record.data for record in messages] == [message(n).data for n in range(5)]


def test_a_second_writer_of_the_recording_leaves_the_first_ones_files(
    open_segments: Callable[..., McapSegments],
) -> None:
    first = open_segments(now=1)
    one = first.append([(message(1), CLOUD)])[0]
    second = open_segments(now=2)
    two = second.append([(message(2), CLOUD)])[0]
    assert one.segment != two.segment


def test_a_refusing_volume_keeps_what_was_safe_and_goes_on_in_the_same_file(
    tmp_path: Path, open_segments: Callable[..., McapSegments], monkeypatch: pytest.MonkeyPatch
) -> None:
    segments = open_segments()
    (first,) = segments.append([(message(1), CLOUD)])

    def refuse(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("os.fdatasync", refuse)
        with pytest.raises(OSError, match="No space left"):
            segments.append([(message(2), CLOUD)])
    (second,) = segments.append([(message(3), CLOUD)])
    assert second.segment == first.segment
    segments.close()
    (path,) = tmp_path.rglob("*.mcap")
    with path.open("rb") as file:
        assert [m.data for _, _, m in make_reader(file).iter_messages()] == [message(1).data, message(3).data]


def test_what_cannot_be_read_is_named(tmp_path: Path, open_segments: Callable[..., McapSegments]) -> None:
    segments = open_segments()
    place = segments.append([(message(1), CLOUD)])[0]
    reader = McapSegmentReader({"n/c": tmp_path})
    for volume, wrong, size, text in [
        ("edge-0/recordings", place, 1000, "volume claim recordings of node edge-0 is not within reach"),
        ("n/c", SegmentPlace("task-1/none.mcap", 0), 1000, "No such file"),
        ("n/c", SegmentPlace("../../etc/passwd", 0), 1000, "leads out of the volume"),
        ("n/c", SegmentPlace(place.segment, place.offset + 1), 900, "there is no message of 900 bytes"),
        ("n/c", place, 2000, "ends within the message"),
    ]:
        with pytest.raises(UnavailableError, match=text):
            reader.read(volume, wrong, size)


def test_an_unknown_type_has_no_definition(tmp_path: Path) -> None:
    assert definition("own_msgs/msg/Thing", tmp_path) == ""


@pytest.mark.parametrize("cut", [0, 1, 500, 1030, 1500, 2500, 3400])
def test_a_cut_segment_gets_an_end_behind_its_last_whole_record(
    tmp_path: Path, open_segments: Callable[..., McapSegments], cut: int
) -> None:
    segments = open_segments()
    for n in range(5):
        segments.append([(message(n), CLOUD)])
    repair = McapRepair(tmp_path)
    assert repair.unfinished(()) == [], "somebody writes it"
    (path,) = tmp_path.rglob("*.mcap")
    data = path.read_bytes()
    segments.close()
    path.write_bytes(data[: len(data) - cut])
    (name,) = repair.unfinished(())
    messages = repair.messages(name)
    closed = repair.finish(name)
    whole = 5 - -(-cut // (1000 + 31))
    assert closed is not None
    assert len(messages) == closed.messages == whole
    reader = McapSegmentReader({"n/c": tmp_path})
    for n, one in enumerate(messages):
        assert (one.topic, one.stamp, one.received) == ("/cloud", n, n + 5)
        assert reader.read("n/c", one.place, one.size) == message(n).data
    assert reader.digest("n/c", name) == (closed.sha256, closed.size)
    with path.open("rb") as file:
        assert [m.data for _, _, m in make_reader(file).iter_messages()] == [message(n).data for n in range(whole)]
    assert repair.unfinished({name}) == []
    again = repair.finish(name)
    assert again is not None
    assert (again.sha256, again.cut) == (closed.sha256, 0)


def test_a_segment_without_a_whole_message_goes(tmp_path: Path, open_segments: Callable[..., McapSegments]) -> None:
    segments = open_segments()
    segments.append([(message(1), CLOUD)])
    (path,) = tmp_path.rglob("*.mcap")
    data = path.read_bytes()
    segments.close()
    path.write_bytes(data[:-10])
    (name,) = McapRepair(tmp_path).unfinished(())
    assert McapRepair(tmp_path).finish(name) is None
    assert not path.exists()


def test_a_repair_leaves_what_is_not_its_own(tmp_path: Path, open_segments: Callable[..., McapSegments]) -> None:
    segments = open_segments()
    segments.append([(message(1), CLOUD)])
    segments.close()
    (segment,) = McapRepair(tmp_path).unfinished(())
    with BagWriter(
        tmp_path / "encounter-1", [BagTopic("/a", CLOUD, "reliable", "volatile", 1)], compressed=True
    ) as bag:
        bag.add("/a", 1, b"data")
        bag.finish()
    bag_file = tmp_path / "encounter-1" / "bag.mcap"
    assert McapRepair(tmp_path).unfinished(()) == [segment], "an export beside the recordings is none"
    renamed = bag_file.rename(tmp_path / "encounter-1" / "5-0001.mcap")
    notes = tmp_path / "encounter-1" / "6-0001.mcap"
    notes.write_text("somebody's notes")
    kept = [path.read_bytes() for path in (renamed, notes)]
    for path in (renamed, notes):
        with pytest.raises(OSError, match="no message that can be read, but something else"):
            McapRepair(tmp_path).finish(f"encounter-1/{path.name}")
    assert [path.read_bytes() for path in (renamed, notes)] == kept


def test_a_file_that_cannot_be_opened_does_not_hold_up_the_others(
    tmp_path: Path, open_segments: Callable[..., McapSegments]
) -> None:
    segments = open_segments()
    place = segments.append([(message(1), CLOUD)])[0]
    segments.close()
    (tmp_path / "task-1" / "0-0001.mcap").mkdir()
    store = RecordingDatabase()
    for writes in repair_segments(McapRepair(tmp_path), store, "n/c"):
        store.write(writes)
    assert [entry["segment"] for entry in store.index("task-1")] == [place.segment]
    assert [entry["segment"] for entry in store.segments("task-1")] == [place.segment]


def test_finished_segments_do_not_crowd_out_the_others(
    tmp_path: Path, open_segments: Callable[..., McapSegments], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotkube.robots.recording.adapters.segments.recovery.FILES_MAX", 2)
    segments = open_segments(bytes_max=1000)
    names = [segments.append([(message(n), CLOUD)])[0].segment for n in range(4)]
    segments.close()
    assert McapRepair(tmp_path).unfinished(names[1:]) == names[:1]


def test_a_message_that_no_segment_can_hold_is_named(open_segments: Callable[..., McapSegments]) -> None:
    with pytest.raises(ValueError, match="/cloud: its stamp -1 is none"):
        open_segments().append([(message(1), CLOUD), (Received("/cloud", -1, 5, "", b""), CLOUD)])


def test_what_a_writer_notes_stands_beside_its_segments(tmp_path: Path) -> None:
    volume = "cloud-0/recordings"
    claim = MountedVolumeClaim(tmp_path, "owner", lambda: 7)
    reader = McapSegmentReader({volume: tmp_path})
    assert reader.notes(volume, "task-1") == {}
    claim.note("task-1", "7", ["begun"])
    claim.note("task-1", "7", ["sealed", "again"])
    claim.note("task-1", "8", ["begun"])
    claim.note("task-2", "9", ["begun"])
    assert reader.notes(volume, "task-1") == {"7": ["begun", "sealed", "again"], "8": ["begun"]}
    assert not claim.repairs().unfinished(()), "notes are no segments"
    with pytest.raises(UnavailableError, match="not within reach"):
        McapSegmentReader({}).notes(volume, "task-1")
    with pytest.raises(UnavailableError, match="leads out of the volume"):
        reader.notes(volume, "../..")
