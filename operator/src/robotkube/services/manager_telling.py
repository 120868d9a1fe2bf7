"""The closing words of a plan: what was seen of it in the cluster, as a comment on its pull request.

The gate copies them to Git's notes. They are sent while nothing is planned, one at a time, so that no plan waits.
"""

from __future__ import annotations

import logging
from collections import deque

from robotkube.domain.closing import Facts, ReleaseFacts, closing_text
from robotkube.domain.errors import InputError
from robotkube.domain.releases import application_name
from robotkube.ports.clusters import Cluster
from robotkube.ports.forges import Forge
from robotkube.services.manager_records import PlanRecord

UNTOLD_MAX = 500  # of more, the oldest are not told

log = logging.getLogger(__name__)


class Telling:
    """Closing words of observed plans, oldest first."""

    def __init__(self, cluster: Cluster, forge: Forge) -> None:
        self._cluster, self._forge = cluster, forge
        self._untold: deque[tuple[int, str]] = deque(maxlen=UNTOLD_MAX)

    @property
    def waiting(self) -> bool:
        """Whether something is to be told."""
        return bool(self._untold)

    def observed(self, record: PlanRecord) -> None:
        """Take down what is seen now of a plan that is observed."""
        if record.pull_request is not None:
            self._untold.append((record.pull_request, closing_text(self._facts(record))))

    def tell_one(self) -> None:
        """Send the oldest; UnavailableError: it stays. What the forge refuses is dropped."""
        if not self._untold:
            return
        number, text = self._untold[0]
        try:
            self._forge.comment(number, text)
        except InputError as error:
            log.error("closing words refused pull_request=%d reason=%s", number, error)
        self._untold.popleft()

    def _facts(self, record: PlanRecord) -> Facts:
        applications = self._cluster.applications()
        releases = []
        for key in (*record.created, *record.changed):
            application = applications.get(application_name(*key.split("/")))
            pods = self._cluster.pods(key)
            releases.append(
                ReleaseFacts(
                    release=key,
                    sync=application.sync if application else "",
                    health=application.health if application else "",
                    nodes=tuple(sorted({pod.node for pod in pods if pod.node})),
                    images=tuple(sorted({image for pod in pods for image in pod.images})),
                )
            )
        return Facts(
            plan=record.id,
            commit=record.commit,
            merged=record.times.get("merged"),
            synced=record.times.get("synced"),
            observed=record.times.get("observed"),
            releases=tuple(releases),
            removed=record.removed,
            note=record.error or "",
        )
