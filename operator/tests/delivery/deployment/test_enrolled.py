"""policies/agents.yaml: what can stand there, what is said of the rest, and agents in the settings of processes."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.policies.agents import (
    ROLES,
    not_reserved,
    read_declared,
    read_enrolled,
    write_enrolled,
)
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.reader import Reader

AGENTS = st.from_regex(r"[a-z]{1,8}(-[0-9]{1,2})?", fullmatch=True)


@given(st.dictionaries(AGENTS, st.sampled_from(ROLES), max_size=4))
def test_what_is_written_is_read(enrolled: dict[str, str]) -> None:
    assert read_enrolled(write_enrolled(enrolled)) == enrolled


def test_nobody() -> None:
    assert read_enrolled(None) == read_enrolled("{}") == read_enrolled("agents: []") == {}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("agents: {vehicle-16: vehicle}", "agents: must be a list"),
        ("agent: []", "agent: unknown key; remove it"),
        ("agents: [{name: vehicle-16}]", "agents[0].role: missing"),
        ("agents: [{name: vehicle-16, role: drone}]", "agents[0].role: unknown role 'drone'; use one of cloud, edge,"),
        ("agents: [{name: vehicle-16, role: [vehicle]}]", "agents[0].role: unknown role"),
        ("agents: [{name: Vehicle, role: vehicle}]", "agents[0].name: 'Vehicle' must match"),
        (
            "agents: [{name: a, role: edge}, {name: a, role: cloud}]",
            "agents[1].name: a stands twice; keep one of them",
        ),
    ],
)
def test_what_is_wrong_is_named(text: str, problem: str) -> None:
    with pytest.raises(DocumentError) as error:
        read_enrolled(text)
    assert problem in "\n".join(error.value.problems)


def test_only_reserved_names_are_enrolled() -> None:
    enrolled = {"vehicle-16": "vehicle", "cloud-0": "cloud", "vehicle-99": "vehicle"}
    said = not_reserved(enrolled, {"vehicle-16", "vehicle-17"}, {"cloud-0", "vehicle-16", "vehicle-17"})
    assert said == [
        "policies/agents.yaml: agents[1].name: cloud-0 is declared by the chart's values already; take it out here",
        "policies/agents.yaml: agents[2].name: vehicle-99 is not reserved; there are: vehicle-16, vehicle-17. Use one "
        "of them, or reserve the name (charts/robotkube, values agents)",
    ]


@pytest.mark.parametrize(
    ("keys", "role", "problem"),
    [
        ({"role": "vehicle"}, "vehicle", ""),
        ({"reserved": True}, "", ""),
        ({"role": "vehicle", "reserved": False}, "vehicle", ""),
        ({}, "", "agents[0]: must have either a role or reserved: true"),
        ({"role": "vehicle", "reserved": True}, "", "agents[0]: must have either a role or reserved: true"),
        ({"reserved": "yes"}, "", "agents[0]: must have either a role or reserved: true"),
    ],
)
def test_an_agent_in_settings_has_a_role_or_is_reserved(keys: dict[str, Any], role: str, problem: str) -> None:
    reader = Reader("settings")
    item = {"name": "vehicle-16", "namespace": "vehicle-16", "records": False, **keys}
    assert read_declared(reader, item, "agents[0]") == ("vehicle-16", role, "vehicle-16")
    assert reader.problems[:1] == ([problem] if problem else [])
