"""`robotkube agent enroll` and `withdraw` from the command line to broker and API server: a proposal at a real forge,
another person's approval, the gate's merge, what the process that keeps rights makes of it, and the machine's file."""

from __future__ import annotations

import json
import stat
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from robotkube.cli.main import main
from robotkube.delivery.deployment.core.policies.agents import read_enrolled
from robotkube.delivery.rights.core.accounts import AgentAccount
from robotkube.foundation.forge.adapters.git import GitClone
from tests.delivery.rights.test_revoking import ENDED_SECONDS_MAX, Person
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.delivery.rights.rights_broker import ACCOUNTS
from tests.stages.delivery.tasks.mqtt_connection import NOT_AUTHORISED
from tests.stages.forge.installation import RESERVED, Installation, RunningGate
from tests.stages.kubernetes.api_calls import Api
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

[NEW] = RESERVED
WITH_RESERVED = replace(ACCOUNTS, agents=(*ACCOUNTS.agents, AgentAccount(NEW, "", NEW)))
TOKENS = "/api/v1/namespaces/kube-system/secrets"


@pytest.fixture
def rights(installation: Installation, tmp_path: Path) -> Iterator[KeptRights]:
    account = ("operator-team", installation.passwords["operator-team"])
    clone = GitClone(installation.url, "robotkube/deployment", *account, tmp_path / "main")
    made = KeptRights(tmp_path / "broker", clone, WITH_RESERVED)
    made.ready()
    yield made
    for connection in made.made:
        connection.close()
    made.end()
    made.broker.stop()


def test_from_the_command_to_broker_and_machine(
    installation: Installation,
    gate: RunningGate,
    rights: KeptRights,
    manager_api: Api,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    person = Person(installation, tmp_path)
    file = tmp_path / "machine.kubeconfig"
    enroll = person.words("enroll", NEW, "--role", "vehicle", "--kubeconfig", str(manager_api.kubeconfig))
    enroll += ["--file", str(file), "--server", "https://cluster.example:6443"]
    assert rights.connect(NEW).refused == NOT_AUTHORISED
    assert main([*enroll, "--dry-run"]) == 0
    assert read_enrolled(json.loads(capsys.readouterr().out)["policy"]) == {NEW: "vehicle"}
    assert main(enroll) == 0
    person.merged(json.loads(capsys.readouterr().out))
    rights.follower.wake()
    until(lambda: rights.connect(NEW).refused is None, "it is let in")
    assert not file.exists()
    assert main(enroll) == 0
    written = json.loads(capsys.readouterr().out)
    assert (written["file"], written["pull_request"]) == (str(file), "")
    token = token_of(file, written["expires"])
    assert groups(manager_api, token) >= {"system:bootstrappers", "system:bootstrappers:kubeadm:default-node-token"}
    assert main(enroll) == 2
    assert "is there already; name another one, or remove it" in capsys.readouterr().err
    file.unlink()
    assert main(enroll) == 0  # and the first file's token is gone
    newest = token_of(file, json.loads(capsys.readouterr().out)["expires"])
    kept = [one["metadata"]["name"] for one in manager_api.get(TOKENS)["items"]]
    assert kept == [f"bootstrap-token-{newest.partition('.')[0]}"]
    assert main(person.words("enroll", NEW, "--role", "edge")) == 1
    assert f"{NEW} is enrolled as vehicle: withdraw it first" in capsys.readouterr().err
    withdrawn(person, rights, capsys)


def token_of(file: Path, expires: str) -> str:
    """The token in the file, which only its owner reads, and which says what its machine needs."""
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    document = yaml.safe_load(file.read_text())
    assert document["clusters"][0]["cluster"]["server"] == "https://cluster.example:6443"
    [context] = document["contexts"]
    assert document["current-context"] == context["name"] == NEW
    [about] = context["context"]["extensions"]
    labels = f"robotkube.io/agent={NEW},robotkube.io/role=vehicle"
    assert about["extension"] == {"agent": NEW, "role": "vehicle", "expires": expires, "nodeLabels": labels}
    return str(document["users"][0]["user"]["token"])


def groups(api: Api, token: str) -> set[str]:
    """The groups of whoever has the token; none when the API server does not take it."""
    review = {"apiVersion": "authentication.k8s.io/v1", "kind": "TokenReview", "spec": {"token": token}}
    url = f"{api.client.configuration.host}/apis/authentication.k8s.io/v1/tokenreviews"
    bearer = api.client.configuration.auth_settings()["BearerToken"]
    headers = {"Content-Type": "application/json", bearer["key"]: bearer["value"]}
    answer = api.client.rest_client.pool_manager.request("POST", url, body=json.dumps(review), headers=headers)
    return set(json.loads(answer.data)["status"].get("user", {}).get("groups", ()))


def withdrawn(person: Person, rights: KeptRights, capsys: pytest.CaptureFixture[str]) -> None:
    """Withdrawn, what it has ends."""
    live, other = rights.connect(NEW), rights.connect("vehicle-00")
    capsys.readouterr()
    withdraw = person.words("withdraw", NEW, "--reason", "sold")
    assert main(withdraw) == 0
    person.merged(json.loads(capsys.readouterr().out))
    begun = time.monotonic()
    rights.follower.wake()
    until(lambda: live.lost, "its connection ends")
    assert time.monotonic() - begun < ENDED_SECONDS_MAX
    assert rights.connect(NEW).refused == NOT_AUTHORISED
    assert not other.lost
    assert main(withdraw) == 1
    assert f"{NEW} is not enrolled; on main are: none" in capsys.readouterr().err
