"""Proposals that a real forge refuses: it is told at once and with the forge's words, and never taken for away."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from robotkube.errors import AccountRefusedError, RefusalError
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from tests.stages import http_calls
from tests.stages.forge.gitea import PASSWORD
from tests.stages.forge.installation import Installation

pytestmark = pytest.mark.toolchain

Propose = Callable[..., int | None]


@pytest.fixture
def propose(own_installation: Installation, tmp_path: Path) -> Propose:
    """Propose main with another file, as an account."""
    clone = GitClone(
        own_installation.url, "robotkube/deployment", "manager", own_installation.passwords["manager"], tmp_path
    )
    tip = clone.fetch()

    def proposed(
        topic: str, text: str = "1\n", account: str = "manager", password: str = "", **more: object
    ) -> int | None:
        given = password or own_installation.passwords[account]
        writer = ProposalWriter(tmp_path, account, given, "m", lambda: 1.0, **more)  # type: ignore[arg-type]
        commit = writer.commit(tip, {"releases/a/x.yaml": text}, "m\n")
        return writer.propose(commit, topic, "t", "b")

    return proposed


def test_what_would_not_be_fast_forward(propose: Propose) -> None:
    assert propose("moved") is not None
    with pytest.raises(RefusalError, match="the forge refused proposal moved: request `force-push` push option"):
        propose("moved", "2\n")


def test_what_a_hook_declines(propose: Propose) -> None:
    with pytest.raises(
        RefusalError, match="the forge refused proposal own: pre-receive hook declined: User permission denied"
    ):
        propose("own", open_pull_request=lambda *_: 7)


def test_a_repository_that_nobody_may_write_to(propose: Propose, own_installation: Installation) -> None:
    def archive(archived: bool) -> None:
        address = f"{own_installation.url}/api/v1/repos/robotkube/deployment"
        answer = http_calls.patch(address, json={"archived": archived}, auth=("administrator", PASSWORD))
        assert answer.status_code == 200

    archive(True)
    try:
        with pytest.raises(RefusalError, match=r"proposal late: it answers account manager with 403: .*archived"):
            propose("late")
    finally:
        archive(False)
    assert propose("late") is not None, "it is asked for again, and taken"


def test_an_account_without_this_repository(propose: Propose) -> None:
    with pytest.raises(RefusalError, match="proposal away: it answers account nodes with 404: "):
        propose("away", account="nodes")


def test_an_account_that_the_forge_does_not_know(propose: Propose) -> None:
    with pytest.raises(AccountRefusedError, match="proposal wrong: push: the forge refuses account manager: its passw"):
        propose("wrong", password="wrong")  # noqa: S106
