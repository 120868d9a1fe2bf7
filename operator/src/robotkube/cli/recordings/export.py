"""The command `robotkube recording export`: a recording as a bag for ros2 and Foxglove, and as a labelled dataset."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.recordings import commands as cli_recordings
from robotkube.cli.recordings.volumes import add_argument as add_segments
from robotkube.errors import InputError
from robotkube.robots.bags.adapters.reading import open_bag
from robotkube.robots.bags.adapters.writing import BagWriter
from robotkube.robots.export.adapters.kitti_dataset import KittiDataset
from robotkube.robots.export.adapters.staging_file import TemporaryStagingFile
from robotkube.robots.export.core.foxglove_layout import SUFFIX, recording_layout
from robotkube.robots.export.core.labels import DISTANCE_DEFAULT, GAP_SECONDS_DEFAULT, SIZE_DEFAULT, LabellingSettings
from robotkube.robots.export.loops.bag_export import (
    STAMP_MAX,
    STAMP_MIN,
    Export,
    Selection,
    first_stamp,
    gaps_of,
    prepare,
    write,
)
from robotkube.robots.export.loops.labelling import POSES_DEFAULT, LabellingCounts, label_clouds
from robotkube.robots.recording.ports import RecordingReader, SegmentReader
from robotkube.robots.ros.adapters.installed_definitions import definition
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.ros.core.gaps import Gap
from robotkube.robots.ros.core.topic_patterns import TopicPattern

MCAP = "mcap"
ROSBAG2 = "rosbag2"
DATASET = "dataset"
GAPS = "gaps.jsonl"
COLUMNS = ("topic", "type", "messages", "left_out", "missing", "gap_count")
SECONDS_MAX = 10**9
NANOSECONDS = 1_000_000_000


def exporting(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `recording export`."""
    cli_recordings.naming(parser)
    parser.add_argument("folder", type=Path, help="new folder that is made")
    forms = "one MCAP file with a layout for Foxglove or Lichtblick, or a rosbag2 folder"
    parser.add_argument("--format", choices=(MCAP, ROSBAG2), default=ROSBAG2, help=forms)
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="only these; {agent} stands for every agent"
    )
    when = "stamp in ns, seconds from the recording's first stamp, or a time such as 2026-11-22T10:00:00Z"
    parser.add_argument("--from", dest="first", metavar="WHEN", help=f"only from here: {when}")
    parser.add_argument("--to", dest="last", metavar="WHEN", help="only up to here, as --from")
    add_segments(parser)
    labelling(parser)


def labelling(parser: argparse.ArgumentParser) -> None:
    """Add the arguments about labels."""
    parser.add_argument("--labels", action="store_true", help="make a dataset: clouds labelled by the others' poses")
    parser.add_argument("--poses", default=POSES_DEFAULT, metavar="PATTERN", help="topics of the agents' poses")
    size = "x".join(f"{metres:g}" for metres in SIZE_DEFAULT)
    parser.add_argument("--size", default=size, metavar="LxWxH", help="the others' length, width and height in m")
    parser.add_argument(
        "--distance", type=float, default=DISTANCE_DEFAULT, metavar="M", help="nobody farther away is labelled"
    )
    parser.add_argument(
        "--gap", type=float, default=GAP_SECONDS_DEFAULT, metavar="S", help="poses farther apart are not joined"
    )
    parser.add_argument(
        "--pose-sigma", type=float, default=0.0, metavar="M", help="standard deviation of poses without covariance"
    )


def export(options: argparse.Namespace) -> Table:
    """Write the recording's bag, and with --labels its dataset; refused when something had to be left out."""
    readers = cli_recordings.readers_of(options)
    _, reader, document = cli_recordings.find(readers, options.recording)
    segments = cli_recordings.segments_of(options)
    settings = labelling_settings(options) if options.labels else None
    wanted = ExportRequest.of(options, first_stamp(reader, document))
    return exported(reader, segments, document, options.folder, wanted, settings)


@dataclass(frozen=True)
class ExportRequest:
    """The selection and the form of an export."""

    selection: Selection = field(default_factory=Selection)
    form: str = ROSBAG2
    poses: str = POSES_DEFAULT

    @classmethod
    def of(cls, options: argparse.Namespace, begin: int) -> ExportRequest:
        """The request in the options; `begin`: the recording's first stamp, ns. InputError names the wrong option."""
        try:
            patterns = tuple(TopicPattern(text) for text in options.topics)
            TopicPattern(options.poses)
        except ValueError as error:
            raise InputError(f"--topics, --poses: {error}") from error
        first = _moment("--from", options.first, begin, STAMP_MIN)
        last = _moment("--to", options.last, begin, STAMP_MAX)
        if last < first:
            raise InputError(f"--to {options.last} is before --from {options.first}")
        return cls(Selection(patterns, first, last), options.format, options.poses)


def labelling_settings(options: argparse.Namespace) -> LabellingSettings:
    """The settings of labelling in the options; InputError names the wrong one."""
    try:
        length, width, height = (float(metres) for metres in options.size.lower().split("x"))
    except ValueError as error:
        raise InputError(f"--size {options.size!r} must be LxWxH in m, such as 4.6x1.9x1.6") from error
    numbers = {"--size": min(length, width, height), "--distance": options.distance, "--gap": options.gap}
    for name, number in numbers.items():
        if not 0 < number <= 1e6:
            raise InputError(f"{name}: {number} must be a number above 0")
    if not 0 <= options.pose_sigma <= 1e6:
        raise InputError(f"--pose-sigma: {options.pose_sigma} must be a number from 0")
    return LabellingSettings((length, width, height), options.gap, options.distance, options.pose_sigma)


def exported(
    reader: RecordingReader,
    segments: SegmentReader,
    recording: Mapping[str, Any],
    folder: Path,
    wanted: ExportRequest,
    labels: LabellingSettings | None = None,
) -> Table:
    """Export a recording, and return the table: a row per topic. Nothing is left behind when it fails."""
    if folder.exists():
        raise InputError(f"{folder} is there already; give a new folder")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as own:
            partial = Path(own) / folder.name
            with closing(TemporaryStagingFile(Path(own))) as staging:
                prepared = prepare(reader, recording, wanted.selection, staging)
                counts = _write(prepared, segments, staging, partial, recording, wanted)
            gaps = gaps_of(reader, str(recording["_id"]), wanted.selection)
            _write_gaps(partial, gaps)
            if wanted.form == MCAP:
                layout = recording_layout(topic.name for topic in prepared.topics)
                name = f"{recording['_id']}{SUFFIX}"
                (partial / name).write_text(json.dumps(layout, indent=2) + "\n", encoding="utf-8")
            if labels is not None:
                write_dataset(partial, partial / DATASET, str(recording["_id"]), labels, wanted.poses, _say)
            partial.rename(folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error}") from error
    for name in prepared.silent:
        _say(f"{name}: the recording lists it and has no message of it")
    return _table(prepared, counts, gaps)


def _write_gaps(folder: Path, gaps: Sequence[Gap]) -> None:
    """Say what is missing in the recording, one line for each topic, and write each gap beside the bag."""
    if not gaps:
        return
    lines = [json.dumps({"topic": gap.topic, **gap.document()}) for gap in gaps]
    (folder / GAPS).write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    for topic in dict.fromkeys(gap.topic for gap in gaps):
        known = [gap for gap in gaps if gap.topic == topic]
        first = known[0]
        where = f"{first.where}: {first.why}, stamps {first.first} to {first.last}"
        _say(f"{topic}: {len(known)} gaps, {_missing(known)} messages missing; the first: {where}; all in {GAPS}")


def _missing(gaps: Sequence[Gap]) -> str:
    """How many messages are missing; of a killed recorder nobody knows."""
    count = sum(gap.count or 0 for gap in gaps)
    return f"at least {count}" if any(gap.count is None for gap in gaps) else str(count)


def write_dataset(
    bag: Path, folder: Path, name: str, settings: LabellingSettings, poses: str, report_line: Callable[[str], None]
) -> LabellingCounts:
    """Label the clouds of a bag into a new folder; `report_line` gets the messages. InputError as of `label_clouds`."""
    counts = LabellingCounts()
    with open_bag(bag, report_line) as opened, closing(KittiDataset(folder)) as dataset:

        def lookup(type_name: str) -> str:
            text = opened.definitions.get(type_name) or _definition(type_name)
            if not text:
                raise KeyError(type_name)
            return text

        for labelled in label_clouds(opened, Layouts(lookup), settings, counts, poses):
            dataset.add(labelled.topic, labelled.cloud, labelled.labels)
        for problem in [*counts.problems, *map(_unjoined, sorted(counts.frames))]:
            report_line(problem)
        if not counts.clouds:
            raise InputError(
                f"no cloud has a label: {counts.unlocated} of unknown place, {counts.unreadable} messages unreadable: "
                "a cloud has a place between two own poses (see --gap), by transforms from its frame to the vehicle"
            )
        numbers = {
            "clouds": counts.clouds,
            "boxes": counts.boxes,
            "clouds of unknown place, left out": counts.unlocated,
            "unreadable messages, left out": counts.unreadable,
        }
        dataset.finish(name, settings, numbers)
    left_out = f"{counts.unlocated} clouds of unknown place and {counts.unreadable} unreadable messages left out"
    report_line(f"dataset: {counts.clouds} clouds, {counts.boxes} boxes; {left_out}")
    return counts


def _unjoined(frame: str) -> str:
    return f"no transform leads from frame {frame!r} to a vehicle's, such as vehicle_00; record its topic, too"


def _write(
    prepared: Export,
    segments: SegmentReader,
    staging: TemporaryStagingFile,
    folder: Path,
    recording: Mapping[str, Any],
    wanted: ExportRequest,
) -> Mapping[str, int]:
    carried = recording.get("definitions") or {}
    definitions = {topic.type: carried.get(topic.type) or _definition(topic.type) for topic in prepared.topics}
    for missing in sorted(kind for kind, text in definitions.items() if not text):
        _say(f"{missing} is not installed here, so the bag lacks its definition; ros2 reads it, Foxglove does not")
    with BagWriter(folder, prepared.topics, f"{recording['_id']}.mcap", definitions, compressed=True) as writer:
        write(prepared, segments, staging, writer)
        writer.finish(metadata=wanted.form == ROSBAG2)
        return writer.counts


def _table(prepared: Export, counts: Mapping[str, int], gaps: Sequence[Gap]) -> Table:
    by_topic = {topic.name: [gap for gap in gaps if gap.topic == topic.name] for topic in prepared.topics}
    rows = [
        {
            "topic": topic.name,
            "type": topic.type,
            "messages": counts[topic.name],
            "left_out": prepared.left_out[topic.name],
            "missing": sum(gap.count or 0 for gap in by_topic[topic.name]),
            "gap_count": len(by_topic[topic.name]),
            "gaps": [gap.document() for gap in by_topic[topic.name]],
        }
        for topic in prepared.topics
    ]
    rows += [
        {"topic": name, "type": None, "messages": 0, "left_out": 0, "missing": 0, "gap_count": 0, "gaps": []}
        for name in prepared.silent
    ]
    missing = sum(prepared.left_out.values())
    refusal = f"{missing} messages are not in the export; the first: {prepared.problems[0]}" if missing else ""
    return Table("topics", COLUMNS, rows, refusal=refusal)


def _definition(type_name: str) -> str:
    return definition(type_name, Path(sys.prefix) / "share")


def _moment(option: str, text: str | None, begin: int, default: int) -> int:
    if text is None:
        return default
    try:
        number = float(text)
    except ValueError:
        number = None
    if number is not None and 0 <= number <= SECONDS_MAX:
        return begin + round(number * NANOSECONDS)
    if text.isdecimal() and len(text) <= 19:
        return int(text)
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        raise InputError(
            f"{option} {text!r} must be ns, seconds from the first stamp, or a time such as 2026-11-22T10:00:00Z"
        )
    return round(moment.astimezone(UTC).timestamp() * 1000) * 1_000_000


def _say(text: str) -> None:
    print(f"robotkube: {text}", file=sys.stderr)
