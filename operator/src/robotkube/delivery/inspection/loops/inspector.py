"""The inspector's loop: every node every NODE_SECONDS, spread over that time, and the workloads of releases every
RELEASES_SECONDS; what looks strange is looked at again CONFIRM_SECONDS later, after what may run has been read anew."""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from robotkube.backoffs import Random, backoff
from robotkube.delivery.inspection.core.confirmations import CONFIRM_SECONDS, Confirmations
from robotkube.delivery.inspection.core.strangers import KUBELET, MACHINE, Look
from robotkube.delivery.inspection.loops.looks import NodeLooks, ReleaseLooks
from robotkube.delivery.inspection.loops.reporting import Reporter
from robotkube.delivery.inspection.ports import NodeAddress, NodeReading, Nodes, PermittedSource
from robotkube.errors import InputError, UnavailableError

NODE_SECONDS = 8.0  # with the kubelet's own 2 s and two looks again it is named within 15 s
RELEASES_SECONDS = 10.0
AGAIN_SECONDS = CONFIRM_SECONDS + 0.1
SILENT_SECONDS = 30.0  # until a kubelet is asked again that did not answer twice: it may be away for long
NODES_SECONDS = 30.0  # how often the list of nodes is read
REFRESH_SECONDS = 30.0  # how often what may run is read, while nothing is strange
RETRY_SECONDS = 2.0  # until it is read again after a failure, doubled with each further one
ATTEND_SECONDS = 3.0  # how often all Inspections are read: what others wrote into ours, and what machines' say
AT_ONCE = 4  # kubelets that are asked at the same time
IDLE_SECONDS = 0.5

log = logging.getLogger(__name__)

Answer = NodeReading | UnavailableError | InputError


@dataclass
class _Schedule:
    """The next times of what is to be looked at, in seconds of the clock."""

    nodes: dict[str, float] = field(default_factory=dict)
    releases: float = 0.0
    list: float = 0.0
    refresh: float = 0.0
    attend: float = 0.0


class Inspector:
    """Looks and reports; `clock` is monotonic, in seconds; `jitter` shortens pauses after failures. `step` is for one
    thread, `reasons_not_ready` for any."""

    def __init__(
        self,
        nodes: Nodes,
        looks: tuple[NodeLooks, ReleaseLooks],
        source: PermittedSource,
        reporter: Reporter,
        clock: Callable[[], float],
        jitter: Random = random.random,
    ) -> None:
        self._nodes = nodes
        self._node_looks, self._release_looks = looks
        self._source = source
        self._reporter = reporter
        self._clock = clock
        self._jitter = jitter
        self._failed_refreshes = 0
        self._due = _Schedule()
        self._addresses: dict[str, NodeAddress] = {}
        self._silent: set[str] = set()  # nodes whose kubelet did not answer the last time
        self._confirmations: dict[str, Confirmations] = {}
        self._problems: dict[str, str] = {"start": "nothing was looked at yet"}
        self._pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="kubelets")

    def run(self, stopping: threading.Event) -> None:
        """Look until `stopping` is set."""
        while not stopping.is_set():
            self.step()
            stopping.wait(max(0.0, min(IDLE_SECONDS, self._next() - self._clock())))

    def stop(self) -> None:
        """Let the threads that ask kubelets end."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def reasons_not_ready(self) -> list[str]:
        """What keeps it from looking, a sentence each."""
        return [problem for problem in list(self._problems.values()) if problem]

    def step(self) -> None:
        """Do what is due."""
        now = self._clock()
        if now >= self._due.refresh:
            self._refresh()
        if now >= self._due.list:
            self._due.list = now + NODES_SECONDS
            self._attempt("nodes", self._list_nodes)
        if now >= self._due.attend:
            self._due.attend = now + ATTEND_SECONDS
            self._attempt("inspections", lambda: self._reporter.attend(f"{MACHINE}."))
        due = [self._addresses[name] for name, at in self._due.nodes.items() if at <= now]
        for node, answer in zip(due, self._pool.map(self._ask, due), strict=True):
            self._node(node, answer)
        if now >= self._due.releases:
            self._releases()
        self._problems.pop("start", None)

    def _refresh(self) -> None:
        """Read what may run. A forge that is not there yet is asked again soon: until then nothing can be judged."""
        if self._attempt("what may run", self._source.refresh):
            self._failed_refreshes = 0
            pause = REFRESH_SECONDS
        else:
            pause = backoff(self._failed_refreshes, RETRY_SECONDS, REFRESH_SECONDS, self._jitter)
            self._failed_refreshes += 1
        self._due.refresh = self._clock() + pause

    def _list_nodes(self) -> None:
        """Nodes that came are looked at within NODE_SECONDS, spread over them; of those that are gone nothing stays."""
        addresses = {node.name: node for node in self._nodes.addresses()}
        new = sorted(addresses.keys() - self._addresses.keys())
        begin = self._clock()
        for number, name in enumerate(new):
            self._due.nodes[name] = begin + number * NODE_SECONDS / len(new)
        for name in self._addresses.keys() - addresses.keys():
            self._due.nodes.pop(name, None)
            self._confirmations.pop(f"{KUBELET}.{name}", None)
        if new or addresses.keys() != self._addresses.keys():
            self._reporter.forget_others((f"{KUBELET}.{name}" for name in addresses), f"{KUBELET}.")
        self._addresses = addresses

    def _ask(self, node: NodeAddress) -> Answer:
        try:
            return self._nodes.read(node)
        except (UnavailableError, InputError) as error:
            return error

    def _node(self, node: NodeAddress, answer: Answer) -> None:
        now = self._clock()
        if isinstance(answer, NodeReading):
            look = self._node_looks.look(node, answer, self._source.permitted())
            self._due.nodes[node.name] = now + NODE_SECONDS
            self._silent.discard(node.name)
        else:
            look = Look(KUBELET, node=node.name, problem=str(answer))
            self._due.nodes[node.name] = now + (SILENT_SECONDS if node.name in self._silent else NODE_SECONDS)
            self._silent.add(node.name)
        if self._report(look):
            self._due.nodes[node.name] = now + AGAIN_SECONDS

    def _releases(self) -> None:
        look = self._release_looks.look(self._source.permitted())
        self._due.releases = self._clock() + RELEASES_SECONDS
        if self._report(look):
            self._release_looks.again()
            self._due.releases = self._clock() + AGAIN_SECONDS

    def _report(self, look: Look) -> bool:
        """Report what is confirmed; whether there is more, which has to be looked at again. What may run is read before
        that: a publication or a merge may explain it."""
        pending = False
        try:
            if not look.problem:
                confirmed, pending = self._confirmation(look.name).confirm(look.strangers, self._clock())
                look = Look(look.looks_at, confirmed, look.node, partly=look.partly)
            self._reporter.report(look)
            self._problems[look.name] = ""
        except (UnavailableError, InputError) as error:
            self._note(look.name, str(error))
        if pending:
            self._refresh()
        return pending

    def _confirmation(self, name: str) -> Confirmations:
        if name not in self._confirmations:
            self._confirmations[name] = Confirmations(self._reporter.known(name))
        return self._confirmations[name]

    def _attempt(self, what: str, action: Callable[[], None]) -> bool:
        try:
            action()
        except (UnavailableError, InputError) as error:
            self._note(what, str(error))
            return False
        self._problems[what] = ""
        return True

    def _note(self, what: str, problem: str) -> None:
        """Log a problem when it comes and when it is another one."""
        if self._problems.get(what) != problem:
            log.warning("inspection hindered what=%r problem=%r", what, problem)
        self._problems[what] = problem

    def _next(self) -> float:
        own = (self._due.refresh, self._due.list, self._due.releases, self._due.attend)
        return min([*own, *self._due.nodes.values()])
