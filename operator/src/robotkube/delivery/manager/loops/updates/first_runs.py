"""First runs: whether a release has ever been healthy with the version that it has.

The cluster does not remember that of an agent that was away. This process has seen it, or the outcome of the update's
plan says so, which the gate writes into a Git note when everything in the plan was observed healthy. When a release
became healthy first is seen here alone: Argo CD says since when it is healthy now.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.updates.cluster_health import HEALTHY, ClusterHealth
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.forge.ports.repositories import NoteTexts

ANSWERS_MAX = 1000

log = logging.getLogger(__name__)


class FirstRuns:
    """What is known of first runs; `notes` of the deployment repository (None: nothing but what was seen here)."""

    def __init__(self, notes: NoteTexts | None) -> None:
        self._notes = notes
        self._seen: dict[tuple[str, str], int] = {}
        self._noted: dict[tuple[str, str, int], bool] = {}

    def note(self, releases: Iterable[Release], succeeded: Collection[str], now_ns: int) -> None:
        """Note the releases of main that have succeeded with their version (`succeeded`, keys); others are dropped when
        they have gone or got another version."""
        if not succeeded and not self._seen:
            return
        present = {(release.key, release.digest) for release in releases}
        seen = {one: self._seen.get(one, now_ns) for one in present if one[0] in succeeded or one in self._seen}
        self._seen = seen

    def ran_before(self, release: Release, commit: str, before_ns: int) -> bool:
        """Return whether the release was healthy with its version before a time; `commit` updated it. True also while
        the forge does not say: what may have run is not taken back."""
        seen = self._seen.get((release.key, release.digest))
        if seen is not None and seen < before_ns:
            return True
        question = release.key, commit, before_ns
        if question not in self._noted:
            try:
                answer = bool(commit) and self._is_noted(*question)
            except (UnavailableError, InputError) as error:
                log.warning("outcome of an update not read commit=%s problem=%r", commit[:12], str(error))
                return True
            if len(self._noted) >= ANSWERS_MAX:
                self._noted.clear()
            self._noted[question] = answer
        return self._noted[question]

    def _is_noted(self, key: str, commit: str, before_ns: int) -> bool:
        text = self._notes.texts([commit]).get(commit) if self._notes is not None else None
        outcome = _outcome(text) if text else {}
        observed = outcome.get("observed")
        keys = [one.get("release") for one in outcome.get("releases", ()) if isinstance(one, Mapping)]
        return type(observed) is int and observed < before_ns and key in keys


class FirstHealthy:
    """The times at which releases were first healthy as main has them, on agents that were not away since."""

    def __init__(self) -> None:
        self._first: dict[tuple[str, str, int], int] = {}

    def note(self, releases: Iterable[Release], cluster: ClusterHealth, now_ns: int) -> ClusterHealth:
        """The health of all releases with when each was healthy first; those that have gone are dropped."""
        first: dict[tuple[str, str, int], int] = {}
        health = dict(cluster.health)
        for release in releases:
            one = health.get(release.key)
            place = release.key, release.plan, cluster.online.get(release.namespace, 0)
            since = self._first.get(place)
            if since is None and one is not None and one.state == HEALTHY:
                since = now_ns if one.since_ns is None else one.since_ns
            if since is not None and one is not None:
                first[place] = since
                health[release.key] = replace(one, first_ns=since)
        self._first = first
        return replace(cluster, health=health)


def _outcome(text: str) -> Mapping[str, Any]:
    """The outcome in a note; empty when it is none."""
    try:
        document = read_json(text)
    except ValueError:
        return {}
    return document if isinstance(document, Mapping) else {}
