"""The manager's upkeep besides planning: it reports Nodes of unknown agents, and deletes tasks without a parent."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

from robotkube.delivery.manager.core.placement.placement import Agent
from robotkube.delivery.manager.loops.unknown_agents import UnknownAgents
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.errors import RobotKubeError
from robotkube.foundation.kubernetes.core.objects import is_withdrawn, object_key

ORPHAN_SECONDS = 10.0  # so long a parent must be gone before what it launched is deleted
DELETED_AT_ONCE_MAX = 16

log = logging.getLogger(__name__)


class Orphans:
    """Tasks whose parent is deleted: their demands count as withdrawn already, and nobody else deletes them when the
    detector that wrote them went with the parent."""

    def __init__(self, tasks: TaskStore, monotonic: Callable[[], float]) -> None:
        self._tasks = tasks
        self._monotonic = monotonic
        self._since: dict[str, float] = {}

    def resync(self) -> None:
        """Delete tasks that have been without their parent for ORPHAN_SECONDS, at most DELETED_AT_ONCE_MAX at once. A
        deletion that fails is tried again with the next resync."""
        parents = {
            object_key(d): str(_chain(d).get("parent") or "") for d in self._tasks.tasks() if not is_withdrawn(d)
        }
        now = self._monotonic()
        left = [key for key, parent in parents.items() if parent and parent not in parents]
        self._since = {key: self._since.get(key, now) for key in left}
        ripe = sorted(key for key, since in self._since.items() if now - since >= ORPHAN_SECONDS)
        for key in ripe[:DELETED_AT_ONCE_MAX]:
            self._delete(key, parents[key])

    def _delete(self, key: str, parent: str) -> None:
        try:
            self._tasks.withdraw(*key.split("/", 1))
        except RobotKubeError as error:
            log.error("task not deleted task=%s reason=%s", key, error)
            return
        log.info("task deleted task=%s parent=%s", key, parent)


def _chain(document: object) -> dict[str, object]:
    spec = document.get("spec") if isinstance(document, dict) else None
    chain = spec.get("chain") if isinstance(spec, dict) else None
    return chain if isinstance(chain, dict) else {}


class Upkeep:
    """All upkeep together."""

    def __init__(
        self, cluster: Cluster, tasks: TaskStore, agents: Callable[[], Iterable[Agent]], monotonic: Callable[[], float]
    ) -> None:
        self._unknown = UnknownAgents(cluster, agents)
        self._orphans = Orphans(tasks, monotonic)

    def resync(self) -> None:
        """Do what is due."""
        self._unknown.resync()
        self._orphans.resync()
