"""Looks at a node by its kubelet, and at the workloads of releases: each says what is strange, or why it cannot see."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from robotkube.delivery.inspection.core.permitted import CHARTS_KIND, SETTINGS_KIND, Permitted
from robotkube.delivery.inspection.core.pod_checks import strangers_on
from robotkube.delivery.inspection.core.strangers import KUBELET, RELEASES, Look, Stranger
from robotkube.delivery.inspection.core.workload_checks import strangers_among
from robotkube.delivery.inspection.ports import NodeAddress, NodeReading, Workloads
from robotkube.errors import InputError, UnavailableError

REMEMBERED_SECONDS = 600.0  # a kubelet forgets a pod before the last container of it has ended
STARTING_SECONDS = 60.0
FINE_MAX = 20_000
OTHERS_MAX = 1000  # lists of further kinds in one look: all of them, for 142 agents
MALFORMED = (AttributeError, KeyError, TypeError, ValueError)  # one kubelet must not end the looks at all others
NOTHING_READ = "what may run was not read yet: the forge or the OCI registry does not answer"
STARTING = "its kubelet has no list of pods of the API server yet, while its runtime has some: it is starting"


class NodeLooks:
    """Looks at nodes, with what each kubelet listed lately; `clock` is the wall clock in seconds."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._known: dict[str, dict[str, tuple[frozenset[str], float]]] = {}  # node -> uid -> names, when
        self._empty_since: dict[str, float] = {}

    def look(self, node: NodeAddress, reading: NodeReading, permitted: Permitted | None) -> Look:
        """A look at what a kubelet listed."""
        now = self._clock()
        known = self._remember(node.name, reading, now)
        if self._is_starting(node.name, reading, now):
            return Look(KUBELET, node=node.name, problem=STARTING)
        if permitted is None:
            return Look(KUBELET, node=node.name, problem=NOTHING_READ)
        names = {uid: containers for uid, (containers, _) in known.items()}
        try:
            strangers = strangers_on(reading.pods, reading.running, names, permitted, now)
        except UnavailableError as error:  # what main had before is rendered when it is asked for
            return Look(KUBELET, node=node.name, problem=str(error))
        except MALFORMED as error:
            return Look(
                KUBELET, node=node.name, problem=f"what its kubelet lists is of no form that pods have: {error!r}"
            )
        return Look(KUBELET, strangers, node.name)

    def _remember(self, node: str, reading: NodeReading, now: float) -> Mapping[str, tuple[frozenset[str], float]]:
        earlier = self._known.get(node, {})
        kept = {uid: entry for uid, entry in earlier.items() if now - entry[1] <= REMEMBERED_SECONDS}
        self._known[node] = {**kept, **{pod.uid: (pod.names, now) for pod in reading.pods}}
        return self._known[node]

    def _is_starting(self, node: str, reading: NodeReading, now: float) -> bool:
        """Return whether a kubelet that was started just now has not heard from the API server: then it knows static
        pods alone, and everything else would look foreign."""
        if any(not pod.static for pod in reading.pods) or not reading.running:
            self._empty_since.pop(node, None)
            return False
        return now - self._empty_since.setdefault(node, now) < STARTING_SECONDS


class ReleaseLooks:
    """Looks at the workloads of agents' namespaces: at Deployments and ConfigMaps, and at as many further kinds as
    OTHERS_MAX lets, in turn. What another kind starts is a pod, which its node shows; one that starts none is seen
    here alone."""

    def __init__(self, workloads: Workloads) -> None:
        self._workloads = workloads
        self._turn = self._began = 0  # how many further kinds were looked at, and had been before the last look
        self._others: dict[str, tuple[Stranger, ...]] = {}  # by kind, as it was looked at last
        self._fine: set[tuple[str, ...]] = set()  # versions of workloads at which nothing was strange
        self._by: tuple[Any, ...] = ()  # what they were compared with

    def look(self, permitted: Permitted | None) -> Look:
        """A look at what the API server has."""
        if permitted is None:
            return Look(RELEASES, problem=NOTHING_READ)
        self._compare_with(permitted)
        try:
            strangers = [one for kind in (CHARTS_KIND, SETTINGS_KIND) for one in self._of_kind(kind, permitted)]
            for kind in self._in_turn(len(permitted.domain.agents)):
                self._others[kind] = tuple(self._of_kind(kind, permitted))
                self._turn += 1
        except (UnavailableError, InputError) as error:
            return Look(RELEASES, problem=str(error))
        others = (stranger for of_namespace in self._others.values() for stranger in of_namespace)
        unknown = [shape.unknown for shapes in permitted.releases.values() for shape in shapes if shape.unknown]
        return Look(RELEASES, tuple(sorted({*strangers, *others})), partly="; ".join(unknown))

    def again(self) -> None:
        """Look at the same kinds the next time: something of them is to be confirmed."""
        self._turn = self._began

    def _in_turn(self, agents: int) -> Sequence[str]:
        """The further kinds that this look is for."""
        self._began = self._turn
        kinds = self._workloads.kinds
        count = min(len(kinds), max(1, OTHERS_MAX // max(1, agents)))
        return [kinds[(self._turn + place) % len(kinds)] for place in range(count)]

    def _compare_with(self, permitted: Permitted) -> None:
        by = (permitted.releases, permitted.allowed, permitted.lately)
        if not self._by or by[0] is not self._by[0] or by[1:] != self._by[1:] or len(self._fine) > FINE_MAX:
            self._fine.clear()
        self._by = by

    def _of_kind(self, kind: str, permitted: Permitted) -> Iterator[Stranger]:
        for namespace in permitted.domain.agents:
            for workload in self._workloads.read(namespace, kind):
                metadata = workload["metadata"]
                version = (kind, *(str(metadata.get(key, "")) for key in ("uid", "resourceVersion")))
                if version in self._fine:
                    continue
                strangers = tuple(strangers_among(workload, kind, permitted))
                if not strangers:
                    self._fine.add(version)
                yield from strangers
