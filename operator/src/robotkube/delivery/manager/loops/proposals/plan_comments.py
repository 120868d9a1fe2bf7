"""The outcome of a plan: what was observed of it in the cluster, as a comment on its pull request.

The gate copies it to Git's notes. Outcomes are sent while nothing is planned, one at a time, so that no plan waits.
"""

from __future__ import annotations

import logging
from collections import deque

from robotkube.delivery.deployment.core.plan_notes import PlanOutcome, ReleaseOutcome, outcome_comment
from robotkube.delivery.deployment.core.releases import application_name
from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.errors import InputError
from robotkube.foundation.forge.ports.pull_requests import Forge

UNSENT_MAX = 500  # of more, the oldest are not sent

log = logging.getLogger(__name__)


class PlanOutcomeComments:
    """The outcomes of observed plans that are to be sent, oldest first."""

    def __init__(self, cluster: Cluster, forge: Forge) -> None:
        self._cluster = cluster
        self._forge = forge
        self._unsent: deque[tuple[int, str]] = deque(maxlen=UNSENT_MAX)

    @property
    def waiting(self) -> bool:
        """Return whether an outcome is to be sent."""
        return bool(self._unsent)

    def observed(self, record: PlanRecord) -> None:
        """Note the outcome of a plan that is observed, as the cluster shows it now."""
        if record.pull_request is not None:
            self._unsent.append((record.pull_request, outcome_comment(self._facts(record))))

    def send_oldest(self) -> None:
        """Send the oldest outcome; UnavailableError: it stays. What the forge refuses is dropped."""
        if not self._unsent:
            return
        number, text = self._unsent[0]
        try:
            self._forge.comment(number, text)
        except InputError as error:
            log.error("plan outcome refused pull_request=%d reason=%s", number, error)
        self._unsent.popleft()

    def _facts(self, record: PlanRecord) -> PlanOutcome:
        applications = self._cluster.applications()
        releases = []
        for key in (*record.created, *record.changed):
            application = applications.get(application_name(*key.split("/")))
            pods = self._cluster.pods(key)
            releases.append(
                ReleaseOutcome(
                    release=key,
                    sync=application.sync if application else "",
                    health=application.health if application else "",
                    nodes=tuple(sorted({pod.node for pod in pods if pod.node})),
                    images=tuple(sorted({image for pod in pods for image in pod.images})),
                )
            )
        return PlanOutcome(
            plan=record.id,
            commit=record.commit,
            merged=record.times.get("merged"),
            synced=record.times.get("synced"),
            observed=record.times.get("observed"),
            releases=tuple(releases),
            removed=record.removed,
            note=record.error or "",
        )
