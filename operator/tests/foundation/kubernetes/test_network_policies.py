"""Who may connect to whom, by NetworkPolicies: each word of their language, allowed and denied."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.foundation.kubernetes.core.network_policies import NetworkPeer, may_connect, read_policy

WEB = NetworkPeer("web", "10.1.0.2", "shop", {"app": "web"}, {"team": "shop"}, {("TCP", "http"): 8080})
DATABASE = NetworkPeer("database", "10.1.0.3", "shop", {"app": "database"}, {"team": "shop"})
STRANGER = NetworkPeer("stranger", "10.1.9.9", "elsewhere", {"app": "web"}, {"team": "other"})
OUTSIDE = NetworkPeer("outside", "192.0.2.7")


def policy(spec: dict[str, Any], namespace: str = "shop", name: str = "policy") -> Any:
    return read_policy({"metadata": {"namespace": namespace, "name": name}, "spec": spec})


DENY = policy({"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}, name="default-deny")


def ingress(rule: dict[str, Any], pods: dict[str, Any] | None = None) -> Any:
    return policy({"podSelector": pods or {}, "policyTypes": ["Ingress"], "ingress": [rule]})


def allowed(
    policies: list[Any], source: NetworkPeer, target: NetworkPeer, port: int = 8080, protocol: str = "TCP"
) -> bool:
    return may_connect(policies, source, target, protocol, port).allowed


def test_without_a_policy_everybody_reaches_everybody() -> None:
    assert allowed([], STRANGER, WEB)
    assert allowed([], OUTSIDE, WEB)


def test_a_policy_without_rules_denies_both_directions_in_its_namespace_alone() -> None:
    assert not allowed([DENY], STRANGER, WEB)
    assert not allowed([DENY], WEB, OUTSIDE)
    assert not allowed([DENY], WEB, DATABASE)
    assert allowed([DENY], STRANGER, OUTSIDE)
    assert allowed([DENY], WEB, WEB)


def test_both_sides_must_allow_it_and_the_verdict_names_who_does_not() -> None:
    into = ingress({"from": [{"podSelector": {"matchLabels": {"app": "web"}}}]})
    verdict = may_connect([DENY, into], WEB, DATABASE, "TCP", 5432)
    assert verdict.reason == "egress of shop/web: none of shop/default-deny allows it; ingress: shop/policy rule 0"
    out = policy({"podSelector": {}, "policyTypes": ["Egress"], "egress": [{"to": [{"podSelector": {}}]}]}, name="out")
    assert may_connect([DENY, into, out], WEB, DATABASE, "TCP", 5432).allowed


@pytest.mark.parametrize(
    ("spec", "closed"),
    [
        ({"podSelector": {}}, {"ingress"}),
        ({"podSelector": {}, "egress": []}, {"ingress"}),
        ({"podSelector": {}, "egress": [{"to": [{"podSelector": {}}]}]}, {"ingress", "egress"}),
        ({"podSelector": {}, "policyTypes": ["Egress"]}, {"egress"}),
    ],
)
def test_directions_follow_from_types_and_rules(spec: dict[str, Any], closed: set[str]) -> None:
    read = policy(spec)
    assert allowed([read], STRANGER, WEB) == ("ingress" not in closed)
    assert allowed([read], WEB, OUTSIDE) == ("egress" not in closed)


@pytest.mark.parametrize(
    ("peer", "may"),
    [
        ({"podSelector": {}}, {"database"}),
        ({"podSelector": {"matchLabels": {"app": "web"}}}, set()),
        ({"namespaceSelector": {}}, {"database", "stranger"}),
        ({"namespaceSelector": {"matchLabels": {"team": "other"}}}, {"stranger"}),
        ({"namespaceSelector": {}, "podSelector": {"matchLabels": {"app": "web"}}}, {"stranger"}),
        (
            {"namespaceSelector": {"matchLabels": {"team": "other"}}, "podSelector": {"matchLabels": {"app": "x"}}},
            set(),
        ),
        ({"ipBlock": {"cidr": "0.0.0.0/0"}}, {"database", "stranger", "outside"}),
        ({"ipBlock": {"cidr": "192.0.2.0/24"}}, {"outside"}),
        ({"ipBlock": {"cidr": "0.0.0.0/0", "except": ["10.1.0.0/16"]}}, {"outside"}),
        ({"ipBlock": {"cidr": "::/0"}}, set()),
    ],
)
def test_a_peer_is_meant_by_pods_namespaces_or_addresses(peer: dict[str, Any], may: set[str]) -> None:
    rule = ingress({"from": [peer]}, {"matchLabels": {"app": "web"}})
    assert {one.name for one in (DATABASE, STRANGER, OUTSIDE) if allowed([rule], one, WEB)} == may


@pytest.mark.parametrize(
    ("expression", "holds"),
    [
        ({"key": "app", "operator": "In", "values": ["web", "x"]}, True),
        ({"key": "app", "operator": "In", "values": ["x"]}, False),
        ({"key": "app", "operator": "NotIn", "values": ["web"]}, False),
        ({"key": "missing", "operator": "NotIn", "values": ["x"]}, True),
        ({"key": "app", "operator": "Exists"}, True),
        ({"key": "missing", "operator": "Exists"}, False),
        ({"key": "app", "operator": "DoesNotExist"}, False),
        ({"key": "missing", "operator": "DoesNotExist"}, True),
    ],
)
def test_expressions_select_as_in_kubernetes(expression: dict[str, Any], holds: bool) -> None:
    selecting = policy({"podSelector": {"matchExpressions": [expression]}, "policyTypes": ["Ingress"]})
    assert selecting.selects(WEB) == holds
    assert not selecting.selects(replace(WEB, namespace="other"))


@pytest.mark.parametrize(
    ("ports", "may"),
    [
        ([], {("TCP", 80), ("TCP", 8080), ("UDP", 8080)}),
        ([{"port": 8080}], {("TCP", 8080)}),
        ([{"port": "http"}], {("TCP", 8080)}),
        ([{"port": "unknown"}], set()),
        ([{"protocol": "UDP"}], {("UDP", 8080)}),
        ([{"port": 79, "endPort": 81}], {("TCP", 80)}),
        ([{"port": 80}, {"protocol": "UDP", "port": 8080}], {("TCP", 80), ("UDP", 8080)}),
    ],
)
def test_ports_are_numbers_names_and_ranges_of_a_protocol(ports: list[Any], may: set[tuple[str, int]]) -> None:
    rule = ingress({"ports": ports})
    asked = [("TCP", 80), ("TCP", 8080), ("UDP", 8080)]
    assert {(protocol, port) for protocol, port in asked if allowed([rule], OUTSIDE, WEB, port, protocol)} == may


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (None, "NetworkPolicy shop/policy: spec: must be a mapping with podSelector, policyTypes, ingress, egress"),
        ({"podSelektor": {}}, "NetworkPolicy shop/policy: spec.podSelektor: is unknown"),
        ({"podSelector": {}, "policyTypes": ["Inward"]}, "spec.policyTypes: ['Inward'] must name Ingress, Egress"),
        ({"ingress": [{"to": []}]}, "spec.ingress[0].to: is unknown; known keys are from, ports"),
        ({"ingress": [{"from": [{}]}]}, "spec.ingress[0].from[0]: must be an ipBlock alone, or a podSelector"),
        (
            {"ingress": [{"from": [{"ipBlock": {"cidr": "10.0.0.0/8"}, "podSelector": {}}]}]},
            "spec.ingress[0].from[0]: must be an ipBlock alone",
        ),
        ({"ingress": [{"from": [{"ipBlock": {"cidr": "10.0.0.1/8"}}]}]}, "from[0].ipBlock: 10.0.0.1/8 has host bits"),
        ({"ingress": [{"ports": [{"protocol": "ICMP"}]}]}, "ports[0].protocol: 'ICMP' must be one of TCP, UDP, SCTP"),
        ({"ingress": [{"ports": [{"port": 0}]}]}, "ports[0].port: 0 must be 1 to 65535"),
        ({"ingress": [{"ports": [{"port": "http", "endPort": 9}]}]}, "ports[0].endPort: 9 needs a port by number"),
        (
            {"podSelector": {"matchExpressions": [{"key": "a", "operator": "Is"}]}},
            "spec.podSelector.matchExpressions[0].operator: 'Is' must be In, NotIn, Exists or DoesNotExist",
        ),
        (
            {"podSelector": {"matchExpressions": [{"key": "a", "operator": "In"}]}},
            "spec.podSelector.matchExpressions[0].values: In and NotIn need some",
        ),
    ],
)
def test_what_is_not_understood_is_refused_by_name(spec: Any, message: str) -> None:
    with pytest.raises(InputError) as refused:
        policy(spec)
    assert message in str(refused.value)
