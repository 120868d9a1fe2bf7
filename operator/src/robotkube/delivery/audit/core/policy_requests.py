"""Who asked for what no task asks for: the entry of a policy, the commit that made it so, and who proposed and approved
that commit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robotkube.delivery.audit.core.merge_checks import Merges
from robotkube.delivery.audit.core.policy_entries import PolicyEntry, asking, initial_entries, offered_entries
from robotkube.delivery.audit.core.report import Row, seconds_text
from robotkube.delivery.deployment.core.releases import Release
from robotkube.foundation.forge.core.histories import HistoryCommit
from robotkube.foundation.forge.core.trailers import APPROVED_BY, PULL_REQUEST, read_trailers
from robotkube.registry.catalogue.core.catalogue import Catalogue

PUBLICATION = "publish: "


class PolicyRequests:
    """The entries of both repositories, by the commits of their mains. `decided_by`: commit of the deployment
    repository -> that of the catalogue by which the gate decided; `catalogue`: what the catalogue offered then."""

    def __init__(
        self,
        deployment: Sequence[HistoryCommit],
        offered: Sequence[HistoryCommit],
        merges: Merges,
        decided_by: Callable[[HistoryCommit], str],
        catalogue: Callable[[str], Catalogue],
    ) -> None:
        self._places = {commit.id: place for place, commit in enumerate(deployment)}
        self._offered_places = {commit.id: place for place, commit in enumerate(offered)}
        self._commits = deployment
        self._initial = initial_entries(deployment)
        self._offered = offered_entries(offered)
        self._merges = merges
        self._decided_by = decided_by
        self._catalogue = catalogue

    def rows(self, release: Release, commit: str, gone: bool = False) -> list[Row]:
        """Because of which entries a release stood on main since a commit, or went with it; none for one that tasks
        ask for."""
        if release.causes or commit not in self._places:
            return []
        place = self._places[commit]
        decided_by = self._decided_by(self._commits[place])
        entries = [*self._initial.at(place), *self._offered.at(self._offered_places.get(decided_by, -1))]
        asking_entries = asking(release.chart, gone, entries, self._catalogue(decided_by), self._offered.applications)
        return [self._row(entry) for entry in sorted(asking_entries, key=lambda one: (one.place, one.says))]

    def _row(self, entry: PolicyEntry) -> Row:
        return {
            "application": entry.application,
            "entry": entry.says,
            "stands": entry.stands,
            "repository": entry.place,
            "path": entry.path,
            "commit": entry.commit.id,
            **(self._deployed(entry.commit) if entry.place == "deployment" else proposed(entry.commit)),
        }

    def _deployed(self, commit: HistoryCommit) -> Row:
        """Who changed the deployment repository, by the gate's record; without one its author alone, who is not
        proved."""
        record = self._merges.records.get(commit.id)
        if record is None:
            return {**proposed(commit), "author": commit.author, "approved_by": [], "pull_request": ""}
        return {
            "time": record.time,
            "author": record.author,
            "approved_by": list(record.approvals),
            "pull_request": record.pull_request,
            "key": record.key,
        }


def proposed(commit: HistoryCommit) -> Row:
    """Who changed the catalogue, by the words of the commit, which nobody signed. Who submitted what an older gate
    published is not known."""
    trailers = read_trailers(commit.message)
    numbers = trailers.get(PULL_REQUEST, ())
    older = commit.message.startswith(PUBLICATION) and not numbers
    return {
        "time": seconds_text(commit.committed),
        "author": "" if older else commit.author,
        "approved_by": list(trailers.get(APPROVED_BY, ())),
        "pull_request": "".join(numbers[:1]),
        "key": None,
    }
