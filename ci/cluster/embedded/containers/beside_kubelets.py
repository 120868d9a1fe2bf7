"""Which containers of a node nobody of the cluster started: pure comparison of what its containerd runs with what its
kubelet wrote down.

Names, labels and annotations of a container are chosen by whoever starts it, so none of them makes it a known one:

- A container is known by the link that the kubelet makes to its log right after it has started it. It has the
  container's id in its name, and is younger than the container.
- A pod's sandbox is known by the known containers in it. As long as there are none, it is known when the kubelet keeps
  a folder for its pod, the runtime's CRI service keeps a record of it (then the kubelet sees it, and ends what it did
  not ask for), and no other sandbox says to be of this pod.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

KUBELETS = "k8s.io"  # containerd's namespace of what kubelets start
SANDBOX, CONTAINER = "sandbox", "container"
# The kubelet writes its link when containerd has answered, and seventeen nodes that start their pods share two cores:
# until then nothing is said of a container in the kubelets' namespace. With a look every second it is named 10 s after
# its start at the latest, and 14 s after it where it is not known whether it was started.
GRACE_SECONDS = 8.0
MAKING_SECONDS = 12.0  # of one that runc has not made yet, or that another runtime runs
LINK_CHARACTERS_MAX = 255  # of a file's name, where the kubelet cuts it
LINK_ENDING = ".log"


@dataclass(frozen=True)
class RuntimeContainer:
    """A container that a node's runtime runs. `runtime_namespace` and `id` are the runtime's; all others are what the
    container says of itself, but for `made_ns`, when its files were made, and what runc wrote down of it: it
    `waits` to be started, or was `started`."""

    runtime_namespace: str
    id: str
    made_ns: int = 0
    kind: str = ""
    sandbox: str = ""
    pod_namespace: str = ""
    pod: str = ""
    pod_uid: str = ""
    name: str = ""
    program: str = ""
    waits: bool = False
    started: bool = False

    @property
    def key(self) -> str:
        """What it is called by."""
        return f"{self.runtime_namespace}/{self.id}"

    @property
    def link(self) -> str:
        """The name that its kubelet's link has, as Kubernetes makes it (pkg/kubelet/kuberuntime/legacy.go)."""
        whole = f"{self.pod}_{self.pod_namespace}_{self.name}-{self.id}"
        return whole[: LINK_CHARACTERS_MAX - len(LINK_ENDING)] + LINK_ENDING


@dataclass(frozen=True)
class NodeContents:
    """What a node has: its runtime's containers; the kubelet's links (when each was made, by name) and the uids of pods
    with a folder; the ids of sandboxes of which the runtime's CRI service keeps a record."""

    containers: tuple[RuntimeContainer, ...] = ()
    links: Mapping[str, int] = field(default_factory=dict)
    pods: frozenset[str] = frozenset()
    recorded: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Unknown:
    """A container that nobody of the cluster started, and what gave it away."""

    container: RuntimeContainer
    why: str
    certain: bool = False  # no kubelet could make it a known one a moment later

    @property
    def grace_seconds(self) -> float:
        """The seconds that it may stay unknown before it is named."""
        return GRACE_SECONDS if self.container.started else MAKING_SECONDS


def unknown(node: NodeContents) -> tuple[Unknown, ...]:
    """The containers of a node that nobody of the cluster started, or that its kubelet is just about to write down.
    Nothing runs in one that waits."""
    running = [container for container in node.containers if not container.waits]
    others = [one for one in running if one.runtime_namespace != KUBELETS]
    own = [one for one in running if one.runtime_namespace == KUBELETS]
    started = [one for one in own if _is_started(one, node)]
    sandboxes = _sandboxes(own, started, node)
    known = {one.id for one in (*started, *sandboxes)}
    strangers = [Unknown(one, _elsewhere(one), certain=True) for one in others]
    strangers += [Unknown(one, _why(one)) for one in own if one.id not in known]
    return tuple(sorted(strangers, key=lambda one: one.container.key))


def _is_started(one: RuntimeContainer, node: NodeContents) -> bool:
    """Return whether the kubelet started it. A link that is older is of another container, which had this id before."""
    return one.kind == CONTAINER and node.links.get(one.link, -1) >= one.made_ns


def _sandboxes(
    own: Iterable[RuntimeContainer], started: Iterable[RuntimeContainer], node: NodeContents
) -> list[RuntimeContainer]:
    """The sandboxes that the kubelet made: one with started containers in it is older than all of them."""
    sandboxes = [one for one in own if one.kind == SANDBOX]
    oldest = {one.sandbox: one.made_ns for one in sorted(started, key=lambda one: -one.made_ns)}
    sandboxes_of_pod = Counter(sandbox.pod_uid for sandbox in sandboxes)
    return [
        sandbox
        for sandbox in sandboxes
        if sandbox.made_ns <= oldest.get(sandbox.id, -1)
        or (sandbox.id not in oldest and sandboxes_of_pod[sandbox.pod_uid] == 1 and _is_recorded(sandbox, node))
    ]


def _is_recorded(one: RuntimeContainer, node: NodeContents) -> bool:
    return one.pod_uid in node.pods and one.id in node.recorded


def _elsewhere(one: RuntimeContainer) -> str:
    return f"containerd's namespace {one.runtime_namespace} is not {KUBELETS}, which is that of kubelets"


def _why(one: RuntimeContainer) -> str:
    pod = f"pod {one.pod_namespace}/{one.pod}"
    if one.kind == SANDBOX:
        return f"the kubelet made no such sandbox, though it says to be that of {pod}"
    declared = f", though it says to be container {one.name} of {pod}" if one.pod else ""
    return f"the kubelet started no such container{declared}"


@dataclass(frozen=True)
class Watched:
    """The time since which each unknown container has been seen in every look, by node and key; seconds of a clock that
    only grows."""

    since: Mapping[tuple[str, str], float] = field(default_factory=dict)

    def after(self, node: str, seen: Iterable[Unknown], now: float) -> Watched:
        """The same after another look at a node."""
        others = {key: since for key, since in self.since.items() if key[0] != node}
        own = {(node, one.container.key): self.since.get((node, one.container.key), now) for one in seen}
        return Watched({**others, **own})

    def named(self, node: str, seen: Iterable[Unknown], now: float) -> tuple[Unknown, ...]:
        """Those of a node that are to be named."""
        return tuple(
            one
            for one in seen
            if one.certain or now - self.since.get((node, one.container.key), now) >= one.grace_seconds
        )


def message(node: str, one: Unknown) -> str:
    """What it is, why it may not run, and what to do."""
    runs = f" runs {one.container.program}" if one.container.program else ""
    kill = f"ctr --namespace {one.container.runtime_namespace} tasks kill --signal SIGKILL {one.container.id}"
    return (
        f"container {one.container.key} on node {node}{runs}: {one.why}. It was started beside the kubelet, through "
        f"the machine's own runtime. Find out who may reach the runtime; end it on the machine with `{kill}`"
    )
