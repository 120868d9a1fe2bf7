"""Loops of links: which repetitions of a link and which instances of the services at its ends belong together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

from robotkube.foundation.documents.core.value_templates import Render, expand_for_each
from robotkube.registry.catalogue.core.applications import Link, Service


def joined(*loops: Mapping[str, Any]) -> dict[str, Any] | None:
    """The variables of all loops together; None when two have different values of one variable."""
    together: dict[str, Any] = {}
    for loop in loops:
        if any(together.setdefault(variable, value) != value for variable, value in loop.items()):
            return None
    return together


def loops_of(for_each: Mapping[str, Any], names: Mapping[str, Any], render: Render) -> list[dict[str, Any]]:
    """The variables of a `forEach`, once per element of its list; nothing, once, without one."""
    return [{name: scope[name] for name in for_each} for scope in expand_for_each(for_each, names, render)]


def repetitions(
    link: Link, services: Sequence[Service], names: Mapping[str, Any], render: Render
) -> Iterator[dict[str, Any]]:
    """The variables of every repetition of a link: of its own `forEach`, or without one of those of the services at its
    ends, where they agree."""
    ends = [one for end in (link.source, link.target) for one in services if one.name == end.get("service")]
    parts = [link.for_each] if link.for_each else [service.for_each for service in ends]
    for loops in product(*(loops_of(for_each, names, render) for for_each in parts)):
        loop = joined(*loops)
        if loop is not None:
            yield loop


def link_variables(link: Link, services: Sequence[Service]) -> frozenset[str]:
    """The variables that a link's templates may use: its own, or without any those of the services at its ends."""
    ends = {link.source.get("service"), link.target.get("service")}
    return frozenset(
        link.for_each or {variable for service in services if service.name in ends for variable in service.for_each}
    )
