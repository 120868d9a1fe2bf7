"""Questions to kubelets over real TLS: what is refused, certificates that are not the cluster's, and no answer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.kubernetes.adapters.kubelet_client import KubeletClient
from tests.stages.kubernetes.served_kubelets import ServedKubelet

PATH = "/pods"


@pytest.fixture
def kubelet(tmp_path: Path) -> ServedKubelet:
    return ServedKubelet(tmp_path)


def ask(client: KubeletClient, port: int) -> Any:
    return client.get("kubelet of node a", "127.0.0.1", port, PATH)


def test_one_connection_is_kept_and_made_again_when_the_kubelet_closed_it(kubelet: ServedKubelet) -> None:
    kubelet.answers[PATH] = {"items": []}
    with kubelet.client() as client:
        with kubelet.served() as port:
            assert [ask(client, port) for _ in range(3)] == [{"items": []}] * 3
            assert kubelet.connections == 1
            next(iter(client._connections.values())).sock.shutdown(2)
            assert ask(client, port) == {"items": []}
        assert kubelet.connections == 2
    assert kubelet.asked == [(PATH, "Bearer secret")] * 4


@pytest.mark.parametrize("status", [401, 403])
def test_a_refusal_says_what_to_do(kubelet: ServedKubelet, status: int) -> None:
    kubelet.status = status
    words = rf"kubelet of node a \(127.0.0.1:\d+\), GET /pods: refused \({status}\); let the account"
    with (
        kubelet.served() as port,
        kubelet.client(right="let the account") as client,
        pytest.raises(InputError, match=words),
    ):
        ask(client, port)


def test_a_certificate_that_is_not_the_clusters_is_said_with_the_fix(kubelet: ServedKubelet, tmp_path: Path) -> None:
    kubelet.answers[PATH] = {}
    (tmp_path / "other").mkdir()
    words = r"its certificate is not trusted: .*kubelets\.verify: false"
    with kubelet.served() as port:
        with ServedKubelet(tmp_path / "other").client() as strict, pytest.raises(InputError, match=words):
            ask(strict, port)
        with kubelet.client(authority=False) as client:
            assert ask(client, port) == {}


@pytest.mark.parametrize(
    ("status", "answer", "words"),
    [(500, "down", '500 "down"'), (200, b"no json", "no JSON"), (200, [1], "no document")],
)
def test_nonsense_is_no_answer(kubelet: ServedKubelet, status: int, answer: Any, words: str) -> None:
    kubelet.status = status
    kubelet.answers[PATH] = answer
    with kubelet.served() as port, kubelet.client() as client, pytest.raises(UnavailableError, match=words):
        ask(client, port)


@pytest.mark.parametrize("lacking", ["token", "certificate"])
def test_nobody_answers_or_there_is_no_account(kubelet: ServedKubelet, tmp_path: Path, lacking: str) -> None:
    with kubelet.served() as port:
        pass
    with kubelet.client() as client, pytest.raises(UnavailableError, match="kubelet of node a"):
        ask(client, port)
    (tmp_path / lacking).unlink()
    with kubelet.client() as client, pytest.raises(UnavailableError, match="No such file"):
        ask(client, port)
