"""Enrollment at the gate: what may stand in policies/agents.yaml, and that nothing runs on who is not enrolled."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from robotkube.delivery.gate.__main__ import FORMER_KEYS, read_configuration
from robotkube.delivery.gate.core import proposal_checks
from robotkube.foundation.runtime.settings_file import read_settings
from tests.delivery.gate.test_proposal_checks import BRIDGE, PLAN, RULES, TIP, files, message, proposal
from tests.stages.delivery.gate.gate_settings import OCI_REGISTRY, settings_file

NEW = "vehicle-16"
CLOSED = replace(RULES, namespaces=RULES.namespaces | {NEW, "vehicle-17"}, reserved=frozenset({NEW, "vehicle-17"}))
ENROLLED = replace(CLOSED, enrolled=frozenset({NEW}))
RELEASE = replace(BRIDGE, namespace=NEW, plan=PLAN)


def enrolling(text: str) -> tuple[str, ...]:
    return proposal_checks.judge_person(proposal({}, {"policies/agents.yaml": text}, "Enroll\n"), CLOSED).problems


def test_a_reserved_agent_is_enrolled_and_withdrawn() -> None:
    assert enrolling(f"agents: [{{name: {NEW}, role: vehicle}}]") == ()
    gone = proposal({"policies/agents.yaml": f"agents: [{{name: {NEW}, role: vehicle}}]"}, {}, "Withdraw\n")
    assert proposal_checks.judge_person(gone, ENROLLED).accepted


@pytest.mark.parametrize(
    ("entry", "problem"),
    [
        ("{name: cloud-0, role: cloud}", "agents[0].name: cloud-0 is declared by the chart's values already"),
        ("{name: edge-0, role: edge}", "agents[0].name: edge-0 is declared by the chart's values already"),
        ("{name: vehicle-99, role: vehicle}", "agents[0].name: vehicle-99 is not reserved; there are: vehicle-16, veh"),
        ("{name: vehicle-16, role: drone}", "agents[0].role: unknown role 'drone'"),
        ("{name: vehicle-16}", "agents[0].role: missing"),
    ],
)
def test_what_may_not_stand_there(entry: str, problem: str) -> None:
    [said] = enrolling(f"agents: [{entry}]")
    assert said.startswith(f"policies/agents.yaml: {problem}")


def test_a_manager_enrolls_nobody() -> None:
    proposed = proposal({}, {"policies/agents.yaml": f"agents: [{{name: {NEW}, role: vehicle}}]"}, message())
    assert "policies are made by people" in "\n".join(proposal_checks.judge(proposed, TIP, CLOSED).problems)


def test_nothing_is_released_on_who_is_not_enrolled() -> None:
    proposed = proposal({}, files(RELEASE), message())
    problems = proposal_checks.judge(proposed, TIP, CLOSED).problems
    assert problems[0] == (
        "releases/vehicle-16/bridge.yaml: vehicle-16 is reserved, and policies/agents.yaml on main does not enroll it: "
        "nothing may run there"
    )
    assert proposal_checks.judge(proposed, TIP, ENROLLED).accepted
    person = proposal({}, files(RELEASE), "By hand\n")
    assert "does not enroll it" in "\n".join(proposal_checks.judge_person(person, CLOSED).problems)


def test_what_stands_on_a_withdrawn_agent_goes() -> None:
    withdrawn = proposal({**files(BRIDGE), **files(RELEASE)}, files(BRIDGE), message(charts=()))
    assert not [problem for problem in proposal_checks.judge(withdrawn, TIP, CLOSED).problems if "reserved" in problem]


def test_the_settings_name_who_is_reserved(tmp_path: Path) -> None:
    file = settings_file(tmp_path, oci_registry=OCI_REGISTRY, reserved_agents=[NEW])
    assert read_settings(file, read_configuration, FORMER_KEYS).gate.reserved == frozenset({NEW})
