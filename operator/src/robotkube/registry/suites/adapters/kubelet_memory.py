"""Memory of pods as the kubelet of their node measures it: numbers, by the right to `get nodes/stats`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.times import time_ns
from robotkube.foundation.kubernetes.adapters.kubelet_client import PORT, KubeletClient
from robotkube.registry.suites.core.memory_growth import MemorySample
from robotkube.registry.suites.ports.suites import Object

PATH = "/stats/summary?only_cpu_and_memory=true"
TIMEOUT_SECONDS = 3.0
RIGHT = "let the account suite-runner get nodes/stats"


class KubeletMemory:
    """The port MemoryReader."""

    def __init__(self, client: KubeletClient, port: int = PORT) -> None:
        self._client = client
        self._port = port

    def read(self, pods: Sequence[Object]) -> Sequence[MemorySample]:
        """The last measured working set of each of the pods' containers."""
        names = {str(pod["metadata"].get("uid")): str(pod["metadata"].get("name")) for pod in pods}
        hosts = sorted({str((pod.get("status") or {}).get("hostIP") or "") for pod in pods} - {""})
        summaries = [self._client.get("kubelet", host, self._port, PATH) for host in hosts]
        try:
            return [sample for summary in summaries for sample in _samples(summary, names)]
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise UnavailableError(f"kubelet: what it answers is no summary: {error!r}") from error


def _samples(summary: Mapping[str, Any], names: Mapping[str, str]) -> Iterator[MemorySample]:
    for pod in summary.get("pods") or ():
        name = names.get(str(pod["podRef"].get("uid")))
        for container in (pod.get("containers") or ()) if name else ():
            memory = container.get("memory") or {}
            if name and "workingSetBytes" in memory and "time" in memory:
                seconds = time_ns(memory["time"]) / 1e9
                yield MemorySample(name, str(container["name"]), seconds, int(memory["workingSetBytes"]))
