"""Rules over bags: the events, their comparison with expectations, and the same events however they are handed in."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.errors import DocumentError
from robotkube.foundation.runtime.adapters.health_server import HealthServer
from robotkube.robots.bags.adapters.writing import BagWriter
from robotkube.robots.bags.core.playback import BagTopic
from robotkube.robots.detector.core.settings import DetectorSettings, read_detector_settings
from robotkube.robots.detector.loops import rule_replay
from robotkube.robots.detector.loops.rule_replay import PatientWorkers, ReplayResult, replay, topics_read
from robotkube.robots.detector.loops.subscriptions import SUBSCRIPTIONS_MAX
from robotkube.robots.rules.core import Edge
from robotkube.robots.rules.core.specification.expectations import Event, Expectations, score
from tests.stages.detector.rules import DEFINITIONS, NUMBER, POSE, TEXT, layouts, number, pose

SECOND, MS = 1_000_000_000, 1_000_000
BEGIN = 1_795_250_000 * SECOND
AGENTS = ("vehicle-00", "vehicle-01", "vehicle-02")
TYPES = {f"/vehicles/{agent.replace('-', '_')}/pose": POSE for agent in AGENTS} | {"/vehicles/vehicle_00/value": NUMBER}
PROXIMITY = {
    "name": "near", "kind": "proximity", "topic": "/vehicles/{agent}/pose", "start_distance_m": 50,
    "stop_distance_m": 60,
}  # fmt: skip
THRESHOLD = {
    "name": "high", "kind": "threshold", "topic": "/vehicles/{agent}/value", "field": "data", "start_above": 5,
    "stop_below": 4,
}  # fmt: skip
ABSENCE = {"name": "silent", "kind": "absence", "topic": "/vehicles/{agent}/value", "seconds": 1}

Message = tuple[str, int, bytes]


def drive() -> list[Message]:
    """Three vehicles on circles that cross, 20 s at 20 Hz, and a number that pauses from 10 s to 13 s."""
    messages = []
    for step in range(400):
        moment = BEGIN + step * 50 * MS
        for index, agent in enumerate(AGENTS):
            angle = step / 60 * (index + 1)
            data = pose(80 * math.cos(angle) + 20 * index, 80 * math.sin(angle), stamp=moment)
            messages.append((f"/vehicles/{agent.replace('-', '_')}/pose", moment + index, data))
        if not 200 <= step < 260:
            messages.append(("/vehicles/vehicle_00/value", moment + 9, number(5 + 3 * math.sin(step / 15))))
    return messages


def settings(*rules: dict[str, Any]) -> DetectorSettings:
    topics = [{"name": "/vehicles/{agent}/pose", "type": POSE}, {"name": "/vehicles/{agent}/value", "type": NUMBER}]
    return read_detector_settings({"name": "cloud-0/test", "topics": topics, "rules": list(rules)}, "here")


def no_workers() -> PatientWorkers:
    raise AssertionError("no rule here has a process")


def play(messages: Sequence[Message], turn_ns: int = 10 * MS, rules: Sequence[dict[str, Any]] = ()) -> ReplayResult:
    chosen = settings(*(rules or (PROXIMITY, THRESHOLD, ABSENCE)))

    wanted = topics_read(chosen, TYPES)
    return replay(chosen, layouts(), TYPES, [m for m in messages if m[0] in wanted], no_workers, turn_ns)


def identities(edges: Sequence[Edge]) -> set[tuple[str, str, str, tuple[str, ...], int]]:
    return {(edge.id, edge.edge, edge.rule, edge.agents, edge.stamp) for edge in edges}


def brute_force(messages: Sequence[Message]) -> list[tuple[str, tuple[str, str]]]:
    """Edges of proximity by comparing all pairs at every pose."""
    places: dict[str, tuple[float, float]] = {}
    near: set[tuple[str, str]] = set()
    edges = []
    for step in range(400):
        for index, agent in enumerate(AGENTS):
            angle = step / 60 * (index + 1)
            places[agent] = 80 * math.cos(angle) + 20 * index, 80 * math.sin(angle)
            for other in AGENTS:
                pair = (min(agent, other), max(agent, other))
                if other == agent or other not in places:
                    continue
                distance = math.dist(places[agent], places[other])
                if pair not in near and distance < 50:
                    near.add(pair)
                    edges.append(("start", pair))
                elif pair in near and distance > 60:
                    near.remove(pair)
                    edges.append(("stop", pair))
    return edges


def test_the_events_are_those_of_brute_force() -> None:
    result = play(drive(), rules=[PROXIMITY])
    edges = [(edge.edge, edge.agents) for edge in result.edges]
    assert sorted(edges) == sorted(brute_force(drive()))
    assert len(edges) > 6
    assert result.messages == 1200
    assert not result.unseen
    assert not result.problems
    assert not result.incomplete


@pytest.mark.parametrize("turn_ns", [1, MS, 60 * MS, 400 * MS])
def test_however_messages_are_handed_in_the_events_are_the_same(turn_ns: int) -> None:
    expected = identities(play(drive()).edges)
    assert {name for _, _, name, _, _ in expected} == {"near", "high", "silent"}
    assert identities(play(drive(), turn_ns).edges) == expected


def shaken(messages: Sequence[Message], seed: int) -> list[Message]:
    """As a network delivers: in order per topic, with delays of up to 30 ms, less than the time between two poses."""
    source = random.Random(seed)  # noqa: S311
    moved = [(topic, moment + source.randrange(30 * MS), data) for topic, moment, data in messages if "pose" in topic]
    return sorted(moved, key=lambda message: message[1])


@pytest.mark.parametrize("seed", range(5))
def test_delays_of_a_network_change_no_pair(seed: int) -> None:
    """Who crosses first may differ by the order of reception; who meets whom, and when to two periods, does not."""
    plain, moved = (play(messages, rules=[PROXIMITY]).edges for messages in (drive(), shaken(drive(), seed)))
    assert sorted((e.edge, e.agents) for e in plain) == sorted((e.edge, e.agents) for e in moved)
    by_pair: dict[Any, list[int]] = {}
    for edge in plain:
        by_pair.setdefault((edge.edge, edge.agents), []).append(edge.stamp)
    for edge in moved:
        assert min(abs(edge.stamp - stamp) for stamp in by_pair[edge.edge, edge.agents]) <= 100 * MS


def test_what_cannot_be_read_is_counted() -> None:
    messages = drive()
    messages.insert(100, ("/vehicles/vehicle_00/pose", messages[100][1], b"\0\1\0\0short"))
    assert play(messages).unseen == {"/vehicles/vehicle_00/pose": {"malformed": 1}}


# expectations --------------------------------------------------------------------------------------------------------


def test_scores() -> None:
    pair = ("vehicle-00", "vehicle-01")
    actual = [
        Event("near", pair, 10 * SECOND, 20 * SECOND),
        Event("near", pair, 30 * SECOND),
        Event("high", (), SECOND),
    ]
    expected = (Event("near", pair, 10 * SECOND + 300 * MS, 20 * SECOND), Event("near", pair, 50 * SECOND))
    result = score(actual, Expectations(expected, tolerance_seconds=0.5, timing_seconds=0.2))
    assert (result.matched, result.precision, result.recall) == (1, 1 / 3, 1 / 2)
    assert result.timing_seconds == pytest.approx(0.3)
    assert result.missing == expected[1:]
    assert set(result.unexpected) == set(actual[1:])
    assert [text.partition(" is")[0] for text in result.failures] == [
        "precision 0.333", "recall 0.500", "timing error 0.300 s",
    ]  # fmt: skip
    good = score(actual, Expectations((*expected[:1],), precision=0.3, timing_seconds=0.5))
    assert not good.failures
    lasting = score(actual[1:2], Expectations((Event("near", pair, 30 * SECOND, 40 * SECOND),)))
    assert lasting.timing_seconds == math.inf
    assert not score([], Expectations(())).failures


# the command ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    topics = [BagTopic(name, kind, "reliable", "volatile", 10) for name, kind in TYPES.items()]
    with BagWriter(tmp_path / "bag", topics, definitions=DEFINITIONS) as writer:
        for name, moment, data in drive():
            writer.add(name, moment, data)
        writer.finish()
    return tmp_path / "bag"


def written(path: Path, document: Any) -> str:
    path.write_text(json.dumps(document))
    return str(path)


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = cli.main(words)
    output = capsys.readouterr()
    return code, output.out, output.err


@pytest.fixture
def rules(tmp_path: Path) -> str:
    return written(tmp_path / "rules.yaml", {"rules": [PROXIMITY]})


def starts(result: ReplayResult) -> Iterator[dict[str, Any]]:
    stops = {edge.id: edge.stamp for edge in result.edges if edge.edge == "stop"}
    for edge in result.edges:
        if edge.edge == "start":
            stop = {"stop": (stops[edge.id] - BEGIN) / SECOND} if edge.id in stops else {}
            yield {"rule": edge.rule, "agents": list(edge.agents), "start": (edge.stamp - BEGIN) / SECOND, **stop}


def test_the_command_compares_with_expectations(
    bag: Path, rules: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = play(drive(), rules=[PROXIMITY])
    events = list(starts(result))
    good = written(tmp_path / "good.yaml", {"events": events, "tolerance_seconds": 0.1})
    code, out, err = said(capsys, "rule", "test", rules, str(bag), "--expect", good, "-o", "json")
    document = json.loads(out)
    assert code == 0
    assert document["expected"]["passed"] is True
    assert [edge["id"] for edge in document["events"]] == [edge.id for edge in result.edges]
    assert "times faster" in err or "faster than" in err
    bad = written(tmp_path / "bad.yaml", {"events": [*events[1:], {**events[0], "agents": ["a", "b"]}]})
    code, out, err = said(capsys, "rule", "test", rules, str(bag), "--expect", bad)
    assert code == 1
    assert "precision 0." in err
    assert "missing     near a,b" in out
    assert "unexpected  near " in out
    wrong = written(tmp_path / "wrong.yaml", {"events": [{"rule": "near", "agents": [], "start": "soon"}], "more": 1})
    code, _, err = said(capsys, "rule", "test", rules, str(bag), "--expect", wrong)
    assert code == 2
    assert "events[0].start: must be seconds" in err
    assert "more: unknown key" in err
    early = written(tmp_path / "early.yaml", {"events": [{"rule": "near", "agents": ["a"], "start": -0.5, "stop": 2}]})
    code, _, err = said(capsys, "rule", "test", rules, str(bag), "--expect", early)
    assert code == 2
    assert "events[0].start: must be seconds from the begin of the bags, 0 or more" in err


def test_an_event_is_explained_from_a_result(
    bag: Path, rules: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, out, _ = said(capsys, "rule", "test", rules, str(bag), "-o", "json")
    path = tmp_path / "result.json"
    path.write_text(out)
    event = play(drive(), rules=[PROXIMITY]).edges[0]
    code, out, _ = said(capsys, "rule", "explain", event.id[:10], "--source", str(path))
    assert code == 0
    assert f"near began for {', '.join(event.agents)} at {event.stamp}" in out
    assert "pose.position.x = " in out
    assert "distance_m = 20.0" in out
    code, _, err = said(capsys, "rule", "explain", "ffffff", "--source", str(path))
    assert code == 1
    assert "there is no event ffffff" in err
    code, _, err = said(capsys, "rule", "explain", "ffffff", "--source", written(tmp_path / "x.json", {"a": 1}))
    assert code == 2
    assert "events: must be a list" in err


def test_events_that_are_nested_deeply_are_no_result_and_no_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "result.json"
    path.write_text("[" * 100_000)
    code, _, err = said(capsys, "rule", "explain", "ffffff", "--source", str(path))
    assert (code, "is no result of `rule test --output json`: nested deeper than 100 levels" in err) == (2, True)
    server = HealthServer(pages={"/events": path.read_text}, port=0, address="127.0.0.1")
    server.start()
    code, _, err = said(capsys, "rule", "explain", "ffffff", "--source", f"http://127.0.0.1:{server.port}")
    assert (code, "nested deeper than 100 levels" in err) == (3, True)
    server.close()


def test_wrong_rules_are_refused_with_every_problem(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = [{**PROXIMITY, "stop_distance_m": 1}, {**THRESHOLD, "field": "height"}]
    code, _, err = said(capsys, "rule", "test", written(tmp_path / "wrong.yaml", {"rules": wrong}), str(bag))
    assert code == 2
    assert "rules[0].stop_distance_m: must not be less than start_distance_m" in err
    assert "rules[1].field: " in err
    away = {"rules": [{**PROXIMITY, "topic": "/ships/{agent}/pose"}]}
    code, _, err = said(capsys, "rule", "test", written(tmp_path / "away.yaml", away), str(bag))
    assert code == 2
    assert "no topic of the bags fits /ships/{agent}/pose; they have /vehicles/vehicle_00/pose" in err
    code, _, err = said(capsys, "rule", "test", written(tmp_path / "none.yaml", {"a": 1}), str(bag))
    assert (code, "rules: is missing" in err) == (2, True)
    code, out, err = said(capsys, "rule", "test", written(tmp_path / "empty.yaml", {"rules": []}), str(bag))
    assert (code, out, "rules: is empty" in err) == (2, "", True)


def test_values_of_a_chart_and_start_times_are_understood(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = {"placement": {"agent": "cloud-0"}, "detector": {"rules": [PROXIMITY], "reactions": [{"kind": "none"}]}}
    path = written(tmp_path / "values.yaml", values)
    code, out, _ = said(capsys, "rule", "test", path, str(bag), "--start", str(SECOND), "-o", "json")
    assert code == 0
    edges = json.loads(out)["events"]
    plain = play(drive(), rules=[PROXIMITY]).edges
    assert [edge["stamp"] for edge in edges] != [edge.stamp for edge in plain]
    assert [edge["agents"] for edge in edges] == [list(edge.agents) for edge in plain]


def test_damage_is_said_and_the_rest_is_used(bag: Path, rules: str, capsys: pytest.CaptureFixture[str]) -> None:
    file = bag / "bag.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    code, out, err = said(capsys, "rule", "test", rules, str(bag), "-o", "json")
    assert code == 0
    assert "its end is missing" in err
    document = json.loads(out)
    assert document["problems"]
    assert 0 < document["messages"] < 1200


def test_rules_with_processes_of_their_own(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cel = {
        "name": "high", "kind": "cel", "topic": "/vehicles/{agent}/value", "fields": {"value": "data"},
        "expression": "value > 5.0", "until": "value < 4.0",
    }  # fmt: skip
    code, out, err = said(
        capsys, "rule", "test", written(tmp_path / "cel.yaml", {"rules": [cel]}), str(bag), "-o", "json"
    )
    assert code == 0, err
    expected = play(drive(), rules=[THRESHOLD]).edges
    assert [(e["edge"], e["stamp"]) for e in json.loads(out)["events"]] == [(e.edge, e.stamp) for e in expected]


def test_a_rule_that_fails_makes_the_command_fail(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its events are missing, which nobody shall take for a drive without events."""
    cel = {
        "name": "broken", "kind": "cel", "topic": "/vehicles/{agent}/value", "fields": {"value": "data"},
        "expression": "100 / int(value - value) > 1",
    }  # fmt: skip
    path = written(tmp_path / "cel.yaml", {"rules": [cel, THRESHOLD]})
    code, out, err = said(capsys, "rule", "test", path, str(bag), "-o", "json")
    assert code == 1
    document = json.loads(out)
    assert any(problem.startswith("rule broken was suspended") for problem in document["problems"]), document[
        "problems"
    ]
    assert "events may be missing" in err
    assert {edge["rule"] for edge in document["events"]} == {"high"}


@pytest.mark.parametrize("x", [math.nan, math.inf, -math.inf])
def test_a_position_that_is_none_changes_nothing_and_is_told(
    x: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A receiver without a fix sends such: it is neither outside of an area, nor a rule that cannot read its topic."""
    ring = [[-200, -200], [200, -200], [200, 200], [-200, 200]]
    area = {"type": "Polygon", "coordinates": [ring]}
    fence = {"name": "out", "kind": "geofence", "topic": "/vehicles/{agent}/pose", "area": area, "when": "outside"}
    moment = BEGIN + 5 * SECOND + 7
    fix = ("/vehicles/vehicle_00/pose", moment, pose(x, 0, stamp=moment))
    messages = sorted([*drive(), fix], key=lambda message: message[1])
    path = written(tmp_path / "rules.yaml", {"rules": [PROXIMITY, fence]})
    code, out, err = said(capsys, "rule", "test", path, str(write(tmp_path / "with", messages)), "-o", "json")
    assert code == 0, err
    assert "1 no_number (" in err
    document = json.loads(out)
    assert document["unseen"] == {"/vehicles/vehicle_00/pose": {"no_number": 1}}
    assert [edge["id"] for edge in document["events"]] == [edge.id for edge in play(drive(), rules=[PROXIMITY]).edges]


def write(folder: Path, messages: Sequence[Message], types: Mapping[str, str] = TYPES, **definitions: str) -> Path:
    topics = [BagTopic(name, kind, "reliable", "volatile", 10) for name, kind in types.items()]
    with BagWriter(folder, topics, definitions={**DEFINITIONS, **definitions}) as writer:
        for name, moment, data in messages:
            writer.add(name, moment, data)
        writer.finish()
    return folder


@pytest.mark.parametrize("recorded", [BEGIN + 365 * 86_400 * SECOND, 1000 * SECOND])
def test_seconds_count_on_the_clock_of_the_stamps(
    recorded: int, rules: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bag recorded from a bag, or in simulated time: its own times are of another clock than the stamps."""
    folder = write(tmp_path / "again", [(name, moment - BEGIN + recorded, data) for name, moment, data in drive()])
    events = list(starts(play(drive(), rules=[PROXIMITY])))
    expected = written(tmp_path / "expected.yaml", {"events": events, "timing_seconds": 0.001})
    code, out, err = said(capsys, "rule", "test", rules, str(folder), "--expect", expected, "-o", "json")
    assert code == 0, err
    document = json.loads(out)
    assert abs(document["begin"] - BEGIN) < MS
    assert document["end"] - document["begin"] == 19_950 * MS + 2
    assert any("the bags' times: another clock" in problem for problem in document["problems"])
    code, out, _ = said(capsys, "rule", "test", rules, str(folder))
    assert f"  {events[0]['start']:.3f}  " in out


def test_a_start_that_no_stamp_can_say_is_refused(bag: Path, rules: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = said(capsys, "rule", "test", rules, str(bag), "--start", str(BEGIN))
    assert code == 2
    assert "more than a stamp can say" in err


def test_damage_is_said_also_when_nothing_is_left(
    rules: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write(tmp_path / "bag", drive()) / "bag.mcap"
    file.write_bytes(file.read_bytes()[:20])
    code, _, err = said(capsys, "rule", "test", rules, str(tmp_path / "bag"))
    assert code == 2
    assert "its end is missing" in err
    assert "no topic of the bags fits" in err


def test_bags_with_other_fields_of_a_type_are_named(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    types = {"/vehicles/vehicle_07/value": NUMBER}
    messages = [("/vehicles/vehicle_07/value", BEGIN, number(9))]
    same = write(tmp_path / "same", messages, types, **{NUMBER: "# in metres\nfloat64   data  # a number\n"})
    other = write(tmp_path / "other", messages, types, **{NUMBER: "float64 before\nfloat64 data\n"})
    path = written(tmp_path / "rules.yaml", {"rules": [THRESHOLD]})
    _, _, err = said(capsys, "rule", "test", path, str(bag), str(same))
    assert "other fields" not in err
    _, _, err = said(capsys, "rule", "test", path, str(bag), str(other))
    assert f"{other}: {NUMBER} has other fields than in {bag}" in err


def test_of_several_types_the_one_of_most_topics_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    types = {"/a/value": TEXT, "/b/value": NUMBER, "/c/value": NUMBER}
    folder = write(tmp_path / "bag", [("/b/value", BEGIN, number(9))], types)
    rule = {**THRESHOLD, "topic": "/{agent}/value"}
    code, out, err = said(capsys, "rule", "test", written(tmp_path / "r.yaml", {"rules": [rule]}), str(folder))
    assert (code, out.count(" start ")) == (0, 1)
    assert f"/{{agent}}/value: read as {NUMBER}; topics of {TEXT} are left out" in err


def test_wrong_expectations_are_refused_before_the_bags_are_read(
    rules: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = written(tmp_path / "wrong.yaml", {"precision": 2})
    code, _, err = said(capsys, "rule", "test", rules, str(tmp_path / "no-bag"), "--expect", wrong)
    assert code == 2
    assert "precision: must be a number from 0 to 1" in err


def test_as_many_events_as_may_be_are_expected(
    bag: Path, rules: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    events = [{"rule": "near", "agents": list(AGENTS[:2]), "start": 100 + k, "stop": 100.5 + k} for k in range(9000)]
    path = written(tmp_path / "many.yaml", {"events": events, "precision": 0})
    code, _, err = said(capsys, "rule", "test", rules, str(bag), "--expect", path)
    assert (code, "recall 0.000 is below 1" in err) == (1, True)
    (tmp_path / "two.yaml").write_text("events: []\n---\nevents: []\n")
    code, _, err = said(capsys, "rule", "test", rules, str(bag), "--expect", str(tmp_path / "two.yaml"))
    assert (code, "must hold exactly one YAML document" in err) == (2, True)


@pytest.mark.parametrize(
    "change",
    [{"agents": 5}, {"agents": [1]}, {"causes": [1]}, {"causes": [{"topic": "/a", "stamp": 1}]}, {"detail": 1}],
)
def test_what_is_no_result_is_not_explained(
    change: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edge = {"id": "ab", "rule": "near", "edge": "start", "stamp": 1, "time": 1}
    good, wrong = ({"events": [event]} for event in (edge, edge | change))
    assert said(capsys, "rule", "explain", "ab", "--source", written(tmp_path / "good.json", good))[0] == 0
    code, _, err = said(capsys, "rule", "explain", "ab", "--source", written(tmp_path / "wrong.json", wrong))
    assert (code, "events: must be a list of edges" in err) == (2, True)


@pytest.mark.parametrize("everything", [True, False])
def test_topics_that_come_back_after_a_long_pause_are_read_again(
    everything: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether all of them pause, or others go on; the detector has forgotten them meanwhile."""
    monkeypatch.setattr(rule_replay, "TURNS_MAX", 10)
    pause = 700 * SECOND
    name = "/vehicles/vehicle_00/value"
    moments = [BEGIN, BEGIN + SECOND, *(BEGIN + pause + step * 100 * MS for step in range(20))]
    messages = [(name, moment, number(6 - 3 * (index % 2))) for index, moment in enumerate(moments)]
    if not everything:
        messages += [("/vehicles/vehicle_01/pose", BEGIN + step * 500 * MS + 7, pose(0, 0, 1)) for step in range(1450)]
    rules = [THRESHOLD] if everything else [THRESHOLD, PROXIMITY]
    edges = [edge for edge in play(sorted(messages, key=lambda m: m[1]), rules=rules).edges if edge.rule == "high"]
    assert [edge.stamp for edge in edges if edge.edge == "start"] == moments[0::2]


def test_topics_beyond_the_bound_are_named() -> None:
    types = {f"/vehicles/vehicle_{index}/value": NUMBER for index in range(SUBSCRIPTIONS_MAX + 1)}
    chosen = settings(THRESHOLD)
    messages = [(name, BEGIN, number(1)) for name in types]
    result = replay(chosen, layouts(), types, messages, no_workers)
    assert [problem for problem in result.problems if "not read" in problem] == [
        f"/vehicles/vehicle_{SUBSCRIPTIONS_MAX}/value: not read: {SUBSCRIPTIONS_MAX} topics are"
    ]


def test_a_file_of_rules_must_be_there(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = said(capsys, "rule", "test", str(tmp_path / "nothing.yaml"), str(bag))
    assert (code, "cannot be read" in err) == (2, True)
    with pytest.raises(DocumentError):
        settings({**PROXIMITY, "start_distance_m": "far"})
