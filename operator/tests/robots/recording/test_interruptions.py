"""What a killed writer of a recording may have lost, by what it and others have left."""

from __future__ import annotations

from typing import Any

from robotkube.robots.recording.core.audits import Interruption, interruptions


def audit(life: int, window: tuple[int, int] | None, closed: bool = False) -> dict[str, Any]:
    return {"topic": "/cloud", "life": life, "window": list(window) if window else None, "closed": closed}


def test_what_comes_after_the_last_stored_message_is_in_doubt() -> None:
    assert interruptions([audit(1, (0, 400))], {"/cloud": [0, 100, 200]}) == [Interruption("/cloud", 201, None)]
    assert interruptions([audit(1, (0, 400))], {}) == [Interruption("/cloud", 0, None)]
    assert interruptions([audit(1, (0, 400), closed=True)], {"/cloud": [0]}) == []


def test_what_was_not_settled_is_in_doubt_although_later_messages_are_stored() -> None:
    """Of a topic with small and large messages, which go two ways."""
    known = {**audit(1, (0, 400)), "unsettled": 150}
    assert interruptions([known], {"/cloud": [0, 100, 200]}) == [Interruption("/cloud", 150, None)]
    both = [{**audit(1, (0, 400)), "unsettled": None}, {**audit(2, (900, 950)), "unsettled": 950}]
    assert interruptions(both, {"/cloud": [0, 200, 900]}, own_life=2) == [Interruption("/cloud", 201, 900)]


def test_messages_of_a_later_writer_without_an_audit_say_nothing_of_an_earlier_one() -> None:
    """The later one wrote segments, and was killed before its first audit reached anything."""
    assert interruptions([audit(1, (0, 400))], {"/cloud": [0, 200, 700, 800]}) == [Interruption("/cloud", 201, None)]
    assert interruptions([audit(1, (0, 100))], {"/cloud": [700]}) == [Interruption("/cloud", 0, None)]


def test_a_writer_does_not_take_itself_for_a_killed_one() -> None:
    """Its own audit comes back to it when it went through the spool before the database was asked."""
    assert interruptions([audit(2, (0, 400))], {"/cloud": [0, 100]}, own_life=2) == []
    both = [audit(1, (0, 400)), audit(2, (900, 950))]
    assert interruptions(both, {"/cloud": [0, 400, 900]}, own_life=2) == [Interruption("/cloud", 401, 900)]


def test_what_a_writer_stored_without_any_audit_ends_where_the_own_begins() -> None:
    stamps = {"/cloud": [300, 500, 900]}
    assert interruptions([], stamps) == [Interruption("/cloud", 901, None)]
    assert interruptions([audit(2, (900, 950))], stamps, own_life=2) == [Interruption("/cloud", 501, 900)]
    assert interruptions([audit(2, (300, 950))], stamps, own_life=2) == []
