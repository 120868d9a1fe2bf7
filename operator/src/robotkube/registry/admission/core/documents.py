"""A ValidatingAdmissionPolicy with its binding, as documents."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

API = "admissionregistration.k8s.io/v1"
Resources = Sequence[tuple[str, Sequence[str]]]
"""API group and its resources."""
CHARACTERS_MAX = 100_000  # of one expression (cel-go)
REFUSING = "something-to-refuse"


@dataclass(frozen=True)
class Validation:
    """What must hold, and the expression of the sentence that says what, why and what to do when it does not."""

    holds: str
    says: str


@dataclass(frozen=True)
class Place:
    """The namespaces of these names, or (`others`) all but these. By a label that the API server keeps equal to the
    name: a namespace that does not match costs nothing, where an expression would have to be evaluated."""

    names: Sequence[str]
    others: bool = False

    @property
    def selector(self) -> dict[str, Any]:
        """The choice as a namespaceSelector."""
        operator = "NotIn" if self.others else "In"
        expression = {"key": "kubernetes.io/metadata.name", "operator": operator, "values": list(self.names)}
        return {"matchExpressions": [expression]}


@dataclass(frozen=True)
class Policy:
    """One policy: it judges creations and updates of `resources` in a `place` (None: everywhere). Whatever cannot be
    judged is refused. `parameters`: the ConfigMap that its lookups ask; empty when they ask none."""

    name: str
    resources: Resources
    place: Place | None
    variables: Sequence[Mapping[str, str]]
    validations: Sequence[Validation]
    parameters: str = ""

    def documents(self, suffix: str, namespace: str) -> Iterator[dict[str, Any]]:
        """The policy and its binding; `suffix` of both names, `namespace` of the ConfigMap `parameters`."""
        name = f"{self.name}{suffix}"
        constraints: dict[str, Any] = {"resourceRules": [self._rule(*entry) for entry in self.resources]}
        if self.place is not None:
            constraints["namespaceSelector"] = self.place.selector
        policy: dict[str, Any] = {
            "failurePolicy": "Fail",
            "matchConstraints": constraints,
            **self._conditions(),
            "variables": [dict(variable) for variable in self.variables],
            "validations": [
                {
                    "expression": validation.holds,
                    "messageExpression": validation.says,
                    "message": f"refused by {self.name}; see docs/reference/admission.md",
                }
                for validation in self.validations
            ],
        }
        binding: dict[str, Any] = {"policyName": name, "validationActions": ["Deny"]}
        if self.parameters:
            policy["paramKind"] = {"apiVersion": "v1", "kind": "ConfigMap"}
            place = {"name": self.parameters, "namespace": namespace}
            binding["paramRef"] = {**place, "parameterNotFoundAction": "Deny"}
        yield _document("ValidatingAdmissionPolicy", name, policy)
        yield _document("ValidatingAdmissionPolicyBinding", name, binding)

    def _conditions(self) -> dict[str, Any]:
        """The same rules, asked before: what they all let through ends there. The API server composes the sentences
        of all validations whether they are needed or not, with all variables again, which takes longer than judging.
        Rules whose list is too long for one expression are asked once, with their sentences."""
        refusing = f"!({self._all_hold()})"
        if len(refusing) > CHARACTERS_MAX:
            return {}
        return {"matchConditions": [{"name": REFUSING, "expression": refusing}]}

    def _all_hold(self) -> str:
        """All validations as one expression. A condition may not use variables: one that is asked for once stands
        where it is asked for, others are bound by a list of them alone."""
        whole = " && ".join(f"({validation.holds})" for validation in self.validations)
        for variable in reversed(self.variables):
            name, value = variable["name"], variable["expression"]
            asked = re.compile(rf"\bvariables\.{name}\b")
            if len(asked.findall(whole)) == 1:
                before, after = asked.split(whole)
                whole = f"{before}({value}){after}"
            elif asked.search(whole):
                whole = f"[{value}].all({name}, {asked.sub(name, whole)})"
        return whole

    def _rule(self, group: str, resources: Sequence[str]) -> dict[str, Any]:
        return {
            "apiGroups": [group],
            "apiVersions": ["*"],
            "operations": ["CREATE", "UPDATE"],
            "resources": list(resources),
        }


def _document(kind: str, name: str, spec: Mapping[str, Any]) -> dict[str, Any]:
    return {"apiVersion": API, "kind": kind, "metadata": {"name": name}, "spec": dict(spec)}
