"""Events of rules in tasks: which are read, about whom they are believed, and who would tell of them."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.placement.placement import Agent
from robotkube.delivery.manager.core.updates.rule_events import (
    RuleEvent,
    RuleEvents,
    Watcher,
    event_in,
    events_by_namespace,
    watchers_of,
)
from robotkube.foundation.documents.core.times import time_ns

CREATED = "2026-11-21T10:00:00Z"
CREATED_NS = time_ns(CREATED)
AGENTS = {
    "vehicle-00": Agent("vehicle-00", "vehicle", "fleet-vehicle-00"),
    "vehicle-01": Agent("vehicle-01", "vehicle", "vehicle-01"),
    "cloud-0": Agent("cloud-0", "cloud", "cloud-0"),
}


def task(event: Any, agents: str = "", created: Any = CREATED, name: str = "t") -> dict[str, Any]:
    metadata = {
        "namespace": "cloud-0",
        "name": name,
        "creationTimestamp": created,
        "annotations": {"robotkube.io/agents": agents},
    }
    return {"metadata": metadata, "spec": {"event": event}}


@pytest.mark.parametrize(
    ("event", "ahead_ns"),
    [
        ({"rule": "r", "time": "2026-11-21T09:59:58Z"}, -2_000_000_000),
        ({"rule": "r", "time": "2026-11-21T10:00:00.9Z"}, 900_000_000),
        ({"rule": "r", "time": "2038-01-01T00:00:00Z"}, 1_000_000_000),
        ({"rule": "r"}, 1_000_000_000),
    ],
)
def test_an_event_has_its_own_time_but_none_after_its_task(event: dict[str, str], ahead_ns: int) -> None:
    assert event_in(task(event, "a b")) == RuleEvent("r", CREATED_NS + ahead_ns, "cloud-0", ("a", "b"))


@pytest.mark.parametrize("event", [{}, {"rule": "r", "time": 5}, {"rule": "r", "time": "yesterday"}, "r"])
def test_what_has_no_event_is_no_event(event: Any) -> None:
    assert event_in(task(event)) is None
    assert event_in(task({"rule": "r"}, created=None)) is None


def test_events_are_noted_once_and_stay_when_their_task_is_gone() -> None:
    events = RuleEvents()
    for one in (task({"rule": "r"}), task({"rule": "r"}), task({}), task({"rule": "s"})):
        events.note(one)
    assert [event.rule for event in events.all()] == ["r", "s"]


def test_an_event_goes_on_while_its_task_is_there() -> None:
    events = RuleEvents()
    first, second = task({"rule": "r"}, name="first"), task({"rule": "s"}, name="second")
    for one in (first, second):
        events.note(one)
    events.end(first)
    assert [(event.rule, event.ongoing) for event in events.all()] == [("r", False), ("s", True)]
    events.note(first)
    assert [event.ongoing for event in events.all()] == [True, True]


def test_who_has_topics_of_its_own_speaks_for_itself_and_who_listens_for_all() -> None:
    own = RuleEvent("r", 1, "fleet-vehicle-00")
    named = RuleEvent("r", 2, "fleet-vehicle-00", ("vehicle-00", "vehicle-01"))
    heard = RuleEvent("r", 3, "cloud-0", ("vehicle-00", "vehicle-01", "unknown"))
    stranger = RuleEvent("r", 4, "elsewhere", ("vehicle-00",))
    assert events_by_namespace([own, named, heard, stranger], AGENTS) == {
        "fleet-vehicle-00": (own, named, heard),
        "vehicle-01": (heard,),
    }


def test_watchers_are_detectors_whose_rules_ask_for_something() -> None:
    rules = [{"name": "a"}, {"name": "b", "agents": ["vehicle-00", "unknown"]}, {"name": "c"}, "no rule"]
    reactions = [{"rule": rule, "kind": "operator"} for rule in "ab"] + [{"rule": "c", "kind": "mqtt"}, "none"]
    values = {"detector": {"rules": rules, "reactions": reactions}}
    cloud = Release("cloud-0", "detector", "event-detector", "0.2.0", "d", values)
    vehicle = Release("vehicle-01", "detector", "event-detector", "0.2.0", "d", values)
    other = Release("cloud-0", "other", "other", "0.1.0", "d", {"detector": True})
    about = frozenset({"fleet-vehicle-00"})
    assert watchers_of([cloud, vehicle, other], AGENTS) == (
        Watcher("a", cloud.key),
        Watcher("b", cloud.key, about),
        Watcher("a", vehicle.key, frozenset({"vehicle-01"})),
        Watcher("b", vehicle.key, frozenset()),
    )
    assert Watcher("b", cloud.key, about).watches(["b"], "fleet-vehicle-00")
    assert not Watcher("b", cloud.key, about).watches(["b"], "vehicle-01")
    assert not Watcher("a", cloud.key).watches(["b"], "vehicle-01")


def test_rules_about_how_a_topic_comes_are_watchers_of_its_rate() -> None:
    topic = "/vehicles/{agent}/objects"
    rules = [
        {"name": "slow", "kind": "rate", "topic": topic, "start_below_hz": 8, "stop_above_hz": 9},
        {"name": "silent", "kind": "absence", "topic": topic, "seconds": 5, "agents": ["vehicle-00"]},
        {"name": "together", "kind": "rate", "scope": "group", "topic": topic, "start_below_hz": 8},
    ]
    reactions = [{"rule": rule["name"], "kind": "operator"} for rule in rules]
    cloud = Release("cloud-0", "d", "event-detector", "1", "d", {"detector": {"rules": rules, "reactions": reactions}})
    slow, silent, together = watchers_of([cloud], AGENTS)
    assert (slow.kind, slow.topic, slow.below_hz, slow.lists) == ("rate", topic, 8.0, False)
    assert (silent.kind, silent.lists, silent.agents) == ("absence", True, frozenset({"fleet-vehicle-00"}))
    assert together.kind == ""
    assert slow.hears("/vehicles/vehicle_00/objects", "fleet-vehicle-00", "vehicle_00")
    assert not slow.hears("/vehicles/vehicle_00/objects", "vehicle-01", "vehicle_01")
    assert not slow.hears("/vehicles/vehicle_00/other", "fleet-vehicle-00", "vehicle_00")
