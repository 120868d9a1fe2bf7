"""The command `robotkube status` while the gate is away: it stands out, and the command says what to do."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli import status
from robotkube.cli.forge_access import AccountAtForge
from robotkube.cli.main import main
from robotkube.delivery.inspection.core.statuses import manifest, status_of
from robotkube.delivery.inspection.core.strangers import Look, Stranger
from robotkube.foundation.documents.core.times import time_text
from tests.stages.delivery.audit.audited_platform import Platform
from tests.stages.delivery.audit.manipulations import break_glass
from tests.stages.kubernetes.served_objects import FORBIDDEN, serving

DEPLOYMENTS = "/apis/apps/v1/namespaces/{}/deployments/{}"
GATE = DEPLOYMENTS.format("robotkube-gate", "gate")
NAMESPACES = "/api/v1/namespaces"
INSPECTIONS = "/apis/robotkube.io/v1alpha1/namespaces/robotkube/inspections"
SINCE = "2026-11-24T20:15:00Z"
READY = {"spec": {"replicas": 1}, "status": {"availableReplicas": 1}}
NOT_READY = {
    "spec": {"replicas": 1},
    "status": {
        "replicas": 1,
        "unavailableReplicas": 1,
        "conditions": [
            {"type": "Progressing", "status": "True", "lastTransitionTime": "2026-11-01T08:00:00Z"},
            {"type": "Available", "status": "False", "lastTransitionTime": SINCE},
        ],
    },
}


class Cluster:
    """What the API server has: a gate in its namespace, an inspector, no strangers."""

    def __init__(self) -> None:
        gate = {"metadata": {"name": "robotkube-gate"}}
        self.objects: dict[str, Mapping[str, Any]] = {
            NAMESPACES: {"items": [gate]},
            GATE: READY,
            DEPLOYMENTS.format("robotkube", "inspector"): READY,
        }
        self.stranger: tuple[Stranger, ...] = ()

    def answer(self, path: str, query: Mapping[str, list[str]]) -> Mapping[str, Any] | None:
        look = Look("kubelet", self.stranger, node="vehicle-00")
        now = time_text(time.time_ns())
        inspection = {**manifest(look, "robotkube"), "status": status_of(look, {}, now)}
        return self.objects.get(path) if path != INSPECTIONS else {"items": [inspection]}


@pytest.fixture
def cluster() -> Cluster:
    return Cluster()


class Status:
    """The command at this cluster, whose forge is a folder."""

    def __init__(self, kubeconfig: Path, keys: Path, capture: pytest.CaptureFixture[str]) -> None:
        self._words = ("--kubeconfig", str(kubeconfig), "--keys", str(keys))
        self._capture = capture

    def run(self, *words: str) -> tuple[int, str, str]:
        code = main(["status", *self._words, *words])
        return code, *self._capture.readouterr()


@pytest.fixture
def asked(
    platform: Platform, cluster: Cluster, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> Iterator[Status]:  # fmt: skip
    def forge_account(options: argparse.Namespace, name: str) -> AccountAtForge:
        return AccountAtForge(str(platform.folder / "forge"), name, "x")

    monkeypatch.setattr(status, "forge_account", forge_account)
    monkeypatch.setattr(status, "RECORD_SECONDS_MAX", 0.0)
    with serving(cluster.answer, tmp_path) as kubeconfig:
        yield Status(kubeconfig, platform.folder / "keys", capsys)


def test_a_gate_that_is_there_is_no_news(asked: Status) -> None:
    code, out, err = asked.run()
    assert (code, err) == (0, "")
    assert "everything on it was checked by the gate" in out
    assert "gate is" not in out
    assert json.loads(asked.run("-o", "json")[1])["away"] == []


def test_a_gate_whose_pod_is_not_ready_stands_out(asked: Status, cluster: Cluster) -> None:
    cluster.objects[GATE] = NOT_READY
    code, out, err = asked.run()
    assert code == 1
    assert (
        f"; the gate is away since {SINCE}: its pod is not there, or not ready, which it is while it sees the forge: "
        "kubectl -n robotkube-gate describe pods, and logs deployment/gate, say why. Until it is back nothing is "
        "merged, published or signed; tasks and pull requests wait, what runs goes on. Repair it first; for what "
        "cannot wait: docs/how-to/break-the-glass.md" in err
    )
    assert out.splitlines()[0].split() == ["PROCESS", "NAMESPACE", "SINCE", "PROBLEM"]
    [row] = json.loads(asked.run("-o", "json")[1])["away"]
    assert (row["process"], row["namespace"], row["since"]) == ("gate", "robotkube-gate", SINCE)


def test_it_is_said_beside_what_came_past_the_gate_and_what_is_strange(
    asked: Status, cluster: Cluster, platform: Platform
) -> None:
    cluster.objects[GATE] = NOT_READY
    cluster.stranger = (Stranger("Pod", "vehicle-00", "miner", "NoRelease", "…"),)
    break_glass(platform)
    code, _, err = asked.run()
    assert code == 1
    places = [err.index(words) for words in ("the gate is away", "1 commit was let past the gate", "1 stranger runs")]
    assert places == sorted(places)


def test_a_gate_that_somebody_switched_off_or_deleted(asked: Status, cluster: Cluster) -> None:
    cluster.objects[GATE] = {"spec": {"replicas": 0}, "status": {}}
    assert (
        "the gate is away: it is scaled to 0: kubectl -n robotkube-gate scale deployment gate --replicas=1. Until"
        in asked.run()[2]
    )
    del cluster.objects[GATE]
    code, _, err = asked.run()
    assert code == 1
    assert "the gate is away: there is no Deployment gate in namespace robotkube-gate: upgrade the release of" in err


def test_who_may_not_see_the_gate_is_told_that(asked: Status, cluster: Cluster) -> None:
    """It is no proof that it is away."""
    cluster.objects[GATE] = FORBIDDEN
    code, out, err = asked.run()
    assert (code, err) == (0, "")
    assert f"whether the gate is there is not known: API server: GET {GATE}: 403 forbidden\n" in out
