"""Proximity with hysteresis: against a brute-force model, and the edges of time."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

from hypothesis import given
from hypothesis import strategies as st

from robotkube.domain.detection import START, STOP, Edge, Proximity, event_identity, task_name
from robotkube.domain.detector_settings import ProximityRule
from robotkube.domain.topics import TopicPattern

MS = 1_000_000
AGENTS = ("vehicle-00", "vehicle-01", "vehicle-02")
RULE = ProximityRule("near", AGENTS, TopicPattern("/vehicles/{agent}/pose"), 400.0, 500.0, stale_seconds=1.0)

poses = st.lists(
    st.tuples(
        st.sampled_from((*AGENTS, "vehicle-99")),
        st.integers(-1200, 1200).map(float),
        st.integers(-400, 900),  # step of the stamp in ms: back, equal, far ahead
    ),
    max_size=60,
)


def run(rule: ProximityRule, inputs: list[tuple[str, float, int]]) -> tuple[list[Edge], list[tuple[str, float, int]]]:
    detector, stamp = Proximity(rule), 0
    edges: list[Edge] = []
    seen: list[tuple[str, float, int]] = []
    for number, (agent, x, step) in enumerate(inputs):
        stamp += step * MS
        seen.append((agent, x, stamp))
        edges += detector.observe(agent, (x, 0.0, 0.0), stamp, 10**15 + number)
    return edges, seen


def model(rule: ProximityRule, seen: list[tuple[str, float, int]]) -> list[tuple[int, str, tuple[str, str]]]:
    """For every prefix: the pairs' distance from all poses so far, by definition and without state but `active`."""
    active: set[tuple[str, str]] = set()
    found = []
    for number in range(len(seen)):
        agent = seen[number][0]
        for pair in combinations(sorted(rule.agents), 2):
            if agent not in pair:
                continue
            before = latest(seen[:number], agent)
            if before is not None and before[2] >= seen[number][2]:
                continue
            one, two = latest(seen[: number + 1], pair[0]), latest(seen[: number + 1], pair[1])
            if one is None or two is None or abs(one[2] - two[2]) > rule.stale_seconds * 1e9:
                continue
            distance = abs(one[1] - two[1])
            if pair not in active and distance < rule.start_distance_m:
                active.add(pair)
                found.append((10**15 + number, START, pair))
            elif pair in active and distance > rule.stop_distance_m:
                active.remove(pair)
                found.append((10**15 + number, STOP, pair))
    return found


def latest(seen: list[tuple[str, float, int]], agent: str) -> tuple[str, float, int] | None:
    mine = [pose for pose in seen if pose[0] == agent]
    return max(mine, key=lambda pose: pose[2]) if mine else None


@given(poses)
def test_edges_are_those_of_the_definition(inputs: list[tuple[str, float, int]]) -> None:
    edges, seen = run(RULE, inputs)
    found = sorted((edge.time, edge.edge, edge.agents) for edge in edges)
    assert found == sorted(model(RULE, seen))


@given(poses)
def test_a_pair_never_starts_twice_without_a_stop(inputs: list[tuple[str, float, int]]) -> None:
    open_events: dict[tuple[str, ...], str] = {}
    for edge in run(RULE, inputs)[0]:
        if edge.edge == START:
            assert edge.agents not in open_events
            assert edge.distance_m is not None
            assert edge.distance_m < 400
            open_events[edge.agents] = edge.id
        else:
            assert open_events.pop(edge.agents) == edge.id
            assert edge.distance_m is not None
            assert edge.distance_m > 500


def test_edge_carries_the_crossing_pose() -> None:
    detector = Proximity(RULE)
    assert not detector.observe("vehicle-01", (0, 0, 0), 5 * MS, 11 * MS)
    assert not detector.observe("vehicle-00", (300, 300, 0), 6 * MS, 12 * MS)
    (edge,) = detector.observe("vehicle-00", (300, 200, 100), 7 * MS, 13 * MS)
    assert (edge.stamp, edge.time, edge.agents, edge.edge) == (7 * MS, 13 * MS, ("vehicle-00", "vehicle-01"), START)
    assert edge.distance_m == (300**2 + 200**2 + 100**2) ** 0.5
    assert (edge.id, edge.trace) == event_identity("near", edge.agents, 13 * MS)
    assert (len(edge.id), len(edge.trace)) == (16, 32)


def test_between_the_distances_nothing_happens() -> None:
    detector = Proximity(RULE)
    detector.observe("vehicle-00", (0, 0, 0), 0, 0)
    assert detector.observe("vehicle-01", (399, 0, 0), 1, 1)
    for stamp, x in enumerate([450.0, 500.0, 399.0, 499.0, 400.0], start=2):
        assert not detector.observe("vehicle-01", (x, 0, 0), stamp, stamp)
    assert [edge.edge for edge in detector.observe("vehicle-01", (500.5, 0, 0), 10, 10)] == [STOP]
    assert not detector.observe("vehicle-01", (450, 0, 0), 11, 11)


def test_stale_pose_is_not_compared() -> None:
    detector = Proximity(RULE)
    detector.observe("vehicle-00", (0, 0, 0), 0, 0)
    assert not detector.observe("vehicle-01", (1, 0, 0), 1001 * MS, 1001 * MS)
    assert detector.observe("vehicle-00", (0, 0, 0), 1002 * MS, 1002 * MS)
    # it fell silent while close: the event lasts, nobody knows better
    assert not detector.observe("vehicle-01", (9999, 0, 0), 9000 * MS, 9000 * MS)
    assert len(detector.active) == 1


def test_late_pose_is_counted_and_not_used() -> None:
    detector = Proximity(RULE)
    detector.observe("vehicle-00", (0, 0, 0), 10 * MS, 0)
    detector.observe("vehicle-01", (1000, 0, 0), 10 * MS, 0)
    assert not detector.observe("vehicle-01", (10, 0, 0), 9 * MS, 0)
    assert not detector.observe("vehicle-01", (10, 0, 0), 10 * MS, 0)
    assert detector.late == 2


def test_adopted_event_ends_and_is_not_raised_again() -> None:
    detector = Proximity(RULE)
    edge = Edge("near", START, ("vehicle-00", "vehicle-01"), "a" * 16, "b" * 32, 1, 1)
    assert detector.adopt(edge)
    assert not detector.adopt(replace(edge, id="c" * 16)), "a pair has one event"
    assert not detector.adopt(replace(edge, agents=("vehicle-00", "vehicle-77")))
    detector.observe("vehicle-00", (0, 0, 0), 0, 0)
    assert not detector.observe("vehicle-01", (10, 0, 0), 1, 1)
    (stop,) = detector.observe("vehicle-01", (600, 0, 0), 2, 2)
    assert (stop.edge, stop.id, stop.trace) == (STOP, "a" * 16, "b" * 32)


def test_task_names_are_object_names() -> None:
    edge = Edge("Lidar_Proximity", START, ("vehicle-00", "vehicle-01"), "3f2a9c0011223344", "t" * 32, 1, 1)
    assert task_name(edge) == "lidar-proximity-vehicle-00-vehicle-01-3f2a9c"
    long = task_name(replace(edge, rule="x" * 80))
    assert len(long) <= 63
    assert long.endswith("-3f2a9c")
