"""What a node's containerd runs and what its kubelet wrote down, read from the node's files: no program is started and
none is asked, so seventeen nodes are looked at in milliseconds.

    <node>/run/containerd/io.containerd.runtime.v2.task/<namespace>/<id>/   a container that runs, with its config.json
    <node>/run/containerd/runc/<namespace>/<id>/                            runc has made it (state.json), and it waits
                                                                            to be started as long as there is exec.fifo
    <node>/run/containerd/io.containerd.sandbox.controller.v1.shim/...      a sandbox that a shim made (no kubelet's)
    <node>/run/containerd/io.containerd.grpc.v1.cri/sandboxes/<id>/         a sandbox that the CRI service made
    <node>/container-links/<pod>_<namespace>_<container>-<id>.log           a container that the kubelet started
    <node>/kubelet/pods/<uid>/                                              a pod that the kubelet runs

containerd makes the folder before a container's first process, and takes it away after the last one.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ci.cluster.embedded.containers.beside_kubelets import NodeContents, RuntimeContainer
from ci.cluster.embedded.network.pod_links import SETTLED_NS

STATE = Path("run/containerd")
RUNNING = (STATE / "io.containerd.runtime.v2.task", STATE / "io.containerd.sandbox.controller.v1.shim")
RECORDED = STATE / "io.containerd.grpc.v1.cri/sandboxes"
LINKS = Path("container-links")
PODS = Path("kubelet/pods")
SPECIFICATION = "config.json"
RECORDS = "runc"
MADE = "state.json"
WAITS = "exec.fifo"
ANNOTATIONS = "io.kubernetes.cri."
PROGRAM_CHARACTERS_MAX = 200
Seen = tuple[Path, str, str, int]  # a container's folder, its namespace, its id, and when its files were made


class NodeContainers:
    """The containers of one node, from its folder. Reading is cheap while nothing changes, and a container's file is
    read once."""

    def __init__(self, folder: Path, clock_ns: Callable[[], int] = time.time_ns) -> None:
        self._folder = folder
        self._clock_ns = clock_ns
        self._known: dict[Seen, RuntimeContainer] = {}
        self._node = NodeContents()
        self._changed: Mapping[str, int] | None = None  # of each folder that says what `_node` has; None: read again

    def read(self) -> NodeContents:
        """What is there now; OSError when it cannot be read."""
        if self._changed is None or self._changed != {place: _changed_ns(place) for place in self._changed}:
            now = self._clock_ns()
            changed = {place: _changed_ns(place) for place in self._places()}
            self._node = self._read()
            settled = all(now - at > SETTLED_NS for at in changed.values())
            self._changed = changed if settled and len(self._known) == len(self._node.containers) else None
        return self._node

    def _places(self) -> Iterator[str]:
        """The folders that change when a container, a link, a pod or a record comes or goes."""
        for place in (*RUNNING, RECORDED, LINKS, PODS):
            yield str(self._folder / place)
        for place in RUNNING:
            yield from (str(self._folder / place / namespace) for namespace in _names(self._folder / place))

    def _read(self) -> NodeContents:
        """What runs is read first: what the kubelet wrote down of it is there by then."""
        seen = [one for place in RUNNING for one in _running(self._folder / place)]
        containers = {one: self._known.get(one) or _container(one) for one in seen}
        self._known = {one: container for one, container in containers.items() if _is_settled(container)}
        return NodeContents(
            tuple(containers.values()),
            links=dict(_links(self._folder / LINKS)),
            pods=frozenset(_names(self._folder / PODS)),
            recorded=frozenset(_names(self._folder / RECORDED)),
        )


def _is_settled(one: RuntimeContainer) -> bool:
    """Return whether it needs not be read again: it runs, and its file was there as a whole."""
    return bool(one.kind or one.program) and one.started


def _changed_ns(place: str) -> int:
    """The time at which a folder changed last; 0 as long as there is none."""
    try:
        return os.stat(place).st_mtime_ns  # noqa: PTH116 - a hundred of them in each look
    except FileNotFoundError:
        return 0


def _running(place: Path) -> Iterator[Seen]:
    for namespace in _names(place):
        for name in _names(place / namespace):
            folder = place / namespace / name
            if not name.startswith("."):  # such a one is being removed
                yield folder, namespace, name, _made_ns(folder)


def _made_ns(folder: Path) -> int:
    """The time at which a container's files were made; 0 as long as they are not."""
    try:
        return (folder / SPECIFICATION).stat().st_ctime_ns
    except FileNotFoundError:
        return 0


def _container(seen: Seen) -> RuntimeContainer:
    """A container with what it says of itself; nothing of that while its file cannot be read."""
    folder, namespace, name, made_ns = seen
    try:
        document: Any = json.loads((folder / SPECIFICATION).read_bytes())
        records = folder.parents[2] / RECORDS / namespace / name
        made = (records / MADE).exists()  # asked first: the other one is there before it
        waits = (records / WAITS).exists()
        return RuntimeContainer(
            namespace, name, made_ns, **_declared(document), waits=waits, started=made and not waits
        )
    except (FileNotFoundError, ValueError, KeyError, TypeError, AttributeError, IndexError):
        return RuntimeContainer(namespace, name, made_ns)


def _declared(document: Mapping[str, Any]) -> dict[str, Any]:
    """What an OCI runtime configuration says, as containerd's CRI service annotates it."""
    said = document.get("annotations") or {}
    keys = {
        "kind": "container-type",
        "sandbox": "sandbox-id",
        "pod_namespace": "sandbox-namespace",
        "pod": "sandbox-name",
        "pod_uid": "sandbox-uid",
        "name": "container-name",
    }
    declared = {key: str(said.get(ANNOTATIONS + annotation, "")) for key, annotation in keys.items()}
    return {**declared, "program": str(document["process"]["args"][0])[:PROGRAM_CHARACTERS_MAX]}


def _links(place: Path) -> Iterator[tuple[str, int]]:
    """Names of the kubelet's links, and when each was made."""
    for name in _names(place):
        with contextlib.suppress(FileNotFoundError):  # it went meanwhile
            yield name, (place / name).lstat().st_ctime_ns


def _names(place: Path) -> list[str]:
    """Names in a folder; none when there is no such folder (yet)."""
    try:
        return os.listdir(place)  # noqa: PTH208 - hundreds of names in each look
    except (FileNotFoundError, NotADirectoryError):
        return []
