"""policies/revoked.yaml: what can stand there, and what is said of the rest."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.policies.revoked import read_revoked, write_revoked
from robotkube.errors import DocumentError

AGENTS = st.from_regex(r"[a-z]{1,8}(-[0-9]{1,2})?", fullmatch=True)
REASONS = st.text(st.characters(codec="utf-8", categories=["L", "N", "P", "S"]), min_size=1, max_size=200)


@given(st.dictionaries(AGENTS, REASONS, max_size=4))
def test_what_is_written_is_read(revoked: dict[str, str]) -> None:
    assert read_revoked(write_revoked(revoked)) == revoked


def test_nobody() -> None:
    assert read_revoked("{}") == read_revoked("revoked: []") == {}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("revoked: {vehicle-00: stolen}", "revoked: must be a list"),
        ("revoke: []", "revoke: unknown key; remove it"),
        ("revoked: [{agent: vehicle-00}]", "revoked[0].reason: missing"),
        ("revoked: [{agent: vehicle-00, reason: ' '}]", "revoked[0].reason: must be one line of 1 to 200 characters"),
        ('revoked: [{agent: vehicle-00, reason: "a\\nb"}]', "revoked[0].reason: must be one line"),
        ("revoked: [{agent: Vehicle, reason: a}]", "revoked[0].agent: 'Vehicle' must match"),
        (
            "revoked: [{agent: a, reason: b}, {agent: a, reason: c}]",
            "revoked[1].agent: a stands twice; keep one of them",
        ),
    ],
)
def test_what_is_wrong_is_named(text: str, problem: str) -> None:
    with pytest.raises(DocumentError) as error:
        read_revoked(text)
    assert problem in "\n".join(error.value.problems)
