"""`robotkube recording ...` on recordings in memory: tables, refusals and what a person is told."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.cli.output import Table, write
from robotkube.cli.platform import Platform
from robotkube.cli.recordings import commands as cli_recordings
from robotkube.errors import InputError, RefusalError, UnavailableError
from robotkube.robots.recording.core.documents import SegmentPlace

POSE, CLOUD = "/vehicles/vehicle_00/pose", "/vehicles/vehicle_00/lidar_center/pointcloud"
STAMPS = (100, 200, 300, 400)
NAME = "lidar-proximity-3e07ce"


def payload(topic: str, stamp: int) -> bytes:
    return f"{topic} {stamp}".encode()


def digest(topic: str, stamp: int) -> str:
    return hashlib.sha256(payload(topic, stamp)).hexdigest()


class Services(Platform):
    """A platform of which there are two Services, each in a namespace of its own."""

    def __init__(self) -> None:
        self._namespace = "robotkube"

    def _read(
        self, method: str, path: str, query: Sequence[tuple[str, str]] = (), body: Any = None
    ) -> Mapping[str, Any]:
        addresses = {"robotkube/services/database": "10.96.0.7", "managed/services/mongo": "10.96.0.8"}
        return {"spec": {"clusterIP": addresses[path.removeprefix("/api/v1/namespaces/")]}}


class Away:
    """A database that does not answer."""

    def recordings(self) -> Any:
        raise UnavailableError("no answer")


def audit(topic: str, received: int, **values: Any) -> dict[str, Any]:
    numbers = {"received": received, "stored": received, "early": 0, "duplicates": 0, "dropped": 0}
    return {"topic": topic, **numbers, "gaps": [], "closed": True, **values}


class Memory:
    """A database with one recording, and its segments."""

    def __init__(self, name: str = NAME, ended: int | None = 9_000_000_000) -> None:
        topics = {POSE: {"type": "p", "storage": "document"}, CLOUD: {"type": "c", "storage": "segment"}}
        provenance = {"task": "cloud-0/near", "event": "3e07ce"}
        self.document: dict[str, Any] = {
            "_id": name, "started": 4_000_000_000, "ended": ended, "topics": topics, "provenance": provenance,
            "volumes": ["cloud-0/recordings"], "counts": {"documents": 4, "segments": 4, "dropped": 0},
        }  # fmt: skip
        self.samples = [
            {"stamp": stamp, "sha256": digest(POSE, stamp), "data": payload(POSE, stamp)} for stamp in STAMPS
        ]
        self.entries = [
            {"topic": CLOUD, "stamp": stamp, "sha256": digest(CLOUD, stamp), "size": len(payload(CLOUD, stamp)),
             "volume": "cloud-0/recordings", "segment": "one.mcap", "offset": stamp, "stored": 5_000_000_000}
            for stamp in STAMPS[1:]
        ]  # fmt: skip

        self.bucket = ""
        self.files = [
            {"_id": "f", "volume": "cloud-0/recordings", "segment": "one.mcap", "sha256": "whole", "size": 4000}
        ]
        self.told = [audit(POSE, 4), audit(CLOUD, 3)]

    def recordings(self) -> Sequence[Mapping[str, Any]]:
        return [self.document]

    def buckets(self, recording: str) -> Iterable[Mapping[str, Any]]:
        bucket = {"topic": POSE, "samples": self.samples}
        content = "".join(f"{sample['stamp']}:{sample['sha256']};" for sample in self.samples)
        name = self.bucket or hashlib.sha256(content.encode()).hexdigest()[:16]
        return [{"_id": f"{recording}/{POSE}/0/{name}", **bucket}]

    def index(self, recording: str) -> Iterable[Mapping[str, Any]]:
        return [
            {"_id": f"{recording}/{CLOUD}/{entry['offset']}", "recording": recording, **entry} for entry in self.entries
        ]

    def segments(self, recording: str) -> Sequence[Mapping[str, Any]]:
        return self.files

    def audits(self, recording: str) -> Sequence[Mapping[str, Any]]:
        return self.told

    def manifests(self, recording: str) -> Sequence[Mapping[str, Any]]:
        return []

    def digest(self, volume: str, segment: str) -> tuple[str, int]:
        return "whole", 4000

    def notes(self, volume: str, recording: str) -> Mapping[str, Sequence[str]]:
        return {}

    def read(self, volume: str, place: SegmentPlace, size: int) -> bytes:
        if volume != "cloud-0/recordings":
            raise UnavailableError(f"{volume}: is away")
        return payload(CLOUD, place.offset)


@pytest.fixture
def ledgers(tmp_path: Path) -> Path:
    for topic in (POSE, CLOUD):
        lines = [{"sequence": n, "stamp": s, "sha256": digest(topic, s)} for n, s in enumerate(STAMPS)]
        text = "\n".join(json.dumps(line) for line in [*lines, {"end": True, "count": len(lines)}])
        (tmp_path / f"{topic.replace('/', '__')}.jsonl").write_text(text)
    return tmp_path


def verified(memory: Memory, folder: Path, window: tuple[int, int] | None = None) -> Table:
    return cli_recordings.verified({"cloud-0": memory}, memory, NAME, [folder], window)


@pytest.mark.parametrize(
    ("host", "address", "way"),
    [
        (
            "database.robotkube.svc.cluster.local",
            "10.96.0.7",
            "kubectl -n robotkube port-forward service/database 27018",
        ),
        ("mongo.managed.svc", "10.96.0.8", "kubectl -n managed port-forward service/mongo 27018"),
        ("mongo.example.com", "mongo.example.com", "give with --database HOST:PORT where it is"),
    ],
)
def test_a_database_is_reached_where_its_account_says(host: str, address: str, way: str) -> None:
    assert Services().address_of({"host": host, "port": "27018"}) == (address, 27018)
    unreachable: Any = Away()
    with pytest.raises(UnavailableError, match=f"is {address}:27018 in reach from here\\? Else (run `)?{way}"):
        cli_recordings._Explained(unreachable, f"{address}:27018", host, "27018").recordings()


def test_a_service_that_is_not_there_is_named() -> None:
    with pytest.raises(InputError, match=r"^no Service away in namespace managed$"):
        Services().address_of({"host": "away.managed.svc", "port": "27018"})


def test_the_list_has_the_oldest_first_and_names_the_agent() -> None:
    younger = Memory("younger", ended=None)
    younger.document["started"] = 6_000_000_000
    table = cli_recordings.listed({"cloud-1": younger, "cloud-0": Memory()})
    shown = [(row["recording"], row["agent"], row["state"], row["seconds"]) for row in table.rows]
    assert shown == [(NAME, "cloud-0", "ended", 5.0), ("younger", "cloud-1", "open", None)]
    assert table.rows[0]["started"] == "1970-01-01T00:00:04Z"


def test_show_has_provenance_and_first_stored() -> None:
    (row,) = cli_recordings.shown({"cloud-0": Memory()}, NAME).rows
    assert row["provenance"]["event"] == "3e07ce"
    assert row["first_stored"] == {CLOUD: "1970-01-01T00:00:05Z"}


def test_an_unknown_recording_is_refused() -> None:
    with pytest.raises(RefusalError, match="there is no recording other"):
        cli_recordings.shown({"cloud-0": Memory()}, "other")


def test_a_name_that_two_agents_have_is_refused_until_one_is_chosen() -> None:
    changed = Memory()
    changed.samples[0]["data"] = b"other"
    readers = {"cloud-0": Memory(), "cloud-1": changed}
    with pytest.raises(InputError, match=f"{NAME} was recorded by cloud-0, cloud-1, each its own; say by --agent"):
        cli_recordings.verified(readers, changed, NAME, [], None)
    assert cli_recordings.verified({"cloud-1": changed}, changed, NAME, [], None).refusal


def test_stamps_and_digests_that_were_changed_in_the_database_are_named() -> None:
    memory = Memory()
    (before,) = memory.buckets(NAME)
    memory.bucket = before["_id"].rpartition("/")[2]
    memory.samples[0] |= {"data": b"forged", "sha256": hashlib.sha256(b"forged").hexdigest()}
    memory.entries[0]["stamp"] += 1
    refusal = cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None).refusal
    assert (
        f"2 documents have other stamps or digests than they were stored with; the first: ['{before['_id']}']"
        in refusal
    )
    memory.bucket = ""
    refusal = cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None).refusal
    assert (
        f"1 documents have other stamps or digests than they were stored with; the first: ['{NAME}/{CLOUD}/200']"
        in refusal
    )


def test_what_no_audit_tells_of_is_not_proved() -> None:
    memory = Memory()
    memory.told = memory.told[:1]
    refusal = cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None).refusal
    assert refusal == f"{NAME}: {CLOUD}: no audit says what was received"
    memory.samples, memory.entries, memory.files, memory.told = [], [], [], []
    refusal = cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None).refusal
    assert "nothing is stored, and no audit says what was received" in refusal


@pytest.mark.parametrize(
    "content",
    [
        b"\xff\xfe",
        b"[1]",
        b'{"sequence": 1, "stamp": "soon", "sha256": "a"}',
        b'{"sequence": 1, "stamp": [], "sha256": 1}',
    ],
)
def test_a_damaged_ledger_is_named(ledgers: Path, content: bytes) -> None:
    file = ledgers / f"{POSE.replace('/', '__')}.jsonl"
    file.write_bytes(content)
    with pytest.raises(InputError, match=str(file)):
        verified(Memory(), ledgers)


def test_an_equal_recording_is_complete_within_the_clouds_window(ledgers: Path) -> None:
    table = verified(Memory(), ledgers)
    assert table.refusal == ""
    assert {row["topic"]: (row["published"], row["stored"]) for row in table.rows} == {CLOUD: (3, 3), POSE: (3, 4)}


def test_a_given_window_counts(ledgers: Path) -> None:
    table = verified(Memory(), ledgers, (100, 400))
    assert {row["topic"]: row["lost"] for row in table.rows} == {CLOUD: 1, POSE: 0}
    assert f"{CLOUD}: 1 missing without explanation, 1 of the ledger not stored" in table.refusal


def test_a_lost_a_changed_and_an_unreadable_message_are_refused(ledgers: Path) -> None:
    memory = Memory()
    del memory.samples[2]
    memory.samples[1]["data"] = b"other"
    memory.entries[1]["volume"] = "cloud-9/recordings"
    table = verified(memory, ledgers)
    rows = {row["topic"]: row for row in table.rows}
    assert rows[POSE]["unexplained"] == 1
    assert (rows[POSE]["lost"], rows[POSE]["mismatches"], rows[CLOUD]["unreadable"]) == (1, 1, 1)
    assert "cloud-9/recordings: is away (--segments" in table.refusal


def test_without_ledgers_checksums_and_audits_are_proved() -> None:
    memory = Memory()
    table = cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None)
    assert table.refusal == ""
    assert [(row["received"], row["stored"], row["published"]) for row in table.rows] == [(3, 3, None), (4, 4, None)]


def test_what_was_received_is_the_sum_of_what_stands_beside_it() -> None:
    """RECEIVED 218, STORED 208 and COMPLETE true, and nothing said that ten had come before the begin."""
    memory = Memory()
    gap = {"where": "queue", "why": "full", "count": 1, "first": 300, "last": 400}
    memory.told[1] = audit(CLOUD, 16, stored=3, early=10, duplicates=2, dropped=1, gaps=[gap])
    heading, *lines = written(cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None))
    assert heading.split()[:7] == ["TOPIC", "RECEIVED", "STORED", "EARLY", "REPEATED", "DROPPED", "MISSING"]
    received, stored, early, repeated, dropped = map(int, lines[0].split()[1:6])
    assert (received, early, repeated, dropped) == (16, 10, 2, 1)
    assert received == stored + early + repeated + dropped


def without_clouds() -> Memory:
    """A recording that lists clouds, and got none, nor a transform of any vehicle."""
    memory = Memory()
    memory.entries = []
    memory.files = []
    memory.told = memory.told[:1]
    memory.document["topics"]["/vehicles/{agent}/transform"] = {"type": "t", "storage": "document", "latched": True}
    return memory


def test_a_topic_without_a_message_has_a_row_and_is_not_called_complete(ledgers: Path) -> None:
    """COMPLETE true and exit code 0, and not a word about two of three topics."""
    table = cli_recordings.verified({"cloud-0": without_clouds()}, without_clouds(), NAME, [], None)
    assert table.refusal == ""
    assert table.reservation.endswith(
        f"no messages of {CLOUD}, /vehicles/{{agent}}/transform: whether there was anything to record, the recording "
        "does not say"
    )
    rows = {row["topic"]: row for row in table.rows}
    assert rows[POSE]["complete"] is True
    for silent in (CLOUD, "/vehicles/{agent}/transform"):
        assert (rows[silent]["received"], rows[silent]["stored"], rows[silent]["complete"]) == (0, 0, None)
    lines = [line for line in written(table) if line.endswith("no messages")]
    assert [line.split()[:3] for line in lines] == [
        [silent, "0", "0"] for silent in (CLOUD, "/vehicles/{agent}/transform")
    ]
    published = cli_recordings.verified({"c": without_clouds()}, without_clouds(), NAME, [ledgers], (100, 400))
    assert f"{CLOUD}: 4 missing without explanation, 4 of the ledger not stored" in published.refusal


def test_show_names_topics_without_a_message() -> None:
    (row,) = cli_recordings.shown({"cloud-0": without_clouds()}, NAME).rows
    assert row["no_messages"] == [CLOUD, "/vehicles/{agent}/transform"]
    (row,) = cli_recordings.shown({"cloud-0": Memory()}, NAME).rows
    assert row["no_messages"] == []


def test_what_a_killed_writer_received_is_not_shown_as_if_it_were_known() -> None:
    memory = Memory()
    gap = {"where": "recorder", "why": "killed", "count": None, "first": 250, "last": 350}
    memory.told[0] = audit(POSE, 2, gaps=[gap])
    rows = {row["topic"]: row for row in cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None).rows}
    assert (rows[POSE]["received"], rows[POSE]["stored"], rows[CLOUD]["received"]) == (None, 4, 3)
    (shown,) = cli_recordings.shown({"cloud-0": memory}, NAME).rows
    assert (shown["audits"][POSE]["received"], shown["audits"][CLOUD]["received"]) == (None, 3)


def test_the_list_accounts_for_everything_that_was_received() -> None:
    memory = Memory()
    memory.document["counts"] = {
        "offered": 218, "early": 10, "dropped": 3, "duplicates": 2, "documents": 103, "segments": 100,
    }  # fmt: skip
    (row,) = cli_recordings.listed({"cloud-0": memory}).rows
    names = ("documents", "segments", "early", "repeated", "dropped")
    assert row["received"] == sum(row[name] for name in names) == 218
    heading = written(cli_recordings.listed({"cloud-0": memory}))[0].lower().split()
    assert {"received", *names} <= set(heading)


def written(table: Table) -> list[str]:
    """The lines that people get."""
    stream = io.StringIO()
    write(table, "table", stream)
    return stream.getvalue().splitlines()


def test_gaps_unexplained_losses_changed_files_and_open_recordings_are_refused() -> None:
    memory = Memory(ended=None)
    gap = {"where": "spool", "why": "disk full: 1.bson", "count": 2, "first": 300, "last": 400}
    memory.told = [audit(POSE, 6, dropped=2, gaps=[gap]), audit(CLOUD, 4)]
    memory.files[0]["sha256"] = "other"
    table = cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None)
    rows = {row["topic"]: row for row in table.rows}
    assert (rows[POSE]["missing"], rows[POSE]["gaps"], rows[POSE]["unexplained"]) == (2, [gap], 0)
    assert (rows[CLOUD]["missing"], rows[CLOUD]["unexplained"]) == (0, 1)
    for text in (
        "has not ended", f"{POSE}: 1 gaps", f"{CLOUD}: 1 missing without explanation",
        "one.mcap: is not the file that was finished",
    ):  # fmt: skip
        assert text in table.refusal


def test_a_loss_that_a_gap_covers_is_explained(ledgers: Path) -> None:
    memory = Memory()
    del memory.samples[2]
    gap = {"where": "recorder", "why": "killed", "count": None, "first": 250, "last": 350}
    memory.told[0] = audit(POSE, 3, gaps=[gap])
    (row,) = [row for row in verified(memory, ledgers).rows if row["topic"] == POSE]
    assert (row["lost"], row["unexplained"], row["complete"]) == (1, 0, False)


def test_a_topic_without_ledger_is_no_success(ledgers: Path) -> None:
    (ledgers / f"{POSE.replace('/', '__')}.jsonl").unlink()
    assert f"no ledger was given of: {POSE}" in verified(Memory(), ledgers).refusal


def test_without_any_ledger_the_expected_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no ledger of a topic .* __vehicles__vehicle_00__lidar_center__pointcloud"):
        verified(Memory(), tmp_path)


def test_without_large_messages_the_window_must_be_said(ledgers: Path) -> None:
    memory = Memory()
    memory.entries = []
    with pytest.raises(InputError, match="--window FIRST:LAST"):
        verified(memory, ledgers)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--segments", "recordings"], "must be <node>/<claim>=<existing folder>"),
        (["--window", "9:3"], "the first not later"),
        (["--window", "²:³"], "two stamps in ns"),
    ],
)
def test_wrong_arguments_are_named(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["recording", "verify", NAME, "--ledgers", ".", *arguments]) == cli.EXIT_USAGE
    assert message in capsys.readouterr().err


def test_an_incomplete_recording_shows_its_table_and_ends_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = Table("topics", ("topic",), [{"topic": POSE}], refusal="differs")
    monkeypatch.setattr(cli_recordings, "verify_one", lambda options: table)
    assert cli.main(["recording", "verify", NAME]) == cli.EXIT_REFUSED
    out, err = capsys.readouterr()
    assert POSE in out
    assert err == "robotkube: differs\n"


def test_a_recording_that_nothing_speaks_against_but_no_seal_proves_has_an_exit_code_of_its_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    memory = Memory()
    table = cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None)
    monkeypatch.setattr(cli_recordings, "verify_one", lambda options: table)
    assert cli.main(["recording", "verify", NAME]) == cli.EXIT_UNPROVED == 4
    assert f"robotkube: {NAME}: has no manifest: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("form", "word"), [("json", '"complete": false'), ("yaml", "complete: false"), ("table", "false")]
)
def test_an_incomplete_topic_is_false_for_programs_too(form: str, word: str) -> None:
    """Not the text "false", which programs take for true."""
    memory = Memory()
    text = io.StringIO()
    gap = {"where": "recorder", "why": "killed", "count": None, "first": 250, "last": 350}
    memory.told[0] = audit(POSE, 3, gaps=[gap])
    write(cli_recordings.verified({"cloud-0": memory}, memory, NAME, [], None), form, text)
    assert word in text.getvalue()


def test_ledgers_accuse_neither_padding_nor_a_stamp_of_reception(ledgers: Path) -> None:
    """A topic of std_msgs/String: no header, and the middleware fills it up to a multiple of four bytes."""
    memory = Memory()
    published = [f"text {number:04}".encode() + b"." for number in range(len(STAMPS))]
    lines: list[dict[str, Any]] = [
        {"sequence": n, "stamp": STAMPS[n], "sha256": hashlib.sha256(data).hexdigest()}
        for n, data in enumerate(published)
    ]
    text = "\n".join(json.dumps(one) for one in [*lines, {"end": True, "count": len(lines)}])
    (ledgers / f"{POSE.replace('/', '__')}.jsonl").write_text(text)
    padded = [data + bytes(2) for data in published]
    memory.samples = [
        {"stamp": s + 7, "received": s + 7, "sha256": hashlib.sha256(data).hexdigest(), "data": data}
        for s, data in zip(STAMPS, padded, strict=True)
    ]
    table = verified(memory, ledgers, (200, 400))
    assert table.refusal == ""
    (row,) = [row for row in table.rows if row["topic"] == POSE]
    assert (row["published"], row["lost"], row["unknown"], row["mismatches"]) == (3, 0, 0, 0)
