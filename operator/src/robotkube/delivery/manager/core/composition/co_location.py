"""Groups of instances of an application's services that share a node: those that links of kind ros connect.

DDS does not cross nodes. Two instances belong together when a ros link joins their services and they have the same
values of the `forEach` variables that both have: with the same `forEach` at both ends each pair has its own node.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.value_templates import Render, expand_for_each
from robotkube.registry.catalogue.core.applications import Application, Link, Service
from robotkube.registry.catalogue.core.links.loops import joined


@dataclass(frozen=True)
class Instance:
    """A service for one element of its `forEach`; `scope` are the names its templates may use."""

    service: Service
    scope: dict[str, Any]

    @property
    def loop(self) -> dict[str, Any]:
        """The values of its `forEach` variables."""
        return {variable: self.scope[variable] for variable in self.service.for_each}


def instances(application: Application, names: Mapping[str, Any], render: Render) -> list[Instance]:
    """Every instance, in the order of the services and of their lists."""
    services = application.services
    return [
        Instance(service, scope) for service in services for scope in expand_for_each(service.for_each, names, render)
    ]


def groups(every: Sequence[Instance], links: Sequence[Link]) -> list[list[int]]:
    """Per instance the indices of all instances that share its node, itself among them, in order."""
    group = list(range(len(every)))
    for first, second in _joined(every, links):
        old, new = sorted((group[first], group[second]), reverse=True)
        group = [new if number == old else number for number in group]
    return [[index for index, number in enumerate(group) if number == mine] for mine in group]


def _joined(every: Sequence[Instance], links: Sequence[Link]) -> Iterator[tuple[int, int]]:
    for link in links:
        if link.kind != "ros":
            continue
        ends = [
            [i for i, x in enumerate(every) if x.service.name == end["service"]] for end in (link.source, link.target)
        ]
        yield from ((a, b) for a in ends[0] for b in ends[1] if joined(every[a].loop, every[b].loop) is not None)
