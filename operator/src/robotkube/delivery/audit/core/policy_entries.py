"""What no task asks for: entries of policies/initial.yaml and applications with `initialFor`, each with the commit that
made it as it stands, or took it away."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from robotkube.delivery.audit.core.findings import Place
from robotkube.delivery.deployment.core.policies.initial import PATH, InitialPolicy, read_initial_policy
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.forge.core.histories import HistoryCommit
from robotkube.registry.catalogue.core.applications import Application, ChartRequirement, read_application
from robotkube.registry.catalogue.core.catalogue import Catalogue

APPLICATIONS = "applications/"

Key = tuple[str, ...]


@dataclass(frozen=True)
class PolicyEntry:
    """An entry that asks for an application, or keeps it from agents (`keeps`). `says` is the entry in words; `commit`
    is the one that made it as it is, or, when it does not stand any more, the one that took it away. `detail` is what
    else of it counts as a change."""

    application: str
    says: str
    place: Place
    path: str
    commit: HistoryCommit
    detail: str = ""
    keeps: bool = False
    stands: bool = True


_State = Mapping[Key, PolicyEntry]


@dataclass(frozen=True)
class PolicyHistory:
    """The entries of one repository after each commit that changed them; `applications` as they were read last."""

    places: tuple[int, ...] = ()
    states: tuple[_State, ...] = ()
    applications: Mapping[str, Application] = field(default_factory=dict)

    def at(self, place: int) -> Sequence[PolicyEntry]:
        """The entries after the commit that stands at a place of main, those that are gone among them."""
        number = bisect_right(self.places, place)
        return tuple(self.states[number - 1].values()) if number else ()


def initial_entries(commits: Sequence[HistoryCommit]) -> PolicyHistory:
    """The entries of policies/initial.yaml, by the commits of the deployment repository, oldest first. A file that
    cannot be read changes nothing."""
    states: dict[int, _State] = {}
    state: _State = {}
    for place, commit in enumerate(commits):
        if PATH not in commit.changes:
            continue
        try:
            policy = read_initial_policy(commit.changes[PATH] or "{}")
        except DocumentError:
            continue
        state = states[place] = _after(state, dict(_initial(policy, commit)), commit)
    return PolicyHistory(tuple(states), tuple(states.values()))


def offered_entries(commits: Sequence[HistoryCommit]) -> PolicyHistory:
    """The applications that run by themselves, by the commits of the catalogue, oldest first."""
    states: dict[int, _State] = {}
    state: _State = {}
    standing: dict[Key, PolicyEntry] = {}
    known: dict[str, Application] = {}
    for place, commit in enumerate(commits):
        changed = [path for path in commit.changes if path.startswith(APPLICATIONS) and path.endswith(".yaml")]
        for path in changed:
            standing.pop((path,), None)
            application = _application(commit.changes[path], path)
            if application:
                known[application.name] = application
                if application.initial_for:
                    standing[path,] = _offered(application, path, commit)
        if changed:
            state = states[place] = _after(state, standing, commit)
    return PolicyHistory(tuple(states), tuple(states.values()), known)


def asking(
    chart: str, gone: bool, entries: Iterable[PolicyEntry], catalogue: Catalogue, known: Mapping[str, Application]
) -> Iterator[PolicyEntry]:
    """Of `entries` those because of which a release of `chart` came, or went, without a task: they are of an
    application that has the chart. `known` are applications that `catalogue` may not have any more."""
    for entry in entries:
        application = catalogue.applications.get(entry.application) or known.get(entry.application)
        asks = entry.stands != entry.keeps
        if application and asks != gone and chart in charts_of(application, catalogue, known):
            yield entry


def charts_of(application: Application, catalogue: Catalogue, known: Mapping[str, Application]) -> frozenset[str]:
    """The charts that an application can lead to: of its services, and of the bridges of its links."""
    others = {**known, **catalogue.applications}.values()
    kinds = {link.kind for link in application.links}
    bridges = [one for one in others if kinds.intersection(one.bridges)]
    services = [service for one in (application, *bridges) for service in one.services]
    return frozenset(chart for service in services for chart in _charts(service.chart, catalogue))


def _charts(requirement: ChartRequirement, catalogue: Catalogue) -> Iterator[str]:
    if requirement.name:
        yield requirement.name
    else:
        yield from (version.chart for version in catalogue.candidates(requirement))


def _initial(policy: InitialPolicy, commit: HistoryCommit) -> Iterator[tuple[Key, PolicyEntry]]:
    for add in policy.add:
        whom = f"every agent of role {add.role}" if add.role else ", ".join(add.agents)
        detail = canonical_json(add.parameters).decode()
        says = f"{add.application} on {whom}"
        entry = PolicyEntry(add.application, says, "deployment", PATH, commit, detail)
        yield ("add", add.application, add.role, *add.agents), entry
    for removal in policy.remove:
        says = f"no {removal.application} on {', '.join(removal.agents)}"
        entry = PolicyEntry(removal.application, says, "deployment", PATH, commit, keeps=True)
        yield ("remove", removal.application, *removal.agents), entry


def _offered(application: Application, path: str, commit: HistoryCommit) -> PolicyEntry:
    says = f"{application.name} on every agent of role {application.initial_for} (initialFor)"
    return PolicyEntry(application.name, says, "catalogue", path, commit, application.digest)


def _after(before: Mapping[Key, PolicyEntry], now: Mapping[Key, PolicyEntry], commit: HistoryCommit) -> _State:
    """The entries after a commit that has `now`: as they were, made anew by it, or gone by it."""
    gone = {
        key: replace(entry, stands=False, commit=commit) if entry.stands else entry
        for key, entry in before.items()
        if key not in now
    }
    return {**gone, **{key: before[key] if _same(before.get(key), entry) else entry for key, entry in now.items()}}


def _same(before: PolicyEntry | None, now: PolicyEntry) -> bool:
    return before is not None and before.stands and before.detail == now.detail and before.says == now.says


def _application(text: str | None, path: str) -> Application | None:
    """The application in a file; None when it is gone or cannot be read."""
    try:
        return read_application(text, path) if text is not None else None
    except DocumentError:
        return None
