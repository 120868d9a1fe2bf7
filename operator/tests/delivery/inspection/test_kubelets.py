"""What kubelets list of pods, over real TLS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.inspection.adapters.kubelets import Kubelets
from robotkube.delivery.inspection.ports import NodeAddress, NodeReading
from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from tests.stages.delivery.inspection.inspected_node import pod_object
from tests.stages.kubernetes.served_kubelets import ServedKubelet

RUNNING = {"items": [{"metadata": {"uid": "u1"}, "spec": {"containers": [{"name": "detector"}]}}]}


def read(folder: Path, pods: Any) -> NodeReading:
    kubelet = ServedKubelet(folder)
    kubelet.answers = {"/pods": pods, "/runningpods/": RUNNING}
    with kubelet.served() as port, kubelet.client() as client:
        reading = Kubelets(ApiServer("http://127.0.0.1:1"), client).read(NodeAddress("a", "127.0.0.1", port))
    assert [path for path, _ in kubelet.asked] == ["/runningpods/", "/pods"]
    return reading


def test_both_lists_are_read(tmp_path: Path) -> None:
    reading = read(tmp_path, {"items": [pod_object()]})
    assert [pod.name for pod in reading.pods] == ["detector-5d9c7b-x"]
    assert [pod.containers for pod in reading.running] == [(("detector", ""),)]


@pytest.mark.parametrize("items", [[1], [{"spec": {"containers": ["x"]}}]])
def test_nonsense_is_no_list(tmp_path: Path, items: Any) -> None:
    with pytest.raises(UnavailableError, match="kubelet of node a: what it lists is no list of pods"):
        read(tmp_path, {"items": items})
