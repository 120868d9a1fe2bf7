"""Updates judged agent by agent and by results: who was offline, and what events of rules say."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotkube.delivery.deployment.core.policies.updates import UpdatePolicy
from robotkube.delivery.manager.core.updates.cluster_health import DEGRADED, HEALTHY, PROGRESSING, SECOND_NS
from robotkube.delivery.manager.core.updates.probe_answers import ProbeAnswers
from robotkube.delivery.manager.core.updates.rule_events import Watcher
from robotkube.registry.catalogue.core.success.measures import SuccessMeasure, TopicRate
from tests.stages.delivery.manager.update_fleet import (
    BRIDGES,
    CANARY,
    DETECTION,
    NEW,
    OLD,
    TOGETHER,
    VEHICLES,
    Fleet,
    catalogue,
    version,
)

LATE = "vehicle-02/object-detection"


def updated_but_for_one(policy: UpdatePolicy = TOGETHER) -> Fleet:
    """Two vehicles have the new version and it has succeeded there; the third was offline, and comes back now."""
    fleet = Fleet(VEHICLES, policy)
    del fleet.online["vehicle-02"]
    for _ in VEHICLES[:2]:
        fleet.commit()
        for vehicle in VEHICLES[:2]:
            fleet.show(f"{vehicle}/object-detection", HEALTHY)
        fleet.now += 40
    fleet.now += 10_000
    assert fleet.versions() == {"vehicle-00": "0.2.0", "vehicle-01": "0.2.0", "vehicle-02": "0.1.0"}
    fleet.online["vehicle-02"] = fleet.now * SECOND_NS
    return fleet


@pytest.mark.parametrize("policy", [TOGETHER, UpdatePolicy(CANARY)])
def test_what_dies_on_an_agent_that_was_offline_is_taken_back_there_alone(policy: UpdatePolicy) -> None:
    fleet = updated_but_for_one(policy)
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.keys) == ("update", (LATE,))
    fleet.now += 10
    fleet.show(LATE, DEGRADED)
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.keys, move.undone) == ("revert", (LATE,), ())
    assert move.reason.startswith("object-detection 0.2.0 back on vehicle-02: vehicle-02/object-detection degraded")
    assert fleet.versions() == {"vehicle-00": "0.2.0", "vehicle-01": "0.2.0", "vehicle-02": "0.1.0"}
    fleet.now += 10_000
    updates = fleet.decide()
    assert updates.move is None
    assert (updates.states[LATE].state, updates.states[LATE].text) == ("kept_back", move.reason)
    assert (DETECTION, "0.2.0") not in updates.withheld
    fleet.memory = fleet.memory.policy_changed()
    again = fleet.decide().move
    assert again is not None
    assert again.keys == (LATE,)


def gone_before_it_ran() -> Fleet:
    """All three have the new version on main; the third went offline before it ran, and comes back long after."""
    fleet = Fleet(VEHICLES, TOGETHER)
    fleet.commit()
    for vehicle in VEHICLES[:2]:
        fleet.show(f"{vehicle}/object-detection", HEALTHY)
    del fleet.online["vehicle-02"]
    fleet.now += 10_000
    fleet.online["vehicle-02"] = fleet.now * SECOND_NS
    return fleet


def test_what_dies_on_an_agent_that_went_offline_before_it_ran_is_taken_back_there_alone() -> None:
    fleet = gone_before_it_ran()
    for _ in range(10):
        fleet.show(LATE, PROGRESSING)
        assert fleet.decide().move is None
        fleet.now += 10
        fleet.show(LATE, HEALTHY)
        assert fleet.decide().move is None
        fleet.now += 20
    fleet.show(LATE, PROGRESSING)
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.keys, move.undone) == ("revert", (LATE,), ())


def test_what_ran_before_its_agent_went_offline_is_not_taken_back() -> None:
    fleet = gone_before_it_ran()
    fleet.ran.add(LATE)
    for state in (PROGRESSING, DEGRADED):
        fleet.now += 400
        fleet.show(LATE, state)
        assert fleet.decide().move is None


def test_who_comes_back_late_waits_for_those_who_try_the_version() -> None:
    fleet = Fleet(VEHICLES)
    fleet.commit()
    del fleet.online["vehicle-00"]
    fleet.commit()
    fleet.now += 10
    fleet.online["vehicle-00"] = fleet.now * SECOND_NS
    fleet.show("vehicle-00/object-detection", DEGRADED)
    fleet.show("vehicle-01/object-detection", PROGRESSING)
    waiting = fleet.decide()
    assert waiting.move is None
    assert "on trial: vehicle-01/object-detection must be healthy for 30 s; vehicle-00/" in waiting.messages[0]
    fleet.show("vehicle-01/object-detection", DEGRADED)
    move = fleet.commit()
    assert move is not None
    assert move.undone == ("commit 0", "commit 1")
    assert set(fleet.versions().values()) == {"0.1.0"}


def test_where_people_forbid_it_a_late_agent_keeps_what_dies_and_the_others_go_on() -> None:
    fleet = updated_but_for_one(UpdatePolicy(replace(CANARY, revert=False)))
    fleet.commit()
    fleet.show(LATE, DEGRADED)
    updates = fleet.decide()
    assert updates.move is None
    assert "not reverted since the policy says so" in updates.messages[0]


def test_an_agent_that_failed_alone_gets_the_next_version() -> None:
    fleet = updated_but_for_one()
    fleet.commit()
    fleet.show(LATE, DEGRADED)
    fleet.commit()
    fleet.catalogue = catalogue(OLD, NEW, version(DETECTION, "0.2.1"), BRIDGES)
    move = fleet.commit()
    assert move is not None
    assert LATE in move.keys


MEASURED = replace(NEW, success=SuccessMeasure(("too-slow", "too-few"), 60))
TRIED = "vehicle-00/object-detection"


def measured(*watched: str, agents: frozenset[str] | None = None) -> Fleet:
    """The canary has the version with a measure, and is healthy from now on; a detector watches for these rules."""
    fleet = Fleet(VEHICLES, catalogue=catalogue(OLD, MEASURED, BRIDGES))
    fleet.watchers = [Watcher(rule, "cloud-0/event-detector", agents) for rule in watched]
    fleet.show("cloud-0/event-detector", HEALTHY)
    fleet.event("vehicle-00", "too-slow")
    fleet.now += 5
    fleet.commit()
    fleet.event("vehicle-00", "too-slow")
    fleet.now += 5
    fleet.show(TRIED, HEALTHY)
    return fleet


def test_an_event_of_a_rule_takes_a_healthy_version_back() -> None:
    fleet = measured("too-slow", "too-few")
    before = dict.fromkeys(VEHICLES, "0.1.0")
    fleet.now += 40
    assert fleet.decide().move is None
    fleet.event("vehicle-00", "too-few")
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.undone) == ("revert", ("commit 0",))
    assert move.reason == f"object-detection 0.2.0 back: {TRIED} had an event of rule too-few after the update"
    assert fleet.versions() == before
    fleet.now += 1000
    assert fleet.decide().move is None


def test_a_version_has_succeeded_when_its_measure_holds_for_its_time() -> None:
    fleet = measured("too-slow", "too-few")
    fleet.event("vehicle-01", "too-few")
    fleet.event("vehicle-00", "another-rule")
    fleet.now += 59
    updates = fleet.decide()
    assert updates.move is None
    [text] = updates.messages
    assert text.endswith("healthy for 30 s and without an event of too-slow, too-few for 60 s")
    fleet.now += 1
    move = fleet.commit()
    assert move is not None
    assert move.cause == "update"
    fleet.now += 1
    fleet.event("vehicle-00", "too-few")
    assert fleet.decide().move is None


@pytest.mark.parametrize("ongoing", [True, False])
def test_an_event_that_goes_on_since_the_pod_was_replaced_takes_the_version_back(ongoing: bool) -> None:
    """So does a topic that is too slow from the start: it has been so since the old pod ended, and no event begins."""
    fleet = Fleet(VEHICLES, catalogue=catalogue(OLD, MEASURED, BRIDGES))
    fleet.watchers = [Watcher(rule, "cloud-0/event-detector") for rule in ("too-slow", "too-few")]
    fleet.show("cloud-0/event-detector", HEALTHY)
    fleet.event("vehicle-00", "too-few", ongoing=True)
    fleet.now += 5
    fleet.commit()
    fleet.now += 5
    fleet.event("vehicle-00", "too-slow", ongoing)
    fleet.now += 5
    fleet.show(TRIED, HEALTHY)
    fleet.now += 59
    assert fleet.decide().move is None
    fleet.now += 1
    move = fleet.commit()
    assert move is not None
    assert move.cause == ("revert" if ongoing else "update")
    if ongoing:
        assert move.reason.endswith(f"{TRIED} has an event of rule too-slow that goes on since the update")


@pytest.mark.parametrize("agents", [None, frozenset({"vehicle-01"})])
def test_where_nobody_watches_health_alone_is_judged_and_that_is_said(agents: frozenset[str] | None) -> None:
    watched = ["too-slow"] if agents is None else ["too-slow", "too-few"]
    fleet = measured(*watched, agents=agents)
    fleet.now += 29
    [text] = fleet.decide().messages
    assert text.endswith("must be healthy for 30 s (nobody watches it for events of too-slow, too-few)")
    fleet.now += 1
    assert fleet.commit() is not None
    state = fleet.decide().states[TRIED]
    assert state.state == "unmeasured"
    assert state.text.endswith("by its health alone: nobody watches it for events of too-slow, too-few")


def test_the_measure_counts_while_a_watcher_is_healthy() -> None:
    fleet = measured("too-slow", "too-few")
    fleet.show("cloud-0/event-detector", PROGRESSING)
    fleet.now += 600
    assert fleet.decide().move is None
    fleet.show("cloud-0/event-detector", HEALTHY)
    fleet.now += 59
    assert fleet.decide().move is None
    fleet.now += 1
    assert fleet.commit() is not None


def test_an_event_on_an_agent_that_was_offline_takes_it_back_there_alone() -> None:
    fleet = measured("too-slow", "too-few")
    del fleet.online["vehicle-02"]
    fleet.now += 60
    fleet.commit()
    fleet.show("vehicle-01/object-detection", HEALTHY)
    fleet.now += 10_000
    fleet.online["vehicle-02"] = fleet.now * SECOND_NS
    fleet.commit()
    fleet.show(LATE, HEALTHY)
    fleet.now += 20
    fleet.event("vehicle-02", "too-few")
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.keys, move.undone) == ("revert", (LATE,), ())


PROBED = replace(NEW, success=SuccessMeasure(seconds=60, probes_of=("detection",)))


def probed(*containers: str) -> Fleet:
    """The canary has a version that is measured by probes, and is healthy from now on; its pods have these containers
    with probes."""
    fleet = Fleet(VEHICLES, catalogue=catalogue(OLD, PROBED, BRIDGES))
    for vehicle in VEHICLES:
        fleet.probes[f"{vehicle}/object-detection"] = ProbeAnswers(frozenset(containers))
    fleet.fault(TRIED, "detection", restarted=True)
    fleet.now += 1
    fleet.commit()
    fleet.now += 5
    fleet.fault(TRIED, "detection")
    fleet.now += 1
    fleet.show(TRIED, HEALTHY)
    return fleet


def test_probes_that_say_yes_for_their_time_are_a_success() -> None:
    fleet = probed("detection", "other")
    fleet.now += 20
    fleet.fault(TRIED, "other", restarted=True)
    fleet.now += 39
    [text] = fleet.decide().messages
    assert text.endswith(f"{TRIED} must be healthy for 30 s and with probes of detection that say yes for 60 s")
    fleet.now += 1
    move = fleet.commit()
    assert move is not None
    assert move.cause == "update"
    fleet.now += 1
    fleet.fault(TRIED, "detection")
    assert fleet.decide().move is None


def test_a_probe_that_says_no_for_a_moment_takes_the_version_back() -> None:
    fleet = probed("detection")
    fleet.now += 40
    fleet.fault(TRIED, "detection")
    fleet.show(TRIED, PROGRESSING)
    fleet.now += 5
    fleet.show(TRIED, HEALTHY)
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.undone) == ("revert", ("commit 0",))
    said = "had container detection, which said no to its readiness probe after the update"
    assert move.reason == f"object-detection 0.2.0 back: {TRIED} {said}"
    assert set(fleet.versions().values()) == {"0.1.0"}


def test_a_container_that_starts_again_takes_the_version_back_also_before_it_was_ready() -> None:
    fleet = Fleet(VEHICLES, catalogue=catalogue(OLD, PROBED, BRIDGES))
    fleet.commit()
    fleet.probes[TRIED] = ProbeAnswers(frozenset({"detection"}))
    fleet.now += 3
    assert fleet.decide().move is None
    fleet.fault(TRIED, "detection", restarted=True)
    move = fleet.decide().move
    assert move is not None
    assert move.reason == f"object-detection 0.2.0 back: {TRIED} had container detection, which ended after the update"


def test_where_nobody_asks_a_container_health_alone_is_judged_and_that_is_said() -> None:
    fleet = probed("another")
    fleet.now += 29
    [text] = fleet.decide().messages
    unseen = "nobody asks detection: no pod of it has such a container with a readiness probe"
    assert text.endswith(f"must be healthy for 30 s ({unseen})")
    fleet.now += 1
    assert fleet.commit() is not None
    assert fleet.decide().states[TRIED].text.endswith(unseen)


def test_a_probe_that_says_no_on_an_agent_that_was_offline_takes_it_back_there_alone() -> None:
    fleet = probed("detection")
    del fleet.online["vehicle-02"]
    fleet.now += 60
    fleet.commit()
    fleet.show("vehicle-01/object-detection", HEALTHY)
    fleet.now += 10_000
    fleet.online["vehicle-02"] = fleet.now * SECOND_NS
    fleet.commit()
    fleet.now += 1
    fleet.show(LATE, HEALTHY)
    fleet.now += 20
    fleet.fault(LATE, "detection")
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.keys, move.undone) == ("revert", (LATE,), ())


def test_both_measures_of_a_version_must_hold() -> None:
    both = SuccessMeasure(("too-slow",), 60, ("detection",))
    fleet = Fleet(VEHICLES, catalogue=catalogue(OLD, replace(NEW, success=both), BRIDGES))
    fleet.watchers = [Watcher("too-slow", "cloud-0/event-detector")]
    fleet.show("cloud-0/event-detector", HEALTHY)
    fleet.probes[TRIED] = ProbeAnswers(frozenset({"detection"}))
    fleet.commit()
    fleet.show(TRIED, HEALTHY)
    [text] = fleet.decide().messages
    terms = "without an event of too-slow for 60 s and with probes of detection that say yes for 60 s"
    assert text.endswith(f"must be healthy for 30 s and {terms}")
    for fault in (lambda: fleet.event("vehicle-00", "too-slow"), lambda: fleet.fault(TRIED, "detection")):
        events, probes = dict(fleet.events), dict(fleet.probes)
        fault()
        move = fleet.decide().move
        assert move is not None
        assert move.cause == "revert"
        fleet.events, fleet.probes = events, probes


RATED = replace(NEW, success=SuccessMeasure(seconds=60, rates=(TopicRate("/vehicles/{agent}/objects", 8),)))
SLOW = Watcher("slow", "cloud-0/event-detector", None, "rate", "/vehicles/{agent}/objects", 8.0)
ABSENT = Watcher("silent", "cloud-0/event-detector", None, "absence", "/vehicles/{agent}/objects", lists=True)


def rated(*watchers: Watcher) -> Fleet:
    """The canary has a version that is measured by the rate of a topic, and is healthy from now on."""
    fleet = Fleet(VEHICLES, catalogue=catalogue(OLD, RATED, BRIDGES))
    fleet.watchers = list(watchers)
    fleet.show("cloud-0/event-detector", HEALTHY)
    fleet.now += 5
    fleet.commit()
    fleet.now += 5
    fleet.show(TRIED, HEALTHY)
    return fleet


@pytest.mark.parametrize("rule", ["slow", "silent"])
def test_a_topic_that_comes_too_slowly_or_not_at_all_takes_the_version_back(rule: str) -> None:
    fleet = rated(SLOW, ABSENT)
    fleet.now += 40
    [text] = fleet.decide().messages
    assert text.endswith("healthy for 30 s and without /vehicles/vehicle_00/objects below 8 Hz for 60 s")
    fleet.event("vehicle-00", rule)
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.undone) == ("revert", ("commit 0",))
    assert move.reason.endswith(f"{TRIED} had an event of rule {rule} after the update")


def test_a_topic_that_comes_as_it_should_is_a_success() -> None:
    fleet = rated(SLOW, ABSENT)
    fleet.event("vehicle-01", "slow")
    fleet.now += 59
    assert fleet.decide().move is None
    fleet.now += 1
    move = fleet.commit()
    assert move is not None
    assert move.cause == "update"
    assert TRIED not in fleet.decide().states


@pytest.mark.parametrize(
    "watchers",
    [
        (),
        (SLOW,),
        (ABSENT,),
        (SLOW, replace(ABSENT, lists=False)),
        (replace(SLOW, below_hz=7.9), ABSENT),
        (replace(SLOW, topic="/vehicles/{agent}/other"), ABSENT),
        (replace(SLOW, topic="/vehicles/vehicle_00/objects"), ABSENT),
        (replace(SLOW, topic="no topic"), ABSENT),
        (replace(SLOW, agents=frozenset({"vehicle-01"})), ABSENT),
    ],
)
def test_where_nobody_measures_a_topic_health_alone_is_judged_and_that_is_said(watchers: tuple[Watcher, ...]) -> None:
    fleet = rated(*watchers)
    fleet.now += 30
    assert fleet.commit() is not None
    state = fleet.decide().states[TRIED]
    assert state.state == "unmeasured"
    assert "by its health alone: nobody measures /vehicles/vehicle_00/objects: it takes a rule rate" in state.text


def test_a_topic_without_an_agent_is_measured_on_the_agent_itself() -> None:
    own = [replace(one, release="vehicle-00/detector", topic="/vehicles/vehicle_00/objects") for one in (SLOW, ABSENT)]
    fleet = rated(*own)
    fleet.show("vehicle-00/detector", HEALTHY)
    fleet.now += 30
    assert fleet.decide().move is None
    fleet.now += 30
    assert fleet.commit() is not None


def test_a_topic_that_was_too_slow_before_is_not_put_down_to_the_version_and_that_is_said() -> None:
    fleet = Fleet(VEHICLES, catalogue=catalogue(OLD, RATED, BRIDGES))
    fleet.event("vehicle-00", "silent", ongoing=True)
    before = fleet.events
    fleet = rated(SLOW, ABSENT)
    fleet.events = {key: [replace(event, time_ns=1) for event in events] for key, events in before.items()}
    fleet.now += 60
    assert fleet.commit() is not None
    text = fleet.decide().states[TRIED].text
    assert text.endswith("/vehicles/vehicle_00/objects was below 8 Hz before the update already, and is")
