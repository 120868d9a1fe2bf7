"""The commands `robotkube agent enroll` and `withdraw`: what they refuse, and what becomes of a file that cannot be."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from robotkube.cli.agents import enrolling, joining
from robotkube.cli.main import main
from robotkube.delivery.deployment.core.policies.agents import PATH, write_enrolled
from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import write_revoked
from robotkube.delivery.rights.core.accounts import Accounts, AgentAccount
from robotkube.errors import InputError

NEW = "vehicle-16"
ACCOUNTS = Accounts((AgentAccount("cloud-0", "cloud", "cloud-0"), AgentAccount(NEW, "", NEW)), ())
ENROLLED = {PATH: write_enrolled({NEW: "vehicle"})}


class Cluster:
    """The API server, which keeps Secrets and takes bootstrap tokens, or not."""

    def __init__(self, takes: bool = True, reviews_refused: bool = False) -> None:
        self.takes = takes
        self.reviews_refused = reviews_refused
        self.secrets: dict[str, dict[str, Any]] = {}

    def api_server(self) -> tuple[str, str]:
        return "https://cluster.example:6443", "the authority"

    def call(self, method: str, path: str, query: object = (), body: Any = None) -> SimpleNamespace:
        answer: Any = {}
        if path.startswith(joining.REVIEWS):
            if self.reviews_refused:
                raise InputError("tokenreviews is forbidden")
            answer = {"status": {"authenticated": self.takes}}
        elif method == "POST":
            self.secrets[body["metadata"]["name"]] = body
        elif method == "DELETE":
            del self.secrets[path.rpartition("/")[2]]
        else:
            answer = {"items": list(self.secrets.values())}
        return SimpleNamespace(data=json.dumps(answer), read=lambda: None)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., int]:
    def with_main(cluster: Cluster, policies: dict[str, str], *words: str) -> int:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(enrolling, "Platform", lambda _: cluster)
        monkeypatch.setattr(enrolling, "declared", lambda _: ACCOUNTS)
        monkeypatch.setattr(enrolling, "main_policies", lambda _: policies)
        return main(["agent", "enroll", *words])

    return with_main


def test_the_file_of_an_enrolled_agent(run: Callable[..., int], tmp_path: Path) -> None:
    cluster = Cluster()
    assert run(cluster, ENROLLED, NEW, "--role", "vehicle") == 0
    document = yaml.safe_load((tmp_path / f"{NEW}.kubeconfig").read_text())
    assert document["clusters"][0]["cluster"] == {
        "server": "https://cluster.example:6443",
        "certificate-authority-data": "dGhlIGF1dGhvcml0eQ==",
    }
    [secret] = cluster.secrets.values()
    values = secret["stringData"]
    assert document["users"][0]["user"]["token"] == f"{values['token-id']}.{values['token-secret']}"
    assert document["contexts"][0]["context"]["extensions"][0]["extension"]["expires"] == values["expiration"]


@pytest.mark.parametrize(
    ("policies", "words", "code", "said"),
    [
        (
            {},
            ("vehicle-99", "--role", "vehicle"),
            2,
            "no agent vehicle-99 is declared; did you mean vehicle-16? there are: ",
        ),
        ({}, ("cloud-0", "--role", "cloud"), 1, "cloud-0 is declared by the chart's values, and needs no enrollment"),
        (ENROLLED, (NEW, "--role", "edge"), 1, "is enrolled as vehicle: withdraw it first, then enroll it anew"),
        (ENROLLED, (NEW, "--role", "vehicle", "--hours", "25"), 2, "--hours 25: must be 1 to 24"),
        (
            {**ENROLLED, REVOKED_PATH: write_revoked({NEW: "stolen"})},
            (NEW, "--role", "vehicle"),
            1,
            "vehicle-16 is revoked: robotkube agent restore vehicle-16 first",
        ),
    ],
)
def test_what_is_refused(
    run: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    policies: dict[str, str],
    words: tuple[str, ...],
    code: int,
    said: str,
) -> None:
    assert run(Cluster(), policies, *words) == code
    assert said in capsys.readouterr().err


def test_where_no_bootstrap_tokens_are_taken_nothing_is_left(
    run: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(joining, "TAKEN_SECONDS_MAX", 0.0)
    cluster = Cluster(takes=False)
    assert run(cluster, ENROLLED, NEW, "--role", "vehicle") == 1
    assert (
        "Start it with --enable-bootstrap-token-auth, or join the Node as your cluster does" in capsys.readouterr().err
    )
    assert (list(tmp_path.iterdir()), cluster.secrets) == ([], {})


def test_a_token_that_cannot_be_tried_is_not_left_behind(
    run: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Who may make Secrets and no TokenReviews would leave one that joins Nodes for an hour, and no file tells of."""
    cluster = Cluster(reviews_refused=True)
    assert run(cluster, ENROLLED, NEW, "--role", "vehicle") == 2
    assert "tokenreviews is forbidden" in capsys.readouterr().err
    assert (list(tmp_path.iterdir()), cluster.secrets) == ([], {})


def test_a_new_file_ends_the_token_of_the_last_one(run: Callable[..., int], tmp_path: Path) -> None:
    cluster = Cluster()
    for _ in range(2):
        assert run(cluster, ENROLLED, NEW, "--role", "vehicle") == 0
        (tmp_path / f"{NEW}.kubeconfig").unlink()
    assert len(cluster.secrets) == 1


def test_a_dry_run_writes_nothing(run: Callable[..., int], tmp_path: Path) -> None:
    cluster = Cluster()
    assert run(cluster, ENROLLED, NEW, "--role", "vehicle", "--dry-run") == 0
    assert (list(tmp_path.iterdir()), cluster.secrets) == ([], {})
