"""What the gate tells of its decisions: the newest of each pull request, as many as there is place for."""

from __future__ import annotations

import pytest

from robotkube.delivery.gate.core.check_results import FILES, IMAGES, CheckResult
from robotkube.delivery.gate.loops import decisions as module
from robotkube.delivery.gate.loops.decisions import Decision, Decisions

NOW = 1_795_250_010_123_456_789


def decision(number: int, verdict: str = "accepted", *problems: str) -> Decision:
    checks = [CheckResult(FILES, (), 0.001), CheckResult(IMAGES, problems, 0.25)]
    return Decision(number, "manager", f"{number:040x}", verdict, "automatic", ("ada",), checks, 0.3)


def test_a_decision_has_its_checks_with_what_they_took() -> None:
    decisions = Decisions(lambda: NOW)
    decisions.put(decision(12, "refused", "image x is not covered"))
    assert decisions.as_json() == {
        "decisions": [
            {
                "pull_request": 12,
                "author": "manager",
                "commit": f"{12:040x}",
                "verdict": "refused",
                "way": "automatic",
                "approvers": ["ada"],
                "decided": NOW,
                "seconds": 0.3,
                "checks": [
                    {"check": FILES, "problems": [], "seconds": 0.001},
                    {"check": IMAGES, "problems": ["image x is not covered"], "seconds": 0.25},
                ],
            }
        ]
    }


def test_of_a_pull_request_the_newest_decision_stays_and_of_too_many_the_oldest_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "DECISIONS_MAX", 2)
    decisions = Decisions(lambda: NOW)
    for number, verdict in ((1, "checked"), (2, "accepted"), (1, "accepted"), (3, "stale")):
        decisions.put(decision(number, verdict))
    listed = decisions.as_json()["decisions"]
    assert [(one["pull_request"], one["verdict"]) for one in listed] == [(1, "accepted"), (3, "stale")]


def test_of_many_problems_of_a_check_the_first_are_named_and_the_rest_counted() -> None:
    decisions = Decisions(lambda: NOW)
    decisions.put(decision(1, "refused", *(f"p{number}" for number in range(13))))
    [one] = decisions.as_json()["decisions"]
    assert one["checks"][1]["problems"] == [*(f"p{n}" for n in range(10)), "and 3 more, in the pull request"]
