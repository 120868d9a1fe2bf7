"""Updates: which release may take a newer version, who waits, what is reverted, and what is never tried again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.policies.updates import UpdatePolicy, UpdateRule, read_update_policy
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Composition, Met, Refused
from robotkube.delivery.manager.core.updates.cluster_health import (
    DEGRADED,
    HEALTHY,
    PROGRESSING,
    SECOND_NS,
    ReleaseHealth,
)
from robotkube.delivery.manager.core.updates.steps import moved
from robotkube.errors import DocumentError
from tests.stages.delivery.manager.update_fleet import (
    BOTH,
    BRIDGE,
    BRIDGES,
    CANARY,
    DETECTION,
    NEW,
    OLD,
    TOGETHER,
    VEHICLES,
    Fleet,
    application,
    catalogue,
    release,
    version,
)


def test_without_a_newer_version_everything_keeps_what_it_has() -> None:
    fleet = Fleet(VEHICLES, catalogue=catalogue(OLD, BRIDGES))
    updates = fleet.decide()
    assert updates.move is None
    assert updates.messages == ()
    assert updates.pins["vehicle-00/object-detection"] == (DETECTION, "0.1.0")
    assert len(updates.pins) == 6


def test_without_a_canary_all_releases_of_the_chart_move_together_and_nothing_else() -> None:
    fleet = Fleet(VEHICLES, TOGETHER)
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.reason) == ("update", "object-detection 0.2.0")
    assert set(fleet.versions().values()) == {"0.2.0"}
    assert set(fleet.versions(BRIDGE).values()) == {"0.1.0"}
    assert fleet.commit() is None


def test_one_agent_goes_first_unless_people_say_otherwise() -> None:
    fleet = Fleet(VEHICLES, UpdatePolicy())
    move = fleet.commit()
    assert move is not None
    assert move.reason == "object-detection 0.2.0, first on vehicle-00"
    assert sorted(fleet.versions().values()) == ["0.1.0", "0.1.0", "0.2.0"]


def test_an_agent_that_is_the_only_one_to_have_the_chart_tries_it_for_nobody() -> None:
    fleet = Fleet(VEHICLES[:1])
    updates = fleet.decide()
    assert updates.move is not None
    assert updates.move.reason == "object-detection 0.2.0"
    assert (DETECTION, "0.2.0") not in updates.withheld
    several = {path: replace(one, name=f"{one.name}-2") for path, one in fleet.main.items()}
    fleet.main |= {one.path: one for one in several.values()}
    move = fleet.decide().move
    assert move is not None
    assert move.keys == ("vehicle-00/object-detection", "vehicle-00/object-detection-2")


def test_people_name_who_goes_first() -> None:
    fleet = Fleet(VEHICLES, UpdatePolicy(replace(CANARY, first=("roadside-0", "vehicle-02", "vehicle-01"))))
    fleet.show("vehicle-02/object-detection", DEGRADED)
    assert fleet.commit() is not None
    assert fleet.versions()["vehicle-02"] == "0.2.0"


def test_who_is_healthy_goes_first_and_who_is_lost_does_not() -> None:
    fleet = Fleet(VEHICLES)
    fleet.show("vehicle-00/object-detection", DEGRADED)
    del fleet.online["vehicle-01"]
    fleet.commit()
    assert fleet.versions() == {"vehicle-00": "0.1.0", "vehicle-01": "0.1.0", "vehicle-02": "0.2.0"}


def test_a_version_that_nobody_can_try_is_not_withheld() -> None:
    fleet = Fleet(VEHICLES)
    fleet.online.clear()
    updates = fleet.decide()
    assert updates.move is None
    assert (DETECTION, "0.2.0") not in updates.withheld


def test_two_charts_are_two_plans() -> None:
    fleet = Fleet(VEHICLES, TOGETHER, catalogue(OLD, NEW, BRIDGES, version(BRIDGE, "0.3.0")))
    assert [move.chart for move in (fleet.commit(), fleet.commit()) if move] == [BRIDGE, DETECTION]


def test_the_canary_goes_first_and_the_others_follow_when_it_has_succeeded() -> None:
    fleet = Fleet(VEHICLES)
    move = fleet.commit()
    assert move is not None
    assert move.keys == ("vehicle-00/object-detection",)
    assert move.reason == "object-detection 0.2.0, first on vehicle-00"
    assert fleet.decide().move is None
    fleet.now += 5
    fleet.show("vehicle-00/object-detection", HEALTHY)
    fleet.now += 29
    updates = fleet.decide()
    assert updates.move is None
    assert updates.messages == (
        "object-detection 0.2.0 is on trial: vehicle-00/object-detection must be healthy for 30 s",
    )
    assert "canary" in updates.withheld[DETECTION, "0.2.0"]
    fleet.now += 1
    move = fleet.commit()
    assert move is not None
    assert move.keys == ("vehicle-01/object-detection", "vehicle-02/object-detection")


@pytest.mark.parametrize("state", [DEGRADED, PROGRESSING])
def test_a_canary_that_fails_is_reverted_and_the_digest_is_never_tried_again(state: str) -> None:
    fleet = Fleet(VEHICLES)
    before = dict(fleet.main)
    fleet.commit()
    fleet.now += 10
    fleet.show("vehicle-00/object-detection", state)
    fleet.now += 0 if state == DEGRADED else 90
    move = fleet.commit()
    assert move is not None
    assert move.cause == "revert"
    assert "vehicle-00/object-detection" in move.reason
    assert move.undone == ("commit 0",)
    assert fleet.main == before
    fleet.now += 10_000
    assert fleet.commit() is None
    assert not any("is reverted" in text for text in fleet.decide().messages)
    assert "0.2.0 back" in fleet.decide().withheld[DETECTION, "0.2.0"]
    fleet.memory = fleet.memory.policy_changed()
    assert fleet.commit() is not None


def test_what_a_device_held_goes_back_later() -> None:
    fleet = Fleet(VEHICLES, TOGETHER)
    fleet.commit()
    fleet.show("vehicle-00/object-detection", DEGRADED)
    move = fleet.decide().move
    assert move is not None
    fleet.memory = fleet.memory.reverted(DETECTION, move.keys[:2], "failed")
    late = fleet.decide().move
    assert late is not None
    assert (late.cause, late.keys) == ("revert", ("vehicle-02/object-detection",))
    assert late.pins["vehicle-02/object-detection"] == (DETECTION, "0.1.0")


def test_a_newer_version_than_the_bad_one_is_tried() -> None:
    fleet = Fleet(VEHICLES)
    fleet.commit()
    fleet.show("vehicle-00/object-detection", DEGRADED)
    fleet.commit()
    fleet.catalogue = catalogue(OLD, NEW, version(DETECTION, "0.2.1"), BRIDGES)
    move = fleet.commit()
    assert move is not None
    assert (move.cause, move.version) == ("update", "0.2.1")


def test_where_people_forbid_it_nothing_is_reverted_and_nothing_goes_further() -> None:
    fleet = Fleet(VEHICLES, UpdatePolicy(replace(CANARY, revert=False)))
    fleet.commit()
    fleet.show("vehicle-00/object-detection", DEGRADED)
    updates = fleet.decide()
    assert updates.move is None
    assert "not reverted since the policy says so" in updates.messages[0]


def test_an_agent_that_is_offline_holds_nobody_and_gets_the_update_when_it_is_back() -> None:
    fleet = Fleet(VEHICLES)
    del fleet.online["vehicle-00"]
    move = fleet.commit()
    assert move is not None
    assert move.keys == ("vehicle-01/object-detection",)
    fleet.show("vehicle-01/object-detection", HEALTHY)
    fleet.now += 30
    move = fleet.commit()
    assert move is not None
    assert move.keys == ("vehicle-02/object-detection",)
    fleet.show("vehicle-02/object-detection", HEALTHY)
    assert fleet.decide().messages == ("object-detection 0.2.0 waits for vehicle-00, which is offline",)
    fleet.online["vehicle-00"] = fleet.now * SECOND_NS
    fleet.now += 30
    assert fleet.commit() is not None
    assert set(fleet.versions().values()) == {"0.2.0"}


def test_a_canary_that_goes_offline_is_replaced_by_another() -> None:
    fleet = Fleet(VEHICLES)
    fleet.commit()
    del fleet.online["vehicle-00"]
    move = fleet.commit()
    assert move is not None
    assert move.keys == ("vehicle-01/object-detection",)


def test_an_agent_that_comes_back_gets_the_whole_time_to_become_healthy() -> None:
    fleet = Fleet(VEHICLES)
    fleet.commit()
    fleet.show("vehicle-00/object-detection", PROGRESSING)
    fleet.now += 99
    fleet.online["vehicle-00"] = fleet.now * SECOND_NS
    fleet.now += 99
    assert fleet.decide().move is None
    fleet.now += 1
    move = fleet.decide().move
    assert move is not None
    assert move.cause == "revert"


def test_trouble_long_after_an_update_is_not_its_doing() -> None:
    fleet = Fleet(VEHICLES, TOGETHER)
    fleet.commit()
    for key in fleet.health:
        fleet.show(key, HEALTHY)
    fleet.now += 1_000_000
    fleet.show("vehicle-00/object-detection", DEGRADED)
    assert fleet.decide().move is None
    fleet.health["vehicle-00/object-detection"] = ReleaseHealth(PROGRESSING, None)
    assert fleet.decide().move is None


def test_a_share_of_the_fleet_may_fail() -> None:
    agents = tuple(f"vehicle-{number:02d}" for number in range(10))
    fleet = Fleet(agents, UpdatePolicy(UpdateRule(canary=False, threshold=0.8)))
    fleet.commit()
    for agent in agents[:2]:
        fleet.show(f"{agent}/object-detection", DEGRADED)
    assert fleet.decide().move is None
    fleet.show("vehicle-02/object-detection", DEGRADED)
    move = fleet.decide().move
    assert move is not None
    assert move.cause == "revert"
    assert len(move.keys) == 10


def test_a_version_that_no_application_takes_moves_nobody() -> None:
    old_only = replace(BOTH, applications={"object-detection": application("a", DETECTION, "<0.2.0")})
    assert Fleet(VEHICLES, catalogue=old_only).decide().move is None
    assert Fleet(VEHICLES, catalogue=catalogue(OLD, version(DETECTION, "0.2.0", "withdrawn"))).decide().move is None


def desired(releases: Mapping[str, Release], **outcomes: Met | Refused) -> Composition:
    return Composition(releases, outcomes)


def test_a_step_takes_what_it_names_and_nothing_else() -> None:
    fleet = Fleet(VEHICLES)
    present = dict(fleet.main)
    move = fleet.decide().move
    assert move is not None
    path = "releases/vehicle-00/object-detection.yaml"
    after = {**present, path: release("vehicle-00", NEW)}
    changes, problem = moved(move, desired(after), desired(present), present)
    assert [(change.path, change.before, change.after) for change in changes] == [(path, present[path], after[path])]
    assert problem == ""
    other = "releases/vehicle-01/mqtt-bridge.yaml"
    beyond = {**after, other: replace(present[other], values={})}
    changes, problem = moved(move, desired(beyond), desired(present), present)
    assert changes == ()
    assert "would change vehicle-01/mqtt-bridge as well" in problem
    met = Met((), ())
    refused = Refused("InsufficientResources", "no memory")
    changes, problem = moved(move, desired(after, task=refused), desired(present, task=met), present)
    assert changes == ()
    assert "would refuse task: no memory" in problem
    assert moved(move, desired(present), desired(present), present)[1].endswith(
        "suits none of vehicle-00/object-detection"
    )
    edited = {**present, path: replace(present[path], values={"by": "hand"})}
    assert moved(move, desired(after), desired(present), edited)[0] == ()


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["healthy", "degraded", "offline", "online", "wait", "commit", "restart", "new"]),
        st.integers(0, 3),
        st.integers(1, 60),
    ),
    max_size=60,
)


@given(EVENTS, st.booleans(), st.sampled_from([0.5, 1.0]))
def test_histories(events: list[tuple[str, int, int]], canary: bool, threshold: float) -> None:
    """Whatever happens: a digest that was reverted is never tried again, neighbours stay, a revert restores exactly
    what was there, offline agents are left alone, and a deaf manager decides as one that never stopped."""
    agents = tuple(f"vehicle-{number:02d}" for number in range(4))
    fleet = Fleet(agents, UpdatePolicy(replace(CANARY, canary=canary, threshold=threshold)))
    bad: set[str] = set()
    restored: dict[str, dict[str, str]] = {}
    versions = 2
    for event, who, amount in events:
        key = f"{agents[who]}/object-detection"
        if event in ("healthy", "degraded"):
            fleet.show(key, event)
        elif event == "offline":
            fleet.online.pop(agents[who], None)
        elif event == "online":
            fleet.online.setdefault(agents[who], fleet.now * SECOND_NS)
        elif event == "new" and versions < 5:
            versions += 1
            charts = {**fleet.catalogue.charts}
            charts[DETECTION] = (*charts[DETECTION], version(DETECTION, f"0.{versions}.0"))
            fleet.catalogue = replace(fleet.catalogue, charts=charts)
        elif event == "restart":
            again = Fleet(agents, fleet.policy, fleet.catalogue, fleet.now, fleet.memory)
            again.main, again.health, again.online = fleet.main, fleet.health, fleet.online
            assert again.decide() == fleet.decide()
        fleet.now += amount
        offline = {a: fleet.versions().get(a) for a in agents if a not in fleet.online}
        before = fleet.versions()
        move = fleet.commit()
        if move is None:
            continue
        assert set(fleet.versions(BRIDGE).values()) == {"0.1.0"}
        if move.cause == "update":
            assert move.version not in bad
            restored.setdefault(move.version, {}).update({k: before[k.partition("/")[0]] for k in move.keys})
            assert all(fleet.versions()[agent] == version for agent, version in offline.items())
        else:
            bad |= {move.version} if move.undone else set()
            assert move.undone or len(move.keys) < len(agents)
            assert {k: fleet.versions()[k.partition("/")[0]] for k in move.keys} == {
                k: restored[move.version][k] for k in move.keys
            }


def test_the_policy_is_read_strictly() -> None:
    text = "default: {successSeconds: 5, first: [b]}\ncharts: {object-detection: {canary: false}}\n"
    policy = read_update_policy(text)
    assert policy.rule(release("a")) == ("charts.object-detection", UpdateRule(False, 5, first=("b",)))
    assert policy.rule(release("a", BRIDGES)) == ("default", UpdateRule(success_seconds=5, first=("b",)))
    assert read_update_policy("{}\n") == UpdatePolicy()
    text = "default: {canary: 1, threshold: 0, first: [A_B], more: 1}\n"
    text += "charts: {A_B: {successSeconds: 0}}\napplications: []\n"
    with pytest.raises(DocumentError) as refused:
        read_update_policy(text)
    assert len(refused.value.problems) == 7
