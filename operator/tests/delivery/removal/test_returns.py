"""Pauses for what comes again, and the bound on all of it."""

from __future__ import annotations

import pytest

from robotkube.delivery.removal.core.makers import Maker, maker_of
from robotkube.delivery.removal.loops.returns import FORGET_SECONDS, PAUSE_SECONDS_MAX, PAUSE_SECONDS_MIN, Returns
from tests.delivery.removal.examples import pod

ONE, OTHER = Maker("vehicle-00", "Deployment", "detector"), Maker("vehicle-00", "Pod", "foreign")


@pytest.mark.parametrize("random", [0.0, 0.5, 0.999])
def test_pauses_grow_up_to_a_bound_and_never_vanish(random: float) -> None:
    returns = Returns(lambda: random, 1000)
    now = 0.0
    pauses = []
    for _ in range(12):
        assert returns.is_due("delete", ONE, now)
        returns.note("delete", ONE, now)
        begin = now
        now += 0.25
        while not returns.is_due("delete", ONE, now):
            now += 0.25
        pauses.append(now - begin)
    assert all(PAUSE_SECONDS_MIN <= pause <= PAUSE_SECONDS_MAX for pause in pauses)
    assert pauses == sorted(pauses)
    if random > 0:
        assert pauses[-1] > 4 * pauses[0]
    assert returns.count("delete", ONE) == 12
    assert returns.coming_again() == 1


def test_each_maker_and_each_act_has_pauses_of_its_own() -> None:
    returns = Returns(lambda: 0.5, 1000)
    returns.note("delete", ONE, 10.0)
    assert not returns.is_due("delete", ONE, 11.0)
    assert returns.is_due("delete", OTHER, 11.0)
    assert returns.is_due("restore", ONE, 11.0)
    assert (returns.since("delete", ONE, 11.0), returns.since("restore", ONE, 11.0)) == (1.0, float("inf"))


def test_what_goes_in_one_turn_counts_once() -> None:
    returns = Returns(lambda: 0.5, 1000)
    for _ in range(3):
        assert returns.is_due("delete", ONE, 10.0)
        returns.note("delete", ONE, 10.0)
    assert returns.count("delete", ONE) == 1
    assert returns.coming_again() == 0


def test_who_is_quiet_for_long_is_forgotten() -> None:
    returns = Returns(lambda: 0.5, 1000)
    returns.note("delete", ONE, 0.0)
    returns.forget(FORGET_SECONDS - 1)
    assert returns.count("delete", ONE) == 1
    returns.forget(FORGET_SECONDS)
    assert returns.count("delete", ONE) == 0


def test_so_much_a_minute_and_no_more() -> None:
    returns = Returns(lambda: 0.5, 2)
    for second in (0.0, 30.0):
        assert not returns.is_full(second)
        returns.note("delete", Maker("vehicle-00", "Pod", str(second)), second)
    assert returns.is_full(59.0)
    assert not returns.is_full(60.0)


def test_a_pods_maker_is_the_workload_that_people_know() -> None:
    assert maker_of(pod("detector-abc12-x", owner="detector")) == ONE
    assert maker_of(pod()) == OTHER
    of_a_job = pod(ownerReferences=[{"kind": "Job", "name": "once", "controller": True}])
    assert maker_of(of_a_job) == Maker("vehicle-00", "Job", "once")
    of_a_set = pod(ownerReferences=[{"kind": "ReplicaSet", "name": "bare", "controller": True}])
    assert maker_of(of_a_set) == Maker("vehicle-00", "ReplicaSet", "bare")
    owned = pod(ownerReferences=[{"kind": "ConfigMap", "name": "x"}])
    assert maker_of(owned) == OTHER
