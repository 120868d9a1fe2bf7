"""NetworkPolicies of Argo CD's namespace, where it is installed for the platform: what the platform's table says about
its pods.

The table is that of the platform chart, and how API server and name service are reached is what the chart's values
below `networkPolicies` say of a cluster. What is not in the table is denied.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import yaml

Object = dict[str, Any]

CHART = Path(__file__).resolve().parents[2] / "charts" / "robotkube"
TABLE = CHART / "files" / "network.yaml"
DEFAULTS = CHART / "values.yaml"
WORD = "argocd"  # this namespace in the table
PLATFORM = "robotkube"  # namespace and release of the platform
OTHERS = {"platform": PLATFORM, "gate": f"{PLATFORM}-gate"}  # their namespaces by the table's words
API_SERVER, NAME_SERVICE, FORGE = "api-server", "name-service", "forge"
PORTS = {"https": 443, "http": 80}


def policies(namespace: str, stated: Mapping[str, Any], forge: str = "") -> list[Object]:
    """Everything denied, and one policy for each part of Argo CD. `stated`: the chart's values `networkPolicies` as far
    as they differ from its own; none are made where these say so. `forge`: the URL of one of others."""
    table = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    values = yaml.safe_load(DEFAULTS.read_text(encoding="utf-8"))["networkPolicies"]
    if not {**values, **stated}["enabled"]:
        return []
    values |= {word: {**values[word], **(stated.get(word) or {})} for word in ("apiServer", "dns", "outside")}
    parties = {name: party for name, party in table["parties"].items() if party["namespaces"] == WORD}
    policies = [_policy("default-deny", namespace, {})]
    for name, party in parties.items():
        policy = _policy(name, namespace, {"matchLabels": party["labels"]})
        for direction, rules in _rules(table, values, namespace, name, forge).items():
            if rules:
                policy["spec"][direction] = rules
        policies.append(policy)
    return policies


def _policy(name: str, namespace: str, pods: Object) -> Object:
    return {
        "apiVersion": "networking.k8s.io/v1",
        "kind": "NetworkPolicy",
        "metadata": {"name": name, "namespace": namespace},
        "spec": {"podSelector": pods, "policyTypes": ["Ingress", "Egress"]},
    }


def _rules(table: Object, values: Object, namespace: str, name: str, forge: str) -> dict[str, list[Object]]:
    peers = {word: _peer(party, namespace) for word, party in table["parties"].items()}
    ingress = [
        {"from": [peers[word] for word in edge["from"]], "ports": _ports([edge["port"]])}
        for edge in table["edges"]
        if edge["to"] == name
    ]
    edges = [edge for edge in table["edges"] if name in edge["from"]]
    egress = [rule for edge in edges for rule in _egress(edge, values, peers, forge)]
    return {"ingress": ingress, "egress": egress}


def _egress(
    edge: Mapping[str, Any], values: Mapping[str, Any], peers: Mapping[str, Object], forge: str
) -> Iterator[Object]:
    if edge["to"] == NAME_SERVICE:
        ports = values["dns"]["ports"]
        yield {**_whom(values["dns"]["to"]), "ports": [*_ports(ports, "UDP"), *_ports(ports)]}
    elif edge["to"] == API_SERVER:
        yield {**_whom(values["apiServer"]["to"]), "ports": _ports(values["apiServer"]["ports"])}
    elif edge["to"] == FORGE and forge:
        address = urlsplit(forge)
        yield {**_whom(values["outside"]["to"]), "ports": _ports([address.port or PORTS[address.scheme]])}
    else:
        yield {"to": [peers[edge["to"]]], "ports": _ports([edge["port"]])}


def _whom(peers: Sequence[Object]) -> Object:
    """These peers; none are every address, as in the chart."""
    return {"to": list(peers)} if peers else {}


def _ports(ports: Sequence[int], protocol: str = "TCP") -> list[Object]:
    return [{"protocol": protocol, "port": port} for port in ports]


def _peer(party: Mapping[str, Any], namespace: str) -> Object:
    """Pods of Argo CD or of the platform; no others are its peers."""
    own = party["namespaces"] == WORD
    component = {"app.kubernetes.io/component": party.get("component"), "app.kubernetes.io/instance": PLATFORM}
    names = {"kubernetes.io/metadata.name": namespace if own else OTHERS.get(party["namespaces"], "")}
    return {
        "namespaceSelector": {"matchLabels": names},
        "podSelector": {"matchLabels": party["labels"] if own else component},
    }
