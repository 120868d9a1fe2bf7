"""Values that composition is given and that it answers: demands and inputs, releases and outcomes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.broken_links import BridgedLink
from robotkube.delivery.manager.core.placement.placement import Fleet, Narrowing
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.catalogue import Catalogue, Pin
from robotkube.registry.catalogue.core.guarantees import GuaranteeRequirement
from robotkube.registry.charts.core.values_schemas import Validate

Schema = Callable[[str, str], Mapping[str, Any] | None]
"""The values schema of (chart, version); None when the catalogue has none."""


@dataclass(frozen=True)
class Demand:
    """One reason for an application to run: a task, or the initial configuration of one agent. `roles`: those that
    stand in for the roles of the application's rules (a task that is offloaded). `sent`: no application, but a topic
    that the agent is to send, since an agent of another scope hears it."""

    key: str
    application: str
    parameters: Mapping[str, Any]
    agent: str = ""
    task: TaskDescription | None = None
    roles: tuple[str, ...] = ()
    sent: Mapping[str, Any] = field(default_factory=dict)

    @property
    def requirements(self) -> tuple[GuaranteeRequirement, ...]:
        """Guarantees that the task asks for, beside those of the application."""
        return self.task.requirements if self.task else ()

    @property
    def provides(self) -> str:
        """The capability that the task asks for when it names no application."""
        return self.task.provides if self.task else ""

    @property
    def narrowing(self) -> Narrowing:
        """The bounds that the task sets to the places of its services."""
        if self.task is None:
            return Narrowing(instead=self.roles)
        asked = self.task.placement
        return Narrowing(asked.agents, asked.roles, asked.capabilities, self.roles)

    @cached_property
    def keeps_away(self) -> frozenset[str]:
        """Words (tasks, releases) that must not be on the same agent: `<name>` is a release, or a task beside it."""
        if self.task is None:
            return frozenset()
        words = self.task.placement.anti_affinity
        return frozenset([*words, *(f"{self.task.namespace}/{word}" for word in words if "/" not in word)])

    @cached_property
    def shared_key(self) -> str:
        """Equal for demands that one set of releases answers."""
        asked = self.task.placement if self.task else None
        parameters = sorted(self.parameters.items(), key=lambda item: item[0])
        sent = sorted(self.sent.items())
        own = (self.application, self.provides, self.requirements, asked, self.agent, self.roles)
        return repr((*own, parameters, sent))


@dataclass(frozen=True)
class Refused:
    """Why a demand is not met: a reason of the closed list, and the sentence for people."""

    reason: str
    message: str


@dataclass(frozen=True)
class Met:
    """The way in which a demand is met: the releases (`<namespace>/<name>`), every choice as a sentence, and the
    application (chosen by what it provides when the task names none). `runs`: its services' releases, each with the
    chart version that was chosen and the Node, where an agent has several. `links` are the topics that its links need
    bridges to carry."""

    releases: tuple[str, ...]
    choices: tuple[str, ...]
    application: str = ""
    runs: tuple[str, ...] = ()
    links: tuple[BridgedLink, ...] = ()


@dataclass(frozen=True)
class Composition:
    """What should exist: releases by path, an outcome per demand key, the paths the initial configuration uses."""

    releases: Mapping[str, Release]
    outcomes: Mapping[str, Met | Refused]
    initial: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Inputs:
    """Everything that composition depends on beside the demands.

    `present` are main's releases (by path) that this manager answers for, `others` those that it does not: they are
    never composed, but what they ask for is counted. `pins`: release key -> the chart version that it keeps as long as
    requirement and policy allow it; `withheld`: chart versions that nothing uses unless it is pinned to them, with
    why. `schema` gives the values schemas that composed values are checked by; None: values are not checked."""

    catalogue: Catalogue
    fleet: Fleet
    present: Mapping[str, Release]
    render: Render
    validate: Validate
    others: Mapping[str, Release] = field(default_factory=dict)
    pins: Mapping[str, Pin] = field(default_factory=dict)
    withheld: Mapping[Pin, str] = field(default_factory=dict)
    schema: Schema | None = None
