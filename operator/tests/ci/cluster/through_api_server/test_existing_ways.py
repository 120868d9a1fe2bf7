"""Ways into a cluster that only its API server leads to: forwards that are started again, files by pods. kubectl is a
program of the test, which does on this machine what the real one does in a pod."""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from ci.cluster.through_api_server import forwards
from ci.cluster.through_api_server.forwards import Forwards
from ci.cluster.through_api_server.pod_volumes import FOLDER, PodVolumes
from ci.cluster_contract.provider import ServicePort, WayOfAPerson, directly
from ci.errors import SetUpError
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

FORGE = ServicePort("robotkube", "forge", "10.96.0.9", 3000)
CLAIM = ("vehicle-00", "bags")
# Listens where it is told, for one connection, and then ends as kubectl does when its pod is gone.
LISTENING = """
import pathlib, socket, sys
words = pathlib.Path(sys.argv[1])
with words.open("a") as file:
    file.write(" ".join(sys.argv[2:]) + "\\n")
if (words.parent / "refuse").exists():
    sys.exit("error: unable to forward port because pod is not running")
server = socket.create_server(("127.0.0.1", int(sys.argv[-1].partition(":")[0])))
print("Forwarding from 127.0.0.1", flush=True)
connection, _ = server.accept()
connection.sendall(b"hello")
"""
# Runs what is to run in a pod here, with the claim's folder in place of the pod's.
RUNNING = """
import json, os, pathlib, subprocess, sys
top, *words = sys.argv[1:]
with open(os.path.join(top, "words"), "a") as file:
    file.write(" ".join(words[:6]) + "\\n")
if words[0] == "apply":
    pathlib.Path(top, "applied").write_text(sys.stdin.read())
elif words[0] == "wait" and os.path.exists(os.path.join(top, "unready")):
    sys.exit("error: timed out waiting for the condition")
elif words[0] == "get":
    print("0/3 nodes are available")
elif words[0] == "exec":
    claim = words[words.index("-n") + 2].removeprefix("robotkube-volume-")
    inside = words[words.index("--") + 1 :]
    folder = os.path.join(top, words[words.index("-n") + 1], claim)
    os.makedirs(folder, exist_ok=True)
    sys.exit(subprocess.call([sys.executable, *(word.replace("/volume", folder, 1) for word in inside[1:])]))
"""


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Forwards]:
    monkeypatch.setattr(forwards, "AGAIN_SECONDS", 0.01)
    made = Forwards([sys.executable, "-c", LISTENING, str(tmp_path / "words")])
    yield made
    made.end()


def heard(address: tuple[str, int]) -> bytes:
    try:
        with socket.create_connection(("127.0.0.1", address[1]), 5) as connection:
            return connection.recv(10)
    except OSError:
        return b""


def test_a_forward_that_ended_is_started_again_where_it_was(opened: Forwards, tmp_path: Path) -> None:
    address = opened.address(FORGE)
    assert opened.address(FORGE) == address
    assert heard(address) == b"hello"
    until(lambda: heard(address) == b"hello", "the forward again")
    words = (tmp_path / "words").read_text().splitlines()
    assert len(words) >= 2
    assert set(words) == {f"-n robotkube port-forward service/forge {address[1]}:3000"}


def test_what_ended_is_not_started_again(opened: Forwards) -> None:
    address = opened.address(FORGE)
    opened.end()
    assert heard(address) == b""


def test_a_service_that_is_not_reached_is_named_with_what_kubectl_says(
    opened: Forwards, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forwards, "READY_SECONDS_MAX", 0.5)
    (tmp_path / "refuse").touch()
    with pytest.raises(SetUpError, match=r"Service robotkube/forge, port 3000: kubectl port-forward does not reach it"):
        opened.address(FORGE)


def test_a_service_of_this_machine_is_reached_at_its_address() -> None:
    assert directly(FORGE) == ("10.96.0.9", 3000)
    assert WayOfAPerson(*directly(FORGE)).instruction == "http://10.96.0.9:3000/"
    assert WayOfAPerson("localhost", 1, "kubectl x").instruction == "http://localhost:1/ while this runs: kubectl x"


@pytest.fixture
def volumes(tmp_path: Path) -> PodVolumes:
    return PodVolumes(
        [sys.executable, "-c", RUNNING, str(tmp_path)], "registry.example/r/platform@sha256:0", tmp_path / "w"
    )


def bag(folder: Path, text: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "metadata.yaml").write_text("version: 5")
    (folder / "vehicle-00.mcap").write_text(text)
    return folder


def test_a_bag_is_copied_once_and_replaced_by_another(volumes: PodVolumes, tmp_path: Path) -> None:
    volumes.use([CLAIM])
    first = bag(tmp_path / "one" / "vehicle-00", "first")
    claim = tmp_path.joinpath(*CLAIM)
    assert not volumes.place(CLAIM, first)
    assert (claim / "vehicle-00" / "vehicle-00.mcap").read_text() == "first"
    assert not volumes.place(CLAIM, first)
    (claim / ".vehicle-00.partial").mkdir()
    assert volumes.place(CLAIM, bag(tmp_path / "two" / "vehicle-00", "a second one"))
    assert [one.name for one in claim.iterdir()] == ["vehicle-00"]
    assert (claim / "vehicle-00" / "vehicle-00.mcap").read_text() == "a second one"
    assert not list((tmp_path / "w").rglob("*.tar"))


def test_a_pod_with_a_claim_is_on_its_agents_node_as_host_or_guest(volumes: PodVolumes, tmp_path: Path) -> None:
    chosen = []
    for guests in ({}, {"vehicle-00": 2}):
        replace(volumes, guests=guests).use([CLAIM])
        [pod] = json.loads((tmp_path / "applied").read_text())["items"]
        chosen.append(pod["spec"]["nodeSelector"])
    assert chosen == [{"robotkube.io/agent": "vehicle-00"}, {"agent.robotkube.io/vehicle-00": "2"}]


def test_files_are_copied_and_their_ends_read(volumes: PodVolumes, tmp_path: Path) -> None:
    volumes.make(CLAIM, "ledger")
    (tmp_path.joinpath(*CLAIM) / "ledger" / "a").write_bytes(b"12345")
    assert volumes.fetch(CLAIM, "ledger/a").read_bytes() == b"12345"
    assert volumes.end_of(CLAIM, "ledger/a", 2) == b"45"
    assert volumes.end_of(CLAIM, "ledger/b", 2) == b""
    with pytest.raises(SetUpError, match=rf"volume claim vehicle-00/bags, {FOLDER}/ledger/b: (.*\n)*FileNotFoundError"):
        volumes.fetch(CLAIM, "ledger/b")


def test_pods_of_volumes_are_made_once_and_go(volumes: PodVolumes, tmp_path: Path) -> None:
    volumes.use([CLAIM, ("cloud-0", "recordings")])
    applied = (tmp_path / "applied").read_text()
    assert '"runAsNonRoot": true' in applied
    assert '"nodeSelector": {"robotkube.io/agent": "cloud-0"}' in applied
    volumes.use([CLAIM])
    (tmp_path.joinpath(*CLAIM)).mkdir(parents=True)
    (tmp_path.joinpath(*CLAIM) / "a").touch()
    copy = volumes.fetch(CLAIM, "a")
    volumes.end()
    assert not copy.exists()
    volumes.end()
    said = [line.split()[0] for line in (tmp_path / "words").read_text().splitlines()]
    assert said == ["delete", "apply", "wait", "wait", "exec", "delete"]


def test_a_pod_that_is_not_ready_is_named_with_its_events(volumes: PodVolumes, tmp_path: Path) -> None:
    (tmp_path / "unready").touch()
    with pytest.raises(
        SetUpError, match=r"pod vehicle-00/robotkube-volume-bags: .*timed out.*\n0/3 nodes are available"
    ):
        volumes.use([CLAIM])
