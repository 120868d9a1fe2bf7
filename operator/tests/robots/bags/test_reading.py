"""Bags of all kinds, written by other programs (rosbags, the mcap library): all forms of storage and compression,
unsorted, cut off, corrupted."""

from __future__ import annotations

import random
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from robotkube.errors import InputError
from robotkube.robots.bags.adapters.reading import open_bag
from robotkube.robots.bags.adapters.reading.opening import COMPLAINTS_MAX
from robotkube.robots.detector.adapters.bag_messages import read_bag
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from tests.stages.examples import EXAMPLES

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = {
    "/vehicles/vehicle_00/pose": "geometry_msgs/msg/PoseStamped",
    "/vehicles/vehicle_00/odometry": "nav_msgs/msg/Odometry",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/words": "std_msgs/msg/String",
}
COUNT = 120
CORRUPTIONS = EXAMPLES
CORRUPTIONS_THOROUGH = 4000

Message = tuple[str, int, bytes]


def payload(type_name: str, number: int) -> bytes:
    """A message that differs from every other one."""
    if type_name == "std_msgs/msg/String":
        return bytes(STORE.serialize_cdr(STORE.types[type_name](data=f"word {number}" * 20), type_name))
    header = STORE.types["std_msgs/msg/Header"](
        stamp=STORE.types["builtin_interfaces/msg/Time"](sec=number, nanosec=5), frame_id="map"
    )
    if type_name == "diagnostic_msgs/msg/DiagnosticArray":
        return bytes(STORE.serialize_cdr(STORE.types[type_name](header=header, status=[]), type_name))
    text = b"\0\1\0\0" + number.to_bytes(4, "little") + bytes(4) + b"\4\0\0\0map\0" + bytes(8)
    return text + number.to_bytes(8, "little") * (7 if "Pose" in type_name else 90)


def messages() -> list[Message]:
    """In the order of their times."""
    topics = list(TYPES)
    return [(topics[n % 4], 1_000_000 * n + 7, payload(TYPES[topics[n % 4]], n)) for n in range(COUNT)]


def write_rosbag(folder: Path, storage: StoragePlugin, mode: CompressionMode, version: int = 9) -> None:
    """By the library rosbags."""
    writer = BagWriter(folder, version=version, storage_plugin=storage)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {name: writer.add_connection(name, kind, typestore=STORE) for name, kind in TYPES.items()}
        for name, moment, data in messages():
            writer.write(connections[name], moment, data)


def write_mcap(
    path: Path,
    compression: CompressionType = CompressionType.ZSTD,
    written: list[Message] | None = None,
    chunking: bool = True,
    index: IndexType = IndexType.ALL,
) -> None:
    """By the mcap library, small chunks."""
    with path.open("wb") as output:
        writer = Writer(output, 2000, compression, index_types=index, use_chunking=chunking)
        writer.start("ros2", "test")
        channels = {}
        for name, kind in TYPES.items():
            text, _ = STORE.generate_msgdef(kind, ros_version=2)
            channels[name] = writer.register_channel(
                name, "cdr", writer.register_schema(kind, "ros2msg", text.encode())
            )
        for name, moment, data in messages() if written is None else written:
            writer.add_message(channels[name], moment, data, moment)
        writer.finish()


def read(path: Path, wanted: set[str] | None = None) -> tuple[list[Message], list[str]]:
    """Messages and complaints."""
    complaints: list[str] = []
    with open_bag(path, complaints.append) as bag:
        return list(bag.messages(wanted)), complaints


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("version", [8, 9])
def test_bags_of_another_program(storage: StoragePlugin, mode: CompressionMode, version: int, tmp_path: Path) -> None:
    if storage is StoragePlugin.MCAP and mode is CompressionMode.MESSAGE:
        mode = CompressionMode.STORAGE
    write_rosbag(tmp_path / "bag", storage, mode, version)
    with open_bag(tmp_path / "bag") as bag:
        assert list(bag.messages()) == messages()
        chosen = {"/diagnostics", "/words"}
        assert list(bag.messages(chosen)) == [message for message in messages() if message[0] in chosen]
        assert {topic.name: topic.type for topic in bag.topics} == TYPES
        assert {topic.reliability for topic in bag.topics} == {"reliable"}
        reader = Layouts(bag.definitions.__getitem__).reader("nav_msgs/msg/Odometry", ["header.stamp"])
        assert reader(payload("nav_msgs/msg/Odometry", 9)) == (9_000_000_000,)


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunking", [True, False])
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.CHUNK, IndexType.NONE])
def test_single_files_in_any_order(
    compression: CompressionType, chunking: bool, index: IndexType, tmp_path: Path
) -> None:
    mixed = messages()
    random.Random(7).shuffle(mixed)  # noqa: S311
    write_mcap(tmp_path / "one.mcap", compression, mixed, chunking, index)
    assert read(tmp_path / "one.mcap") == (messages(), [])
    read_messages, _ = read(tmp_path / "one.mcap", {"/words"})
    assert read_messages == [message for message in messages() if message[0] == "/words"]


def change_tables(bag: Path, statement: str) -> None:
    with sqlite3.connect(bag / "bag.db3") as database:
        database.execute(statement)
    database.close()


def test_unsorted_tables_are_read_in_order(tmp_path: Path) -> None:
    write_rosbag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.NONE)
    change_tables(tmp_path / "bag", "UPDATE messages SET timestamp = 1000000000 - timestamp")
    read_messages, complaints = read(tmp_path / "bag")
    assert [m for m, _, _ in read_messages] == [name for name, _, _ in reversed(messages())]
    assert [t for _, t, _ in read_messages] == sorted(t for _, t, _ in read_messages)
    assert not complaints


FORMLESS = {
    "NULL": (
        "CREATE TABLE others AS SELECT id, name, type, NULL AS serialization_format, offered_qos_profiles FROM topics",
        "DROP TABLE topics",
        "ALTER TABLE others RENAME TO topics",
    ),
    "empty": ("UPDATE topics SET serialization_format = ''",),
    "no column": ("ALTER TABLE topics DROP COLUMN serialization_format",),
}


@pytest.mark.parametrize("form", FORMLESS)
def test_a_serialization_format_may_stand_in_metadata_alone(form: str, tmp_path: Path) -> None:
    """Such a bag was refused, though nothing is wrong with it."""
    write_rosbag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.NONE)
    for statement in FORMLESS[form]:
        change_tables(tmp_path / "bag", statement)
    assert read(tmp_path / "bag") == (messages(), [])
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("serialization_format: cdr", "serialization_format: json"))
    with pytest.raises(InputError, match=r"topic /.* is json by metadata\.yaml; only cdr is read"):
        open_bag(tmp_path / "bag")
    metadata.unlink()
    read_messages, complaints = read(tmp_path / "bag")
    assert read_messages == messages()
    assert [text for text in complaints if "only cdr" in text] == []


def test_split_bags_and_folders_without_metadata(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    write_mcap(folder / "b_0.mcap", written=messages()[::2])
    write_mcap(folder / "b_1.mcap", CompressionType.LZ4, messages()[1::2])
    read_messages, complaints = read(folder)
    assert read_messages == messages()
    assert len(complaints) == 1
    assert "reading b_0.mcap, b_1.mcap" in complaints[0]


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_cut_off_files_are_read_as_far_as_they_go(share: float, compression: CompressionType, tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    write_mcap(path, compression)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(InputError, match="not finished or is cut off"):
        open_bag(path)
    read_messages, complaints = read(path)
    assert read_messages == messages()[: len(read_messages)]
    assert len(read_messages) > (share * COUNT) * 0.4
    assert "its end is missing" in complaints[0]


def test_a_cut_off_database_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    write_rosbag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = tmp_path / "bag" / "bag.db3"
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4 // 4096 * 4096])
    read_messages, complaints = read(tmp_path / "bag")
    assert read_messages
    assert all(message in messages() for message in read_messages)
    assert complaints
    assert any("damaged" in text or "cannot be read" in text for text in complaints)


def test_what_is_no_bag_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("no bag")
    with pytest.raises(InputError, match=r"text.mcap: is no MCAP file"):
        read(tmp_path / "text.mcap")
    (tmp_path / "text.db3").write_text("no bag")
    with pytest.raises(InputError, match=r"text.db3: is no sqlite3 file"):
        read(tmp_path / "text.db3")
    (tmp_path / "text.bag").write_text("#ROSBAG V2.0")
    with pytest.raises(InputError, match="bag of ROS 1; convert it"):
        read(tmp_path / "text.bag")
    (tmp_path / "text").write_text("no bag")
    with pytest.raises(InputError, match="text: is none of mcap, sqlite3; convert it"):
        read(tmp_path / "text")
    with pytest.raises(InputError, match=r"cannot be read .*name a folder or file"):
        read(tmp_path / ("long" * 100))
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="name a rosbag2 folder"):
        read(tmp_path / "folder")


@pytest.mark.parametrize("single", [True, False])
def test_packed_messages_are_known_without_metadata(single: bool, tmp_path: Path) -> None:
    write_rosbag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.MESSAGE)
    if not single:
        (tmp_path / "bag" / "metadata.yaml").unlink()
    read_messages, complaints = read(tmp_path / "bag" / "bag.db3" if single else tmp_path / "bag")
    assert read_messages == messages()
    assert len(complaints) == (0 if single else 1)


def test_files_are_known_by_what_they_hold(tmp_path: Path) -> None:
    write_rosbag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.NONE)
    write_mcap(tmp_path / "one.mcap")
    shutil.copy(tmp_path / "bag" / "bag.db3", tmp_path / "bag_0.db3.active")
    shutil.copy(tmp_path / "one.mcap", tmp_path / "recording")
    assert read(tmp_path / "bag_0.db3.active") == (messages(), [])
    assert read(tmp_path / "recording") == (messages(), [])


def test_a_detector_reads_only_what_it_asks_for(tmp_path: Path) -> None:
    write_mcap(tmp_path / "one.mcap")
    wanted = ("/words", "std_msgs/msg/String")
    read_messages = list(read_bag(tmp_path / "one.mcap", lambda _: None, lambda name, kind: (name, kind) == wanted))
    assert read_messages == [(*wanted, moment, data) for name, moment, data in messages() if name == "/words"]


@pytest.mark.parametrize("ending", [".zstd", ".zst"])
def test_packed_files_may_be_of_several_parts(ending: str, tmp_path: Path) -> None:
    write_mcap(tmp_path / "one.mcap")
    data = (tmp_path / "one.mcap").read_bytes()
    path = tmp_path / f"packed.mcap{ending}"
    pack = zstandard.ZstdCompressor().compress
    path.write_bytes(pack(data[:5000]) + pack(data[5000:]))
    assert read(path) == (messages(), [])


def test_a_bag_that_lies_there_packed_and_unpacked_is_read_once(tmp_path: Path) -> None:
    write_mcap(tmp_path / "one.mcap")
    (tmp_path / "one.mcap.zstd").write_bytes(zstandard.compress((tmp_path / "one.mcap").read_bytes()))
    read_messages, complaints = read(tmp_path)
    assert read_messages == messages()
    assert complaints[0].endswith("reading one.mcap")


def cut_off_packed(folder: Path, share: float) -> Path:
    path = folder / "one.mcap.zstd"
    write_mcap(folder / "one.mcap", CompressionType.NONE, messages() * 30)  # several blocks
    packed = zstandard.compress((folder / "one.mcap").read_bytes())
    path.write_bytes(packed[: int(len(packed) * share)])
    return path


@pytest.mark.parametrize("share", [0.5, 0.9, 0.9999])
def test_cut_off_packed_files_are_named_and_read_as_far_as_they_go(share: float, tmp_path: Path) -> None:
    path = cut_off_packed(tmp_path, share)
    read_messages, complaints = read(path)
    assert set(read_messages) <= set(messages())
    assert len(read_messages) > share * 20 * COUNT
    assert complaints[0].startswith(f"{path}: is cut off; ")
    assert all(text.startswith(f"{path}: ") for text in complaints)


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_packed_files_of_which_nothing_is_left_are_named(share: float, tmp_path: Path) -> None:
    path = cut_off_packed(tmp_path, share)
    complaints: list[str] = []
    with pytest.raises(InputError, match=f"^{path}: is no MCAP file"):
        open_bag(path, complaints.append)
    assert complaints == [f"{path}: is cut off; 0 bytes could be unpacked; what is before is read"]


def test_what_cannot_be_unpacked_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_rosbag(tmp_path / "bag", StoragePlugin.MCAP, CompressionMode.FILE)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match=r"cannot be unpacked to .*nowhere.*TMPDIR"):
        read(tmp_path / "bag")


def test_an_unknown_compression_of_messages_is_said_once(tmp_path: Path) -> None:
    write_rosbag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.MESSAGE)
    path = tmp_path / "bag" / "metadata.yaml"
    path.write_text(path.read_text().replace("zstd", "snappy"))
    read_messages, complaints = read(tmp_path / "bag")
    assert read_messages == messages()  # which are zstd all the same
    assert len(complaints) == 1
    assert "metadata.yaml: compression_format: 'snappy' is not zstd" in complaints[0]


def test_not_every_fault_is_told(tmp_path: Path) -> None:
    write_rosbag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.MESSAGE)
    change_tables(tmp_path / "bag", "UPDATE messages SET data = X'00010000'")
    read_messages, complaints = read(tmp_path / "bag")
    assert (read_messages, len(complaints)) == ([], COMPLAINTS_MAX + 1)
    assert complaints[-1].endswith("the others are not reported")


@pytest.mark.parametrize("refused", ["iterdir", "stat"])
def test_folders_that_may_not_be_read_are_refused(
    refused: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_mcap(tmp_path / "one.mcap")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, refused, refuse)
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path)


def corruptions(count: int) -> Iterator[random.Random]:
    return (random.Random(seed) for seed in range(count))  # noqa: S311


def corrupted(data: bytes, random_: random.Random) -> bytes:
    """Bytes changed, a stretch overwritten, cut out or cut off."""
    changed = bytearray(data)
    for _ in range(random_.randint(1, 8)):
        place = random_.randrange(len(changed))
        match random_.randrange(4):
            case 0:
                changed[place] ^= 1 << random_.randrange(8)
            case 1:
                changed[place : place + 8] = random_.randbytes(8)
            case 2:
                changed[place : place + 8] = b"\xff" * 8
            case 3 if random_.random() < 0.2:
                del changed[place : place + random_.randint(1, 500)]
    return bytes(changed[: random_.randint(1, len(changed))] if random_.random() < 0.2 else changed)


def corrupt_and_read(folder: Path, count: int) -> None:
    """Each time either InputError or messages, all of them of a topic that was asked for; never anything else."""
    sources = folder / "sources"
    sources.mkdir()
    write_mcap(sources / "a.mcap", CompressionType.NONE)
    write_mcap(sources / "b.mcap", CompressionType.ZSTD)
    write_mcap(sources / "c.mcap", CompressionType.LZ4)
    write_mcap(sources / "d.mcap", chunking=False)
    write_rosbag(sources / "e", StoragePlugin.SQLITE3, CompressionMode.NONE)
    shutil.move(sources / "e" / "e.db3", sources / "e.db3")
    write_rosbag(sources / "f", StoragePlugin.SQLITE3, CompressionMode.MESSAGE)
    whole = messages()
    readable = 0
    for random_ in corruptions(count):
        source = random_.choice(["a.mcap", "b.mcap", "c.mcap", "d.mcap", "e.db3", "f"])
        target = folder / source
        if source == "f":
            shutil.copytree(sources / "f", target, dirs_exist_ok=True)
            file = target / random_.choice(["metadata.yaml", "f.db3"])
            file.write_bytes(corrupted((sources / "f" / file.name).read_bytes(), random_))
        else:
            target.write_bytes(corrupted((sources / source).read_bytes(), random_))
        wanted = random_.choice([None, {"/words"}])
        try:
            read_messages, _ = read(target, wanted)
        except InputError:
            continue
        readable += bool(set(read_messages) & set(whole))
        assert len(read_messages) <= 20 * COUNT
    assert readable > count // 3


def test_corrupted_bags_never_crash(tmp_path: Path) -> None:
    corrupt_and_read(tmp_path, CORRUPTIONS)


@pytest.mark.thorough
def test_many_corrupted_bags_never_crash(tmp_path: Path) -> None:
    corrupt_and_read(tmp_path, CORRUPTIONS_THOROUGH)
