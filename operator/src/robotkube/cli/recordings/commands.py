"""The commands `robotkube recording list|show|verify`: recordings, and whether they are what their sources published.

For administrators of the cluster: the accounts come from the Secrets `database-account` of the agents that record, and
the database is reached as the Secret says, a Service at its address, or where `--database` says.
"""

from __future__ import annotations

import argparse
import atexit
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.cli.recordings.volumes import add_argument as add_segments
from robotkube.cli.recordings.volumes import folders_here, volume_place
from robotkube.errors import DocumentError, InputError, RefusalError, UnavailableError
from robotkube.foundation.database.adapters.connection import connect, login_at
from robotkube.foundation.kubernetes.core.service_names import service_of
from robotkube.robots.recording.adapters.mongodb import PymongoRecordingReader
from robotkube.robots.recording.adapters.segments import McapSegmentReader
from robotkube.robots.recording.core.audits import AuditSum
from robotkube.robots.recording.core.documents import SEGMENT
from robotkube.robots.recording.core.ledgers import LedgerLine
from robotkube.robots.recording.core.verification import TopicExamination, examine, without_any
from robotkube.robots.recording.loops.reading import (
    audits,
    begin_examination,
    first_stored,
    list_recordings,
    published_digests,
    read_ledger,
    stored_messages,
    wrong_segments,
)
from robotkube.robots.recording.ports import RecordingReader, SegmentReader
from robotkube.robots.ros.core.topic_patterns import AGENT

Readers = Mapping[str, RecordingReader]
Window = tuple[int, int]
ALWAYS: Window = (0, 2**63 - 1)
COLUMNS = (
    "topic", "received", "stored", "early", "repeated", "dropped", "missing", "gap_count", "published", "lost",
    "unexplained", "duplicates", "mismatches", "unknown", "unreadable", "complete",
)  # fmt: skip

_COUNTS = {
    "received": "offered", "documents": "documents", "segments": "segments", "early": "early",
    "repeated": "duplicates", "dropped": "dropped",
}  # fmt: skip
"""Column of `recording list` -> the counter of the last writer. The first is the sum of the others, but for what was
given up behind the recorder, which is counted twice then: among what was stored, and as dropped."""
NO_MESSAGES = {"complete": "no messages"}
MANIFEST_COLUMNS = ("writer", "volume", "sealed", "documents", "adopted")


def listing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of every command about recordings."""
    parser.add_argument("--agent", default="", help="only what this agent recorded (default: all that record)")
    parser.add_argument("--database", metavar="HOST:PORT", help="where the database is (default: as its Secret says)")


def naming(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of commands about one recording."""
    listing(parser)
    parser.add_argument("recording", help="its name, as `robotkube recording list` prints it")


def verifying(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `recording verify`."""
    naming(parser)
    parser.add_argument(
        "--ledgers",
        action="append",
        default=[],
        metavar="FOLDER",
        help="compare with a player's ledgers of one run, too; once per player",
    )
    add_segments(parser)
    parser.add_argument(
        "--key",
        action="append",
        default=[],
        metavar="HEX",
        help="a key that may have sealed it, as the recorder's log said when it began; once per writer (default: what "
        "is noted on the volumes)",
    )
    parser.add_argument(
        "--window",
        metavar="FIRST:LAST",
        help="stamps to compare, ns, both included (default: while all its large topics were stored)",
    )


def list_all(options: argparse.Namespace) -> Table:
    """List all recordings, oldest first."""
    return listed(readers_of(options))


def show(options: argparse.Namespace) -> Table:
    """Show everything about one recording."""
    return shown(readers_of(options), options.recording)


def verify_one(options: argparse.Namespace) -> Table:
    """Verify that one recording is what was received, and what ledgers say; refused unless it is complete."""
    window = _window(options.window) if options.window else None
    segments = segments_of(options)
    folders = [Path(folder) for folder in options.ledgers]
    return verified(readers_of(options), segments, options.recording, folders, window, options.key)


def listed(readers: Readers) -> Table:
    """The table of `recording list`."""
    rows = [_row(agent, document) for agent, reader in readers.items() for document in list_recordings(reader)]
    columns = (
        "recording", "agent", "started", "seconds", "state", "received", "documents", "segments", "early", "repeated",
        "dropped", "volumes",
    )  # fmt: skip
    return Table("recordings", columns, sorted(rows, key=lambda row: str(row["started"])))


def shown(readers: Readers, recording: str) -> Table:
    """The document of `recording show`."""
    agent, reader, document = find(readers, recording)
    first = {topic: _time(stored) for topic, stored in first_stored(reader, recording).items()}
    row = _row(agent, document)
    kept = {key: document.get(key) for key in ("topics", "provenance", "counts", "causes")}
    sums = audits(reader, recording)
    heard = {*first, *(topic for topic, audit in sums.items() if audit.received)}
    silent = without_any(document.get("topics") or {}, heard)
    whole = {**row, **kept, "first_stored": first, "no_messages": silent, "audits": _shown_sums(sums)}
    return Table("recording", (), [{**whole, "files": [dict(file) for file in reader.segments(recording)]}], True)


def _shown_sums(sums: Mapping[str, AuditSum]) -> dict[str, Any]:
    """The sums of the audits, by topic. Of a writer that was killed nobody knows the numbers; of one that is at work
    they are those of its last audit."""
    names = ("received", "early", "duplicates", "stored", "dropped")
    return {
        topic: {
            **{name: getattr(audit, name) if audit.open or not audit.interrupted else None for name in names},
            "open": audit.open,
            "gaps": [gap.document() for gap in audit.gaps],
        }
        for topic, audit in sorted(sums.items())
    }


def verified(
    readers: Readers,
    segments: SegmentReader,
    recording: str,
    folders: Sequence[Path],
    window: Window | None,
    keys: Sequence[str] = (),
) -> Table:
    """The table of `recording verify`: a row per topic. `folders` hold `<topic with / as __>.jsonl`."""
    _, reader, document = find(readers, recording)
    audited = audits(reader, recording)
    names = sorted({*audited, *(name for name in document.get("topics") or {} if AGENT not in name)})
    ledgers = _required_ledgers(folders, names, recording) if folders else {}
    covered = (window or _common(reader, recording, _large(document))) if ledgers else ALWAYS
    changed: list[str] = []
    seals = begin_examination(reader, segments, document, [key.lower() for key in keys])
    stored = stored_messages(
        reader, segments, recording, changed=changed.append, seen=seals.check, published=published_digests(ledgers)
    )
    topics = examine(stored, audited, ledgers, covered, _latched(document), document.get("topics") or {})
    text = f"{len(changed)} documents have other stamps or digests than they were stored with; the first: {changed[:1]}"
    files = [*([text] if changed else []), *wrong_segments(reader, segments, recording), *seals.problems]
    missing = sorted(set(names) - set(ledgers)) if ledgers else []
    rows = [_examined(topic) for topic in topics]
    writers = Table("manifests", MANIFEST_COLUMNS, [manifest.row() for manifest in seals.manifests])
    reservations = [*seals.reservations, *_silence(topics)]
    reserved = f"{recording}: {'; '.join(reservations)}" if reservations else ""
    refusal = _refusal(document, topics, missing, files)
    return Table("topics", COLUMNS, rows, refusal=refusal, reservation=reserved, unknown=NO_MESSAGES, more=[writers])


def _silence(topics: Sequence[TopicExamination]) -> Iterator[str]:
    silent = [topic.topic for topic in topics if topic.silent]
    if silent:
        yield f"no messages of {', '.join(silent)}: whether there was anything to record, the recording does not say"


def _large(document: Mapping[str, Any]) -> list[str]:
    return [name for name, topic in (document.get("topics") or {}).items() if topic["storage"] == SEGMENT]


def _latched(document: Mapping[str, Any]) -> list[str]:
    return [name for name, topic in (document.get("topics") or {}).items() if topic.get("latched")]


def _required_ledgers(folders: Sequence[Path], topics: Sequence[str], recording: str) -> dict[str, list[LedgerLine]]:
    ledgers = dict(_ledgers(folders, topics))
    if not ledgers:
        raise InputError(
            f"{', '.join(map(str, folders))}: no ledger of a topic of {recording}; --ledgers names the folder of "
            f"one run, with files as {_file_name(min(topics, default='/topic'))}"
        )
    return ledgers


@dataclass(frozen=True)
class _Explained:
    """A reader whose first error says what to do when the database is out of reach from here."""

    reader: PymongoRecordingReader
    address: str
    host: str  # as pods know it
    port: str

    def recordings(self) -> Sequence[Mapping[str, Any]]:
        try:
            return self.reader.recordings()
        except UnavailableError as error:
            raise UnavailableError(f"{error}; is {self.address} in reach from here? Else {self._way()}") from error

    def _way(self) -> str:
        service = service_of(self.host)
        if service is None:
            return "give with --database HOST:PORT where it is"
        forward = f"kubectl -n {service[0]} port-forward service/{service[1]} {self.port}"
        return f"run `{forward}` and add --database 127.0.0.1:{self.port}"

    def buckets(self, recording: str) -> Iterator[Mapping[str, Any]]:
        yield from self.reader.buckets(recording)

    def index(self, recording: str) -> Iterator[Mapping[str, Any]]:
        yield from self.reader.index(recording)

    def segments(self, recording: str) -> Sequence[Mapping[str, Any]]:
        return self.reader.segments(recording)

    def audits(self, recording: str) -> Sequence[Mapping[str, Any]]:
        return self.reader.audits(recording)

    def manifests(self, recording: str) -> Sequence[Mapping[str, Any]]:
        return self.reader.manifests(recording)


def readers_of(options: argparse.Namespace) -> Readers:
    """The databases by agent that records, as the options of the command say."""
    platform = Platform(options)
    accounts = platform.database_accounts(options.agent)
    given = _address(options.database) if options.database else None
    folder = Path(tempfile.mkdtemp(prefix="robotkube-"))  # read again at each connection
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    authorities = platform.authorities()
    return {
        agent: _reader(given or platform.address_of(values), values, authorities, folder)
        for agent, values in sorted(accounts.items())
    }


def segments_of(options: argparse.Namespace) -> SegmentReader:
    """The segments within reach, as the options of the command say."""
    named = dict(volume_place(text) for text in options.segments)
    return McapSegmentReader({**folders_here(Platform(options).volumes()), **named})


def _reader(address: tuple[str, int], values: Mapping[str, str], authorities: str, folder: Path) -> RecordingReader:
    account = login_at(address, values, authorities, folder)
    host, port = address
    return _Explained(PymongoRecordingReader(connect(account)), f"{host}:{port}", values["host"], values["port"])


def find(readers: Readers, recording: str) -> tuple[str, RecordingReader, Mapping[str, Any]]:
    """The agent, the database and the document of a recording; RefusalError when there is none, InputError when several
    agents have one of this name."""
    named = [
        (agent, reader, document)
        for agent, reader in readers.items()
        for document in list_recordings(reader)
        if document["_id"] == recording
    ]
    if not named:
        raise RefusalError("UnknownRecording", f"there is no recording {recording}; see `robotkube recording list`")
    if len(named) > 1:
        agents = ", ".join(agent for agent, *_ in named)
        raise InputError(f"{recording} was recorded by {agents}, each its own; say by --agent which one is meant")
    return named[0]


def _row(agent: str, document: Mapping[str, Any]) -> dict[str, Any]:
    started = document.get("started")
    ended = document.get("ended")
    counts = document.get("counts") or {}
    return {
        "recording": document["_id"],
        "agent": agent,
        "task": (document.get("provenance") or {}).get("task"),
        "started": _time(started),
        "ended": _time(ended),
        "seconds": round((ended - started) / 1e9, 1) if started and ended else None,
        "state": "ended" if ended else "open",
        **{name: counts.get(key) for name, key in _COUNTS.items()},
        "volumes": list(document.get("volumes") or []),
    }


def _examined(topic: TopicExamination) -> dict[str, Any]:
    audit = topic.audit
    comparison = topic.comparison
    gaps = sorted(audit.gaps, key=lambda gap: (gap.first, gap.last)) if audit else []
    counted = audit if topic.counted else AuditSum(topic.topic) if topic.silent else None
    return {
        "topic": topic.topic,
        "received": counted.received if counted else None,
        "early": counted.early if counted else None,
        "repeated": counted.duplicates if counted else None,
        "dropped": counted.dropped if counted else None,
        "stored": topic.stored,
        "missing": topic.missing if audit else None,
        "published": comparison.published if comparison else None,
        "lost": len(comparison.lost) if comparison else None,
        "unknown": len(comparison.unknown) if comparison else None,
        "unexplained": topic.unexplained,
        "duplicates": topic.duplicates,
        "mismatches": len(set(topic.mismatches) | set(comparison.mismatches if comparison else ())),
        "unreadable": len(topic.unreadable),
        "gaps": [gap.document() for gap in gaps],
        "gap_count": len(gaps),
        "complete": topic.complete,
    }


def _refusal(
    document: Mapping[str, Any], topics: Sequence[TopicExamination], missing: Sequence[str], files: Sequence[str]
) -> str:
    reasons = [] if document.get("ended") else ["has not ended: its recorder is at work, or was killed"]
    known = any(topic.stored or topic.audit for topic in topics)
    reasons += [] if known else ["nothing is stored, and no audit says what was received"]
    reasons += [f"{topic.topic}: {', '.join(topic.problems)}" for topic in topics if topic.problems]
    reasons += [f"no ledger was given of: {', '.join(missing)}"] if missing else []
    unread = next((text for topic in topics for text in topic.unreadable), "")
    reasons += [f"first that cannot be read: {unread} (--segments <node>/<claim>=<folder>)"] if unread else []
    reasons += files
    return f"{document['_id']}: {'; '.join(reasons)}" if reasons else ""


def _common(reader: RecordingReader, recording: str, topics: Sequence[str]) -> Window:
    """The window from the latest first to the earliest last stamp of the large topics."""
    first: dict[str, int] = {}
    last: dict[str, int] = {}
    for entry in reader.index(recording):
        topic = entry["topic"]
        stamp = entry["stamp"]
        first[topic] = min(first.get(topic, stamp), stamp)
        last[topic] = max(last.get(topic, stamp), stamp)
    if not topics or set(topics) - set(first):
        absent = ", ".join(sorted(set(topics) - set(first))) or "any topic with large messages"
        raise InputError(f"{recording} holds nothing of {absent}, so what to compare must be said: --window FIRST:LAST")
    return max(first.values()), min(last.values())


def _ledgers(folders: Sequence[Path], topics: Sequence[str]) -> Iterator[tuple[str, list[LedgerLine]]]:
    for topic in topics:
        for folder in folders:
            file = folder / _file_name(topic)
            if file.is_file():
                yield topic, read_ledger(_lines(file), str(file))
                break


def _lines(file: Path) -> list[str]:
    try:
        return file.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise DocumentError(str(file), [f"is no ledger that can be read: {error}"]) from error


def _file_name(topic: str) -> str:
    return f"{topic.replace('/', '__')}.jsonl"


def _window(text: str) -> Window:
    first, _, last = text.partition(":")
    if not (first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
        raise InputError(f"--window {text!r} must be FIRST:LAST, two stamps in ns, the first not later")
    return int(first), int(last)


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal():
        raise InputError(f"--database {text!r} must be HOST:PORT")
    return host, int(port)


def _time(ns: int | None) -> str | None:
    return None if ns is None else datetime.fromtimestamp(ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
