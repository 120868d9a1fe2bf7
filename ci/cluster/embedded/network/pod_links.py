"""The addresses of a node's pods, as the node gave them out: containerd's network plug-ins leave a file per pod.

    <node>/cni-state/results/<network>-<sandbox>-eth0   a result of libcni, written before the pod's first process runs

The API server says the same later, and says what whoever may write a pod's status says.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import IPv4Interface
from pathlib import Path
from typing import Any

RESULTS = "results"
NETWORK = "robotkube"  # name of the nodes' network
INTERFACE = "eth0"  # in the pod
PORT = re.compile(r"[A-Za-z0-9_.-]{1,15}")
SETTLED_NS = 10**9  # a folder that has changed within this time is read again: its clock ticks in milliseconds


@dataclass(frozen=True)
class PodLink:
    """A pod's connection to its node: `port` of the node's bridge, the pod's address, and which pod it is."""

    port: str
    address: str
    namespace: str
    name: str
    uid: str


class NodeLinks:
    """The links of one node, from its folder of results. Reading is cheap while nothing changes."""

    def __init__(self, folder: Path, clock_ns: Callable[[], int] = time.time_ns) -> None:
        self._folder = folder
        self._clock_ns = clock_ns
        self._changed_ns = -1
        self._settled = False
        self._links: dict[str, PodLink | None] = {}
        self._known: frozenset[PodLink] = frozenset()  # the same one while nothing changes: it is compared often

    def read(self) -> frozenset[PodLink]:
        """The links now. A file that cannot be read (it is being written, or is no result) gives none, and is read
        again."""
        try:
            changed = self._folder.stat().st_mtime_ns
        except FileNotFoundError:
            return frozenset()  # before the node's first pod
        if not self._settled or changed != self._changed_ns:
            self._settled = self._clock_ns() - changed > SETTLED_NS
            self._changed_ns = changed
            self._read_new()
        return self._known

    def _read_new(self) -> None:
        names = {path.name for path in self._folder.iterdir() if _is_result(path.name)}
        self._links = {name: self._links.get(name) or _read(self._folder / name) for name in sorted(names)}
        self._known = frozenset(link for link in self._links.values() if link)
        self._settled = self._settled and None not in self._links.values()


def _is_result(name: str) -> bool:
    return name.startswith(f"{NETWORK}-") and name.endswith(f"-{INTERFACE}")


def _read(path: Path) -> PodLink | None:
    try:
        return read_link(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def read_link(document: Any) -> PodLink:
    """The link of a result of libcni (its form `cniCacheV1`). ValueError, KeyError or TypeError when it is none."""
    result = document["result"]
    words = dict(document["cniArgs"])
    [number] = [at for at, one in enumerate(result["interfaces"]) if one["name"] == INTERFACE and one.get("sandbox")]
    [address] = {str(IPv4Interface(one["address"]).ip) for one in result["ips"] if one["interface"] == number}
    # The plug-in names the bridge first, then the port it made on it.
    [_, port] = [one["name"] for one in result["interfaces"] if not one.get("sandbox")]
    if not PORT.fullmatch(port):
        raise ValueError(f"{port!r} is no name of a port")
    return PodLink(port, address, words["K8S_POD_NAMESPACE"], words["K8S_POD_NAME"], words["K8S_POD_UID"])
