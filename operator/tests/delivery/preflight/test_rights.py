"""Rights that Helm needs for the chart: taken from its rendering, and those that are missing named verb by verb."""

from __future__ import annotations

import json
from typing import Any

import pytest

from robotkube.delivery.preflight.adapters.cluster_facts import ClusterFacts
from robotkube.delivery.preflight.core.findings import FAILED, OK
from robotkube.delivery.preflight.core.rights import GIVING_VERBS, RBAC, NeededRights, Reviewed, needed_rights, rights
from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.core.access_rights import ApiRight, covers
from tests.stages.delivery.preflight.preflight_facts import finding, rendering

SECRETS = ApiRight("create", "", "secrets", "vehicle-00")
PODS = ApiRight("get", "", "pods", "vehicle-00")
ESCALATE, BIND = (ApiRight(verb, RBAC, "roles", "vehicle-00") for verb in GIVING_VERBS)
NEEDED = NeededRights(frozenset({SECRETS}), {("Role", "vehicle-00"): frozenset({PODS})})


class Reviews:
    """An API server that answers access reviews: `rules` in each namespace, `allowed` one by one."""

    def __init__(self, rules: Any = (), whole: bool = True, allowed: Any = ()) -> None:
        self.rules, self.whole, self.allowed = rules, whole, allowed
        self.asked: list[str] = []

    def __call__(self, method: str, path: str, query: Any = (), body: Any = None, seconds: float = 0) -> Any:
        assert method == "POST"
        self.asked.append(body["kind"])
        status: dict[str, Any] = {"resourceRules": list(self.rules), "incomplete": not self.whole}
        if body["kind"] == "SelfSubjectAccessReview":
            attributes = body["spec"]["resourceAttributes"]
            status = {"allowed": any(right.attributes == attributes for right in self.allowed)}
        return type("Answer", (), {"data": json.dumps({"status": status}).encode()})


@pytest.mark.parametrize("golden", ["official", "embedded"])
def test_every_kind_that_is_rendered_has_its_verbs(golden: str) -> None:
    made = rendering(golden)
    asked = {(right.resource, right.verb) for right in needed_rights(made).own}
    assert {("namespaces", verb) for verb in ("get", "create", "patch", "delete")} <= asked
    assert {("networkpolicies", "create"), ("customresourcedefinitions", "patch"), ("jobs", "watch")} <= asked
    assert ApiRight("update", "", "secrets", "robotkube") in needed_rights(made).own, "where Helm keeps its revisions"
    kinds = {str(item["kind"]) for item in made.objects}
    assert len({resource for resource, _ in asked}) == len(kinds)


def test_rights_that_the_charts_roles_give_are_needed_as_well() -> None:
    given = needed_rights(rendering()).given
    assert ApiRight("patch", "apps", "deployments", "vehicle-00") in given["Role", "vehicle-00"]
    assert ApiRight("get", "", "nodes/stats") in given["ClusterRole", ""]


def test_missing_verbs_are_named_with_their_places() -> None:
    needed = NeededRights(
        frozenset(ApiRight(verb, "apps", "deployments", place) for verb in ("get", "create") for place in ("a", "b")),
        {},
    )
    judged = finding("rights", rights=Reviewed(needed, needed.own))
    assert judged.result == FAILED
    [problem] = judged.problems
    assert (problem.what, problem.where) == ("may not create, get deployments.apps", "namespaces a, b")
    assert "give this account create, get on deployments.apps (a Role and RoleBinding there)" in problem.fix


@pytest.mark.parametrize(
    ("missing", "problems"),
    [({PODS, ESCALATE, BIND}, 1), ({PODS, BIND}, 1), ({PODS}, 0), ({ESCALATE, BIND}, 0)],
    ids=["no way", "no binding", "may give what it has not", "has what it gives"],
)
def test_who_gives_rights_has_them_or_may_give_others(missing: set[ApiRight], problems: int) -> None:
    missing_rights = rights(Reviewed(NEEDED, frozenset(missing))).problems
    assert len(missing_rights) == problems
    assert all(
        "may not give get of pods" in right.what and "escalate and bind" in right.fix for right in missing_rights
    )


def test_an_administrator_is_asked_once() -> None:
    everything = ApiRight("*", "*", "*")
    reviews = Reviews(allowed=[everything])
    assert ClusterFacts(reviews).rights(NEEDED).missing == frozenset()
    assert reviews.asked == ["SelfSubjectAccessReview"]


def test_others_by_the_rules_of_each_namespace() -> None:
    rules = [{"verbs": ["create"], "apiGroups": [""], "resources": ["secrets"]}]
    reviews = Reviews(rules)
    assert ClusterFacts(reviews).rights(NEEDED).missing == {PODS, ESCALATE, BIND}
    assert reviews.asked == ["SelfSubjectAccessReview", "SelfSubjectRulesReview"]


def test_rules_that_are_not_all_are_asked_one_by_one() -> None:
    assert ClusterFacts(Reviews(whole=False, allowed=[SECRETS, PODS])).rights(NEEDED).missing == {ESCALATE, BIND}


def test_too_many_questions_are_not_asked() -> None:
    many = NeededRights(frozenset(ApiRight("get", "", f"kind{number}") for number in range(401)), {})
    with pytest.raises(UnavailableError, match="401 rights would have to be asked for one by one"):
        ClusterFacts(Reviews()).rights(many)


@pytest.mark.parametrize(
    ("rule", "right", "covered"),
    [
        ({"verbs": ["*"], "apiGroups": ["*"], "resources": ["*"]}, ApiRight("get", "apps", "deployments"), True),
        (
            {"verbs": ["get"], "apiGroups": ["apps"], "resources": ["deployments"]},
            ApiRight("get", "", "deployments"),
            False,
        ),
        ({"verbs": ["get"], "apiGroups": [""], "resources": ["pods"]}, ApiRight("get", "", "pods/log"), False),
        ({"verbs": ["get"], "apiGroups": [""], "resources": ["*/log"]}, ApiRight("get", "", "pods/log"), True),
        (
            {"verbs": ["get"], "apiGroups": [""], "resources": ["secrets"], "resourceNames": ["a"]},
            ApiRight("get", "", "secrets", name="a"),
            True,
        ),
        (
            {"verbs": ["get"], "apiGroups": [""], "resources": ["secrets"], "resourceNames": ["a"]},
            ApiRight("get", "", "secrets"),
            False,
        ),
    ],
)
def test_rules_as_rbac_reads_them(rule: Any, right: ApiRight, covered: bool) -> None:
    assert covers([rule], right) is covered


def test_nothing_missing_is_ok() -> None:
    assert finding("rights", rights=Reviewed(NEEDED, frozenset())).result == OK
