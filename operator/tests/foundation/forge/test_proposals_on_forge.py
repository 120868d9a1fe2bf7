"""Proposals and pushes that a real forge refuses: told at once, with the forge's words, and never taken for away."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robotkube.errors import AccountRefusedError, InputError, RefusalError
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter, WorkingClone
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
        topic: str, text: str = "1\n", account: str = "manager", password: str = "", title: str = "t", **more: object
    ) -> int | None:
        given = password or own_installation.passwords[account]
        writer = ProposalWriter(tmp_path, account, given, "m", lambda: 1.0, **more)  # type: ignore[arg-type]
        commit = writer.commit(tip, {"releases/a/x.yaml": text}, "m\n")
        return writer.propose(commit, topic, title, "b")

    return proposed


def test_what_would_not_be_fast_forward(propose: Propose) -> None:
    assert propose("moved") is not None
    with pytest.raises(RefusalError, match="the forge refused proposal moved: request `force-push` push option"):
        propose("moved", "2\n")


def test_a_title_of_many_moves_is_cut(propose: Propose, own_installation: Installation) -> None:
    number = propose("many", title="é" * 70_000)
    address = f"{own_installation.url}/api/v1/repos/robotkube/deployment/pulls/{number}"
    assert http_calls.get(address, auth=("administrator", PASSWORD)).json()["title"] == "é" * 249 + "…"


def test_what_a_hook_declines(propose: Propose) -> None:
    with pytest.raises(
        RefusalError, match="the forge refused proposal own: pre-receive hook declined: User permission denied"
    ):
        propose("own", open_pull_request=lambda *_: 7)


@contextmanager
def archived(installation: Installation) -> Iterator[None]:
    """A repository that nobody may write to."""

    def archive(state: bool) -> None:
        address = f"{installation.url}/api/v1/repos/robotkube/deployment"
        answer = http_calls.patch(address, json={"archived": state}, auth=("administrator", PASSWORD))
        assert answer.status_code == 200

    archive(True)
    try:
        yield
    finally:
        archive(False)


def test_a_repository_that_nobody_may_write_to(propose: Propose, own_installation: Installation) -> None:
    with (
        archived(own_installation),
        pytest.raises(RefusalError, match=r"proposal late: it answers account manager with 403: .*archived"),
    ):
        propose("late")
    assert propose("late") is not None, "it is asked for again, and taken"


def test_main_of_a_repository_that_nobody_may_write_to(own_installation: Installation, tmp_path: Path) -> None:
    password = own_installation.passwords["gate"]
    clone = GitClone(own_installation.url, "robotkube/deployment", "gate", password, tmp_path)
    writer = ProposalWriter(tmp_path, "gate", password, "gate", lambda: 1.0)
    commit = writer.commit(clone.fetch(), {"releases/a/x.yaml": "1\n"}, "m\n")
    words = r"refused: it answers account gate with 403: .*archived.*; account gate must be on the branch's push list"
    with archived(own_installation), pytest.raises(InputError, match=words):
        clone.push_main(commit)
    working = WorkingClone(tmp_path)
    url = f"{own_installation.url}/robotkube/deployment"
    with archived(own_installation), pytest.raises(RefusalError, match=r"PushRefused: .* gate with 403: .*archived"):
        working.push(url, ("gate", password), commit, "refs/heads/main", [])


def test_an_account_without_this_repository(propose: Propose) -> None:
    with pytest.raises(RefusalError, match="proposal away: it answers account nodes with 404: "):
        propose("away", account="nodes")


def test_an_account_that_the_forge_does_not_know(propose: Propose) -> None:
    with pytest.raises(AccountRefusedError, match="proposal wrong: push: the forge refuses account manager: its passw"):
        propose("wrong", password="wrong")  # noqa: S106
