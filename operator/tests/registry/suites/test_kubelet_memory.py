"""A kubelet's numbers over real TLS: what is read of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import UnavailableError
from robotkube.registry.suites.adapters.kubelet_memory import PATH, KubeletMemory
from robotkube.registry.suites.core.memory_growth import MemorySample
from tests.stages.kubernetes.served_kubelets import ServedKubelet

PODS = [{"metadata": {"name": "greeter-1", "uid": "u1"}, "status": {"hostIP": "127.0.0.1"}}]
MEMORY = {"time": "1970-01-01T00:01:00Z", "workingSetBytes": 7, "usageBytes": 9}
SUMMARY = {
    "pods": [
        {"podRef": {"uid": "u1"}, "containers": [{"name": "main", "memory": MEMORY}, {"name": "new"}]},
        {"podRef": {"uid": "other"}, "containers": [{"name": "main", "memory": MEMORY}]},
        {"podRef": {"uid": "u1"}},
    ]
}


def read(folder: Path, answer: Any, pods: Sequence[dict[str, Any]]) -> Sequence[MemorySample]:
    kubelet = ServedKubelet(folder)
    kubelet.answers[PATH] = answer
    with kubelet.served() as port, kubelet.client() as client:
        return KubeletMemory(client, port).read(pods)


def test_the_working_sets_of_these_pods_are_read(tmp_path: Path) -> None:
    assert read(tmp_path, SUMMARY, PODS) == [MemorySample("greeter-1", "main", 60.0, 7)]
    assert read(tmp_path, SUMMARY, []) == []


def test_nonsense_is_no_summary(tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match="is no summary"):
        read(tmp_path, {"pods": [{"podRef": 3}]}, PODS)
