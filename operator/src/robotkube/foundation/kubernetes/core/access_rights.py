"""Rights at the API server as values: one verb on one kind of objects, and the rules that RBAC gives to somebody."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

ANY = "*"


@dataclass(frozen=True, order=True)
class ApiRight:
    """One verb on one kind of objects; without a namespace in the whole cluster, with a `name` on that object alone."""

    verb: str
    group: str
    resource: str
    namespace: str = ""
    name: str = ""

    def __str__(self) -> str:
        """The right as people say it."""
        return f"{self.verb} {self.kind} {f'in namespace {self.namespace}' if self.namespace else 'in the cluster'}"

    @property
    def kind(self) -> str:
        """What it is about, as people say it."""
        what = f"{self.resource}.{self.group}" if self.group else self.resource
        return f"{what} {self.name}" if self.name else what

    @property
    def attributes(self) -> dict[str, str]:
        """The `resourceAttributes` of an access review."""
        resource, _, subresource = self.resource.partition("/")
        named = {"verb": self.verb, "group": self.group, "resource": resource, "subresource": subresource}
        return {**named, "namespace": self.namespace, **({"name": self.name} if self.name else {})}


def covers(rules: Sequence[Mapping[str, Any]], right: ApiRight) -> bool:
    """Return whether one of these rules gives the right. They have the form of RBAC's, and count where they were asked
    for."""
    return any(_covers(rule, right) for rule in rules)


def _covers(rule: Mapping[str, Any], right: ApiRight) -> bool:
    names = rule.get("resourceNames") or ()
    _, _, subresource = right.resource.partition("/")
    resources = {ANY, right.resource, *([f"{ANY}/{subresource}"] if subresource else [])}
    return (
        bool({ANY, right.verb} & set(rule.get("verbs") or ()))
        and bool({ANY, right.group} & set(rule.get("apiGroups") or ()))
        and bool(resources & set(rule.get("resources") or ()))
        and (not names or right.name in names)
    )
