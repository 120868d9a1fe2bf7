"""The commands `robotkube rule test|explain`: the events of rules over bags, and the messages an event came from.

`test` needs no cluster; `explain` asks the detectors of the platform unless it is given a file or an address.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from robotkube.cli.output import Table, lines
from robotkube.cli.platform import Platform
from robotkube.errors import DocumentError, InputError, RefusalError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.yaml_codec import read_mapping, read_mappings
from robotkube.robots.bags.adapters.command_line_bags import Bags
from robotkube.robots.detector.adapters.event_pages import events_page
from robotkube.robots.detector.core.settings import (
    MISSING_TYPE_FIX,
    ROS,
    DetectorSettings,
    SettingsContext,
    read_detector_settings,
)
from robotkube.robots.detector.loops.rule_replay import PatientWorkers, ReplayResult, replay, topics_read
from robotkube.robots.ros.core.known_types import is_packaged, unknown_type
from robotkube.robots.ros.core.topic_patterns import TopicPattern
from robotkube.robots.rules.adapters.child_processes import installed_rules
from robotkube.robots.rules.core import Edge
from robotkube.robots.rules.core.event_documents import edge_document, explained, is_edge
from robotkube.robots.rules.core.specification.expectations import Score, events, read_expectations, score
from robotkube.robots.rules.host import check_expressions, start_rule

COLUMNS = ("event", "rule", "edge", "agents", "at_seconds", "time", "values")
RESULT_BYTES_MAX = 256 * 1024 * 1024
EXPECTATIONS_BYTES_MAX = 4 * 1024 * 1024
NAME = "rule-test/rules"
_READ = ("topics", "rules")


def testing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `rule test`."""
    parser.add_argument(
        "rules", help="YAML with `rules` (and `topics`): of its own, a detector's or its chart's values"
    )
    parser.add_argument("bags", nargs="+", metavar="bag", help="rosbag2 folder, .mcap or .db3 file; several are merged")
    parser.add_argument("--expect", metavar="FILE", help="YAML with the events that should come; compared, exit code 1")
    parser.add_argument(
        "--start",
        type=int,
        metavar="NS",
        help="stamp messages as bag players do in a run that begins at this time: then events have the ids of that run",
    )
    parser.add_argument("--agent", default="", help="who stands for topics that name no agent")


def explaining(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `rule explain`."""
    parser.add_argument("event", help="the event's id, or its beginning")
    parser.add_argument(
        "--source",
        metavar="FILE|URL",
        help="result of `rule test --output json`, or a detector's address (its /events)",
    )


def test(options: argparse.Namespace) -> Table:
    """Evaluate rules over bags, and compare their events with what was expected."""
    problems: list[str] = []

    def complain(problem: str) -> None:
        problems.append(problem)
        print(f"robotkube: {problem}", file=sys.stderr)

    expected = _expectations(Path(options.expect)) if options.expect else None
    if expected is not None:
        read_expectations(expected, options.expect, 0)  # its mistakes are reported before the bags are read
    with Bags([Path(bag) for bag in options.bags], complain) as bags:
        settings = read_rules_file(Path(options.rules), bags, options.agent, complain)
        for problem in [*_absent(settings, bags.types), *_not_live(settings)]:
            complain(problem)
        began = time.monotonic()
        result = run(settings, bags, options.start)
        seconds = time.monotonic() - began
    for problem in [*result.incomplete, *result.problems]:
        complain(problem)
    print(_summary(result, seconds), file=sys.stderr)
    scored = None
    if expected is not None:
        scored = score(events(result.edges), read_expectations(expected, options.expect, result.begin))
    return _table(result, scored, problems)


def run(settings: DetectorSettings, bags: Bags, start: int | None = None) -> ReplayResult:
    """The events of rules over bags, as fast as it goes; topics that no rule uses are not read."""
    wanted = topics_read(settings, bags.types)
    messages = bags.messages(wanted) if start is None else bags.played(wanted, start)

    def make_workers() -> PatientWorkers:
        return PatientWorkers(
            lambda rule: start_rule(rule, settings.types, bags.definition), time.monotonic, lossless=True
        )

    return replay(settings, bags.layouts, bags.types, messages, make_workers)


def read_rules_file(
    path: Path, bags: Bags, agent: str = "", complain: Callable[[str], None] = lambda problem: None
) -> DetectorSettings:
    """The settings in a file of rules for these bags; topics that it does not list are those of the bags.
    InputError."""
    document = read_mapping(_text(path), str(path), values=False)
    inner = document.get("detector", document)
    if not isinstance(inner, Mapping) or "rules" not in inner:
        raise DocumentError(str(path), ["rules: is missing; give a file with a list `rules`"])
    if inner["rules"] == []:
        raise DocumentError(str(path), ["rules: is empty, so nothing would be looked for; write a rule"])
    chosen = {key: inner[key] for key in _READ if inner.get(key) is not None}
    chosen.setdefault("topics", _topics(inner["rules"], bags.types, complain))
    if not chosen["topics"]:
        chosen["topics"] = [{"name": name, "type": kind} for name, kind in sorted(bags.types.items())[:1]]
    rules = inner["rules"] if isinstance(inner["rules"], list) else []
    kinds = {rule.get("kind") for rule in rules if isinstance(rule, Mapping)}
    knowledge = SettingsContext(
        bags.layouts,
        installed_rules() if "python" in kinds else None,
        None,
        check_expressions if "cel" in kinds else None,
    )
    named = f"{agent}/rules" if agent else str(inner.get("name") or NAME)
    return read_detector_settings({**chosen, "name": named}, str(path), knowledge)


def explain(options: argparse.Namespace) -> Table:
    """Explain which messages and values an event came from."""
    source = options.source
    if source is None:
        edges = [edge for name, page in Platform(options).detector_events().items() for edge in _edges(page, name)]
    elif source.startswith(("http://", "https://")):
        edges = _edges(events_page(source), source)
    else:
        edges = _edges(_result(Path(source)), source)
    chosen = [edge for edge in edges if str(edge["id"]).startswith(options.event)]
    if not chosen:
        raise RefusalError(
            "UnknownEvent", f"there is no event {options.event} in {source or 'what the detectors keep'}"
        )
    if len({edge["id"] for edge in chosen}) > 1:
        raise InputError(f"{options.event} begins the ids of several events; give more of it")
    row = {"event": chosen[0]["id"], "trace": chosen[0].get("trace"), "edges": [dict(edge) for edge in chosen]}
    return Table("event", (), [row], single=True, text="".join(f"{line}\n" for line in explained(chosen)))


def _document(path: Path) -> Mapping[str, Any]:
    return read_mapping(_text(path), str(path))


def _expectations(path: Path) -> Mapping[str, Any]:
    """The one mapping in a file of expectations, which may be as long as the most events that may be expected."""
    documents = read_mappings(_text(path), str(path), EXPECTATIONS_BYTES_MAX)
    if len(documents) != 1:
        raise DocumentError(str(path), ["must hold exactly one YAML document, a mapping"])
    return documents[0]


def _result(path: Path) -> Mapping[str, Any]:
    try:
        document = read_json(_text(path))
    except ValueError as error:
        raise InputError(f"{path}: is no result of `rule test --output json`: {error}") from error
    return document if isinstance(document, dict) else {}


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > RESULT_BYTES_MAX:
            raise InputError(f"{path}: larger than {RESULT_BYTES_MAX} bytes")
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error


def _topics(rules: Any, types: Mapping[str, str], complain: Callable[[str], None]) -> list[dict[str, str]]:
    """The topics that rules name, with their types in the bags; of several types that of most topics."""
    named: dict[str, None] = {}
    for rule in rules if isinstance(rules, list) else []:
        if isinstance(rule, Mapping):
            several = rule.get("topics")
            texts = [rule.get("topic"), *(several if isinstance(several, list) else [])]
            named |= dict.fromkeys(text for text in texts if isinstance(text, str))
    topics = []
    for text in named:
        try:
            pattern = TopicPattern(text)
        except ValueError:
            continue
        counted = Counter(kind for name, kind in sorted(types.items()) if pattern.agent(name) is not None)
        kinds = [kind for kind, _ in counted.most_common()]
        if not kinds:
            there = ", ".join(sorted(types)[:20]) or "none"
            raise InputError(
                f"no topic of the bags fits {text}; they have {there}. List it under `topics` if that is meant"
            )
        if kinds[1:]:
            others = ", ".join(kinds[1:])
            complain(f"{text}: read as {kinds[0]}; topics of {others} are left out. List it under `topics` to choose")
        topics.append({"name": text, "type": kinds[0]})
    return topics


def _absent(settings: DetectorSettings, types: Mapping[str, str]) -> Iterator[str]:
    """Problems: the topics that rules use and the bags do not have, or have in another type."""
    for pattern in sorted({pattern.text for rule in settings.rules for pattern in rule.topics}):
        wanted = settings.types[pattern]
        there = {kind for name, kind in types.items() if TopicPattern(pattern).agent(name) is not None}
        if wanted not in there:
            yield f"{pattern}: no topic of the bags fits as {wanted}; they have {', '.join(sorted(there)) or 'none'}"


def _not_live(settings: DetectorSettings) -> Iterator[str]:
    """Problems: topics of rules whose type bags define and no detector of the platform could subscribe to."""
    used = {pattern.text for rule in settings.rules for pattern in rule.topics}
    for topic in settings.topics:
        if topic.pattern.text in used and topic.source == ROS and not is_packaged(topic.type):
            yield (
                f"{topic.pattern.text}: {unknown_type(topic.type)}: read here by the bags' definition, refused by the "
                f"packaged event-detector; {MISSING_TYPE_FIX}"
            )


def _table(result: ReplayResult, scored: Score | None, problems: Sequence[str]) -> Table:
    rows = [_row(edge, result.begin) for edge in result.edges]
    text = "".join(f"{line}\n" for line in lines(Table("events", COLUMNS, rows)))
    document: dict[str, Any] = {
        "events": [edge_document(edge) for edge in result.edges],
        "begin": result.begin,
        "end": result.begin + result.last - result.first,
        "messages": result.messages,
        "unseen": {topic: dict(counts) for topic, counts in result.unseen.items()},
        "apart": [dict(apart) for apart in result.apart],
        "problems": list(problems),
    }
    refused = ["events may be missing: not all rules could look at all messages"] if result.incomplete else []
    if scored is not None:
        document["expected"] = {**_plain_score(scored), "passed": not scored.failures}
        text += _score_text(scored, result.begin)
        refused += scored.failures
    return Table("result", (), [document], single=True, refusal="; ".join(refused), text=text)


def _row(edge: Edge, begin: int) -> dict[str, Any]:
    values = {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in edge.detail.items()}
    return {
        "event": edge.id,
        "rule": edge.rule,
        "edge": edge.edge,
        "agents": list(edge.agents),
        "at_seconds": f"{(edge.stamp - begin) / 1e9:.3f}",
        "time": datetime.fromtimestamp(edge.stamp / 1e9, UTC).isoformat(timespec="milliseconds")
        if edge.stamp
        else None,
        "values": " ".join(f"{name}={value}" for name, value in values.items()),
    }


def _plain_score(scored: Score) -> dict[str, Any]:
    numbers = asdict(scored)
    return {name: (str(v) if isinstance(v, float) and not math.isfinite(v) else v) for name, v in numbers.items()}


def _score_text(scored: Score, begin: int) -> str:
    numbers = f"matched {scored.matched}, precision {scored.precision:.3f}, recall {scored.recall:.3f}"
    times = f"timing error {scored.timing_seconds:.3f} s at most, {scored.timing_mean_seconds:.3f} s in the mean"
    differences = [
        f"{word}  {event.rule} {','.join(event.agents)} at {(event.start - begin) / 1e9:.3f}"
        for word, listed in (("missing   ", scored.missing), ("unexpected", scored.unexpected))
        for event in listed
    ]
    return "".join(f"{line}\n" for line in (f"{numbers}; {times}", *differences))


def _summary(result: ReplayResult, replay_seconds: float) -> str:
    seconds = (result.last - result.first) / 1e9
    return (
        f"robotkube: {len(result.edges)} edges, {result.messages} messages of topics in rules, {seconds:.1f} s; "
        f"{seconds / replay_seconds if replay_seconds else 0:.0f} times faster than they came"
    )


def _edges(document: Mapping[str, Any], where: str) -> list[Mapping[str, Any]]:
    edges = document.get("events")
    if not isinstance(edges, list) or not all(is_edge(edge) for edge in edges):
        raise DocumentError(
            where, ["events: must be a list of edges, as `rule test --output json` and /events give them"]
        )
    return edges
