"""Consents of scopes at the gate: what a release may hear of another scope, and what may stand in a consent."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotkube.delivery.deployment.core.borders import Borders, scopes_of
from robotkube.delivery.deployment.core.policies.links import LinkConsents, path_of, read_consents
from robotkube.delivery.gate.core import proposal_checks
from robotkube.delivery.gate.core.release_checks import Rules
from tests.delivery.gate.test_proposal_checks import BRIDGE, PLAN, RULES, TIP, files, message, proposal
from tests.stages.attacks import shown

POSE = "/vehicles/vehicle_07/pose"
SCOPES = scopes_of([("manager", ["cloud-0", "vehicle-00"]), ("other", ["edge-0", "vehicle-07"])])
CONSENTS = {
    path_of("manager"): f"receives: [{{from: other, topics: [{POSE}]}}]\n",
    path_of("other"): "sends: [{to: manager, topics: ['/vehicles/{agent}/pose']}]\n",
}


def with_consents(*scopes: str) -> Rules:
    """The rules where two managers have scopes, of which these consent to POSE."""
    files = {path_of(scope): CONSENTS[path_of(scope)] for scope in scopes}
    borders = Borders(SCOPES, read_consents(files, LinkConsents())[0])
    return replace(RULES, accounts=("manager", "other"), borders=borders)


HEARING = {"bridge": {"in": [{"name": POSE}]}}


def test_what_another_scope_says_is_heard_with_the_consent_of_both() -> None:
    proposed = proposal({}, files(replace(BRIDGE, plan=PLAN, values=HEARING)), message())
    assert proposal_checks.judge(proposed, TIP, with_consents("manager", "other")).accepted
    assert proposal_checks.judge(proposed, TIP, RULES).accepted, "one manager has no borders"
    for scopes, lacking in ((("manager",), "other"), (("other",), "manager")):
        [problem] = proposal_checks.judge(proposed, TIP, with_consents(*scopes)).problems
        assert problem.startswith(f"releases/cloud-0/bridge.yaml: spec.values.bridge.in[0]: topic {POSE} is said by ")
        assert f"needs the consent of both, and main lacks {path_of(lacking)} " in problem
        shown("gate", problem, "heard-over-a-border")
    person = proposal_checks.judge_person(proposed, with_consents("manager"))
    assert "needs the consent of both" in "\n".join(person.problems)


def test_what_stands_on_main_without_consent_holds_nothing_else_up() -> None:
    old = replace(BRIDGE, values=HEARING)
    gone = replace(BRIDGE, plan=PLAN, values={"bridge": {"out": []}})
    proposed = proposal(files(old), files(gone), message())
    assert proposal_checks.judge(proposed, TIP, with_consents()).accepted
    withdrawn = proposal({**files(old), **CONSENTS}, files(old), "Withdraw\n")
    assert proposal_checks.judge_person(withdrawn, with_consents("manager", "other")).accepted


WRONG_CONSENTS = {
    "of nobody": ("policies/links/north.yaml", "{}", "is no scope's file: policies/links/<manager>.yaml"),
    "in a folder": ("policies/links/a/other.yaml", "{}", "is no scope's file"),
    "to nobody": (path_of("other"), "sends: [{to: north, topics: [/a]}]", "sends: north is no other manager"),
    "to itself": (path_of("other"), "sends: [{to: other, topics: [/a]}]", "sends: other is no other manager"),
    "of another's topic": (
        path_of("other"),
        "sends: [{to: manager, topics: [/vehicles/vehicle_00/pose]}]",
        "sends: /vehicles/vehicle_00/pose is said by no agent of scope other",
    ),
    "of an own topic": (
        path_of("other"),
        f"receives: [{{from: manager, topics: [{POSE}]}}]",
        f"receives: {POSE} is said by no agent of scope manager",
    ),
    "unreadable": (path_of("other"), "sends: 7", f"{path_of('other')}: sends"),
}


@pytest.mark.parametrize("case", WRONG_CONSENTS)
def test_a_wrong_consent_is_named(case: str) -> None:
    path, text, words = WRONG_CONSENTS[case]
    judgement = proposal_checks.judge_person(proposal({}, {path: text}, "Agree\n"), with_consents())
    assert words in "\n".join(judgement.problems)


def test_a_consent_is_peoples() -> None:
    right = proposal({}, CONSENTS, "Agree\n")
    assert proposal_checks.judge_person(right, with_consents()).accepted
    assert "policies are made by people" in "\n".join(proposal_checks.judge(right, TIP, with_consents()).problems)
