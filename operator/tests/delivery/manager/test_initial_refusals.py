"""Refusals of the initial configuration in the log: a line for each problem, not for each agent."""

from __future__ import annotations

import pytest

from robotkube.delivery.manager.core.composition.inputs import Met, Refused
from robotkube.delivery.manager.loops.initial_refusals import InitialRefusals
from robotkube.foundation.runtime.settings_file import split_message

NOT_VERIFIED = Refused("ApplicationNotVerified", "application relaying: no valid evidence: there is none")
EDITED = Refused("ApplicationNotVerified", "application relaying: no valid evidence: it is not what was verified")
AGENTS = [f"vehicle-{number:02}" for number in range(14)]


def lines(caplog: pytest.LogCaptureFixture) -> list[dict[str, str]]:
    split = [split_message(record.getMessage()) for record in caplog.records]
    assert {event for event, _ in split} <= {"initial demand refused"}
    caplog.clear()
    return [dict(fields) for _, fields in split]


def test_the_same_problem_on_many_agents_is_one_line(caplog: pytest.LogCaptureFixture) -> None:
    refusals = InitialRefusals()
    refusals.report({f"initial/relaying/{agent}": NOT_VERIFIED for agent in AGENTS})
    [line] = lines(caplog)
    assert (line["application"], line["agents"], line["cause"]) == ("relaying", "14", "ApplicationNotVerified")
    assert line["first"] == "vehicle-00,vehicle-01,vehicle-02"
    assert line["reason"] == NOT_VERIFIED.message


def test_it_is_written_again_when_it_changes_and_when_it_comes_back(caplog: pytest.LogCaptureFixture) -> None:
    refusals = InitialRefusals()
    for outcomes, count in (
        ({"initial/relaying/vehicle-00": NOT_VERIFIED}, 1),
        ({f"initial/relaying/{agent}": NOT_VERIFIED for agent in AGENTS}, 0),
        ({f"initial/relaying/{agent}": EDITED for agent in AGENTS}, 1),
        ({"initial/relaying/vehicle-00": Met(("vehicle-00/relay",), ())}, 0),
        ({"initial/relaying/vehicle-00": EDITED}, 1),
        ({"initial/relaying/vehicle-00": EDITED, "initial/other/vehicle-00": EDITED}, 1),
        ({"cloud-0/task": EDITED}, 0),
    ):
        refusals.report(outcomes)
        assert len(lines(caplog)) == count, outcomes
