"""Rights that Helm needs for the chart, from its rendering, and which of them the account lacks.

Helm reads each object, creates it, patches it at upgrades and deletes it at the end; it deletes and watches the Jobs of
hooks, and keeps each revision in a Secret. Who makes a Role must have every right in it, or the verbs `escalate` and
`bind` on Roles: the API server lets nobody give what they do not have.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem, named
from robotkube.delivery.preflight.core.renderings import (
    HOOK,
    Object,
    RenderedChart,
    annotations_of,
    group_of,
    plural,
)
from robotkube.foundation.kubernetes.core.access_rights import ApiRight
from robotkube.registry.suites.core.pod_security import items

RBAC = "rbac.authorization.k8s.io"
OBJECT_VERBS = ("get", "create", "patch", "delete")
HOOK_VERBS = ("get", "list", "watch", "create", "delete")
RELEASE_VERBS = ("get", "list", "create", "update", "delete")
GIVING_VERBS = ("escalate", "bind")
ROLES = {"Role": "roles", "ClusterRole": "clusterroles"}
EVERYTHING = ApiRight("*", "*", "*")


@dataclass(frozen=True)
class NeededRights:
    """What Helm does itself, and the rights that the chart's Roles give; by the namespace and the kind of the Roles."""

    own: frozenset[ApiRight]
    given: Mapping[tuple[str, str], frozenset[ApiRight]]

    @property
    def all(self) -> frozenset[ApiRight]:
        """All of them, with those by which somebody may give what they do not have."""
        giving = (right for place in self.given for right in giving_rights(*place))
        return self.own.union(giving, *self.given.values())


@dataclass(frozen=True)
class Reviewed:
    """Which of the needed rights the account has not."""

    needed: NeededRights
    missing: frozenset[ApiRight]


def needed_rights(rendering: RenderedChart) -> NeededRights:
    """The rights that installing, upgrading and uninstalling the chart takes."""
    own = {right for item in rendering.objects for right in _on(item, rendering)}
    own |= {ApiRight(verb, "", "secrets", rendering.namespace) for verb in RELEASE_VERBS}
    given: defaultdict[tuple[str, str], set[ApiRight]] = defaultdict(set)
    for item in rendering.of_kind(*ROLES):
        namespace = rendering.namespace_of(item)
        given[str(item.get("kind")), namespace].update(_given(item, namespace))
    return NeededRights(frozenset(own), {place: frozenset(rights) for place, rights in given.items()})


def giving_rights(kind: str, namespace: str) -> tuple[ApiRight, ...]:
    """The rights by which somebody may make Roles of a kind with rights that they do not have."""
    return tuple(ApiRight(verb, RBAC, ROLES[kind], namespace) for verb in GIVING_VERBS)


def rights(reviewed: Reviewed) -> CheckVerdict:
    """The account may do everything that Helm does with the chart."""
    needed, missing = reviewed.needed, reviewed.missing
    problems = [
        *_problems(needed.own & missing, _own),
        *_problems(frozenset().union(*_not_givable(needed, missing)), _giving),
    ]
    return CheckVerdict(f"{len(needed.all)} rights were asked for", problems)


def _not_givable(needed: NeededRights, missing: frozenset[ApiRight]) -> Iterator[frozenset[ApiRight]]:
    for place, given in needed.given.items():
        if missing & set(giving_rights(*place)):
            yield given & missing


def _on(item: Object, rendering: RenderedChart) -> Iterator[ApiRight]:
    verbs = HOOK_VERBS if annotations_of(item).get(HOOK) else OBJECT_VERBS
    group = group_of(item)
    resource = plural(str(item.get("kind")))
    namespace = rendering.namespace_of(item)
    return (ApiRight(verb, group, resource, namespace) for verb in verbs)


def _given(role: Object, namespace: str) -> Iterator[ApiRight]:
    for rule in items(role.get("rules")):
        for group in rule.get("apiGroups") or ():
            for resource in rule.get("resources") or ():
                for verb in rule.get("verbs") or ():
                    for name in rule.get("resourceNames") or ("",):
                        yield ApiRight(str(verb), str(group), str(resource), namespace, str(name))


Words = Callable[[str, str, Sequence[str]], Problem]


def _problems(missing: frozenset[ApiRight], words: Words) -> Iterator[Problem]:
    """A problem for each kind of objects and set of verbs, with the namespaces where they are missing."""
    verbs: defaultdict[tuple[str, str], set[str]] = defaultdict(set)
    for right in missing:
        verbs[right.kind, right.namespace].add(right.verb)
    places: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for (kind, namespace), lacking in sorted(verbs.items()):
        places[kind, ", ".join(sorted(lacking))].append(namespace)
    for (kind, missing_verbs), namespaces in places.items():
        yield words(kind, missing_verbs, [one for one in namespaces if one])


def _own(kind: str, verbs: str, namespaces: Sequence[str]) -> Problem:
    why = "Helm makes, changes and removes such objects with the rights of this account, and stops half way without"
    return Problem(f"may not {verbs} {kind}", _where(namespaces), why, _fix(kind, verbs, namespaces))


def _giving(kind: str, verbs: str, namespaces: Sequence[str]) -> Problem:
    why = "the chart's Roles give these rights, and nobody may give what they do not have"
    fix = f"{_fix(kind, verbs, namespaces)}; or the verbs {' and '.join(GIVING_VERBS)} on the Roles"
    return Problem(f"may not give {verbs} of {kind}", _where(namespaces), why, fix)


def _where(namespaces: Sequence[str]) -> str:
    return f"namespaces {named(namespaces)}" if namespaces else "the whole cluster"


def _fix(kind: str, verbs: str, namespaces: Sequence[str]) -> str:
    role = "a Role and RoleBinding there" if namespaces else "a ClusterRole and ClusterRoleBinding"
    return f"have an administrator give this account {verbs} on {kind} ({role}), or install as one"
