"""The condition Removed: what became of strangers, in the order in which people need it."""

from __future__ import annotations

from robotkube.delivery.removal.core.conditions import (
    COMES_AGAIN,
    MESSAGE_CHARACTERS_MAX,
    ORDER,
    REFUSED,
    REMOVING,
    Condition,
    Outcome,
    condition_of,
)
from robotkube.delivery.removal.core.targets import LEFT


def test_nothing_named_is_true_and_nothing_seen_is_unknown() -> None:
    assert (condition_of([], True).status, condition_of([], True).reason) == ("True", "NothingNamed")
    assert (condition_of([], False).status, condition_of([], False).reason) == ("Unknown", "NotSeen")


def test_every_reason_has_a_place() -> None:
    assert set(LEFT) < set(ORDER)
    assert len(set(ORDER)) == len(ORDER)


def test_what_needs_a_person_comes_first() -> None:
    outcomes = [Outcome(REMOVING, "a goes"), Outcome(COMES_AGAIN, "b comes"), Outcome(REFUSED, "c is refused")]
    condition = condition_of(outcomes, True)
    assert condition == Condition("False", REFUSED, "c is refused; b comes; a goes")
    assert condition.warns
    assert not condition_of([Outcome(REMOVING, "a goes")], True).warns


def test_a_message_is_bounded_and_says_how_many_more() -> None:
    few = condition_of([Outcome(REMOVING, f"pod {number} goes") for number in range(8)], True)
    assert few.message.endswith("pod 4 goes; and 3 more")
    long = condition_of([Outcome(REMOVING, f"{number}" * 900) for number in range(4)], True)
    assert len(long.message) == MESSAGE_CHARACTERS_MAX


def test_the_time_is_that_of_the_last_change_of_status() -> None:
    condition = condition_of([Outcome(REMOVING, "a goes")], True)
    first = condition.document({}, "t1")
    assert (first["type"], first["lastTransitionTime"]) == ("Removed", "t1")
    assert condition.is_said(first)
    other = condition_of([Outcome(REMOVING, "b goes")], True)
    assert not other.is_said(first)
    assert other.document(first, "t2")["lastTransitionTime"] == "t1"
    assert condition_of([], True).document(first, "t2")["lastTransitionTime"] == "t2"
