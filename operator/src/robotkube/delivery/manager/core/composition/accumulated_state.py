"""Accumulated state of one composition: what the demands that are met so far ask for, together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from robotkube.delivery.deployment.core.releases import Release, TaskCause
from robotkube.delivery.manager.core.broken_links import BridgedLink
from robotkube.delivery.manager.core.composition.assignments import Assignments
from robotkube.delivery.manager.core.composition.expansion import Expansion
from robotkube.delivery.manager.core.composition.index import Index
from robotkube.delivery.manager.core.composition.inputs import Demand, Met, Refused
from robotkube.delivery.manager.core.composition.publishers import Publishers, described
from robotkube.delivery.manager.core.composition.topic_merge import End, MergedTopics
from robotkube.delivery.manager.core.placement.reasons import shown
from robotkube.delivery.tasks.core.task_description import INSUFFICIENT_RESOURCES, RELEASE_IN_USE, TOPIC_TAKEN
from robotkube.errors import RefusalError
from robotkube.robots.bridge.core.rights import IN, OUT

Merge = Callable[[Release, Release, Sequence[str]], Release | None]
"""As release_merge.merged_release."""


@dataclass(frozen=True, eq=False)
class Contribution:
    """What a demand that is met adds: its expansion; `shares` names the earlier equal demand whose expansion it is."""

    demand: Demand
    expansion: Expansion
    shares: str = ""

    @cached_property
    def cause(self) -> TaskCause | None:
        """The task's cause under the application that answers it; None for the initial configuration."""
        if self.demand.task is None or not self.shares:
            return self.expansion.cause
        return replace(self.demand.task.cause, application=self.expansion.application)

    @cached_property
    def ends(self) -> tuple[End, ...]:
        """The bridges that carry its topics."""
        return tuple(self.expansion.topics.ends)

    @property
    def choices(self) -> tuple[str, ...]:
        """Every choice, as a sentence."""
        return (f"shares the releases of {self.shares}",) if self.shares else self.expansion.choices


class AccumulatedState:
    """All demands so far: `outcomes` by demand key, `first` of equal demands by their shared key, `releases` and whose
    `contributions` they are by release key, `topics` and whose they are (`bridged`) by bridge, who
    `published` a topic on a place.

    A copy is cheap: values are never changed in place."""

    def __init__(self, assignments: Assignments) -> None:
        self.assignments = assignments
        self.outcomes: dict[str, Contribution | Refused] = {}
        self.first: dict[str, Contribution] = {}
        self.releases: dict[str, Release] = {}
        self.contributions: dict[str, tuple[Contribution, ...]] = {}
        self.topics = MergedTopics()
        self.bridged: dict[End, tuple[Contribution, ...]] = {}
        self.published: Publishers = {}

    def copy(self) -> AccumulatedState:
        """A state that can grow without changing this one."""
        copied = AccumulatedState(self.assignments.copy())
        copied.outcomes = dict(self.outcomes)
        copied.first = dict(self.first)
        copied.releases = dict(self.releases)
        copied.contributions = dict(self.contributions)
        copied.topics = self.topics.copy()
        copied.bridged = dict(self.bridged)
        copied.published = dict(self.published)
        return copied

    def add(self, contribution: Contribution, index: Index, merge: Merge) -> None:
        """Add a contribution, or raise RefusalError and leave everything but the assignments as it was."""
        expansion = contribution.expansion
        releases = {key: self._merged(key, one, expansion, merge) for key, one in expansion.releases.items()}
        if not contribution.shares:
            self._check_publishers(expansion)
            self._reserve_bridges(expansion, index)
        self.topics.merge(expansion.topics, self._whose_topic)
        self.published.update(expansion.published)
        self.releases.update(releases)
        for key in releases:
            self.contributions[key] = (*self.contributions.get(key, ()), contribution)
        for end in expansion.topics.ends:
            self.bridged[end] = (*self.bridged.get(end, ()), contribution)
        self.first.setdefault(contribution.demand.shared_key, contribution)

    def _merged(self, key: str, release: Release, expansion: Expansion, merge: Merge) -> Release:
        """The release for all demands so far: the same for all, or merged where the application allows it."""
        present = self.releases.get(key)
        if present is None or present is release or present == release:
            return release if present is None else present
        merged = merge(present, release, expansion.merged_lists[key])
        if merged is None:
            names = whose(self.contributions[key])
            differing = ", ".join(_differing(present.values, release.values, "values")) or "another chart or version"
            raise RefusalError(
                RELEASE_IN_USE,
                f"release {key} is made {names} with other content ({differing}); withdraw that, or let the "
                "application give the release a name with a parameter in it",
            )
        return merged

    def _check_publishers(self, expansion: Expansion) -> None:
        """RefusalError(TopicTaken) when another demand publishes one of the topics on the same place."""
        for (place, topic), publisher in expansion.published.items():
            present = self.published.get((place, topic), publisher)
            if present != publisher:
                raise RefusalError(
                    TOPIC_TAKEN,
                    f"{described(publisher)} of application {expansion.application} would publish topic {topic} on "
                    f"{place}, where {described(present)} publishes it {whose(self._publishing(place, topic))}: who "
                    "subscribes would get both mixed; withdraw that, let the application publish under another name "
                    "(a parameter in it), or place this one on another agent",
                )

    def _publishing(self, place: str, topic: str) -> Sequence[Contribution]:
        """Whose the publisher of a topic on a place is."""
        publisher = self.published[place, topic]
        of_publisher = self.contributions[publisher] if isinstance(publisher, str) else self.bridged[publisher]
        return [one for one in of_publisher if (place, topic) in one.expansion.published]

    def _whose_topic(self, end: End, topic: str) -> str:
        """The words for who asked for a topic of a bridge."""
        asked = [
            one
            for one in self.bridged[end]
            if any(topic in one.expansion.topics.names(end, direction) for direction in (IN, OUT))
        ]
        return f"{whose(asked)}, which can be withdrawn"

    def _reserve_bridges(self, expansion: Expansion, index: Index) -> None:
        """Reserve the bridges that nobody asked for yet; those that run already keep their place though it is full."""
        occupancy = self.assignments.occupancy
        for end in expansion.topics.ends:
            if end in self.bridged:
                continue
            kind, place = end
            need = index.bridge_need(kind)
            capacity = index.fleet.capacities.get(place)
            chart = index.bridge(kind)[1][0].chart
            if capacity and not occupancy.fits(place, capacity, need) and not index.runs(place, chart):
                shortage = occupancy.shortage(place, capacity, need)
                agent = index.fleet.at[place]
                text = f"{agent} has no room for its bridge ({shortage}); withdraw something that runs there"
                raise RefusalError(INSUFFICIENT_RESOURCES, text)
            occupancy.reserve(place, need, releases=0)


def whose(contributions: Sequence[Contribution]) -> str:
    """The demands in words, the first few of them: `for task ops/t (application a)`."""
    demands = [
        f"{'task ' if contribution.demand.task else ''}{contribution.demand.key} "
        f"(application {contribution.expansion.application})"
        for contribution in contributions
    ]
    return f"for {shown(demands)}"


def release_keys(expansion: Expansion, bridges: Mapping[End, str]) -> set[str]:
    """The keys of everything that an expansion uses; `bridges` are the keys of bridges."""
    return {*expansion.releases, *(bridges[end] for end in expansion.topics.ends)}


def met(contribution: Contribution, bridges: Mapping[End, str]) -> Met:
    """How a contribution's demand is met."""
    expansion = contribution.expansion
    keys = tuple(sorted(release_keys(expansion, bridges)))
    runs = tuple(sorted(map(_runs, expansion.releases.values())))
    links = tuple(sorted(_links(expansion, bridges)))
    return Met(keys, contribution.choices, expansion.application, runs, links)


def _links(expansion: Expansion, bridges: Mapping[End, str]) -> Iterator[BridgedLink]:
    for end in expansion.topics.ends:
        for direction, topics in expansion.topics.at(*end).items():
            for topic in topics:
                yield bridges[end], direction, str(topic["name"])


def _runs(release: Release) -> str:
    node = release.values["placement"].get("node")
    return f"{release.key}: {release.chart} {release.version}{f' on Node {node}' if node else ''}"


def caused(release: Release, contributions: Sequence[Contribution], present: Release | None) -> Release:
    """The release with the causes of all who contribute to it; as main has it (`present`), its plan included, when
    nothing else differs."""
    written = replace(
        release, causes=tuple(sorted({contribution.cause for contribution in contributions if contribution.cause}))
    )
    return present if present is not None and present.same_but_plan(written) else written


def _differing(one: Any, two: Any, path: str) -> Iterator[str]:
    """Paths of the values that differ."""
    if isinstance(one, Mapping) and isinstance(two, Mapping):
        for key in dict.fromkeys((*one, *two)):
            yield from _differing(one.get(key), two.get(key), f"{path}.{key}")
    elif one != two:
        yield path
