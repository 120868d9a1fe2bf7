"""Random NetworkPolicies over few pods, so that they meet often; and who stands where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hypothesis import strategies as st

from ci.cluster.embedded.network_policies.nftables_rules import AttachedPod, Rulebook
from robotkube.foundation.kubernetes.core.network_policies import NetworkPeer, NetworkPolicy, read_policy
from tests.stages.network.nft_meaning import Network, PlacedPod, read

TEAMS = {"shop": "blue", "bank": "blue", "yard": "red"}  # namespaces and their label
PORTS = (("TCP", 80), ("TCP", 8080), ("TCP", 9000), ("UDP", 53), ("UDP", 8080), ("SCTP", 7))
NAMED: Sequence[Mapping[tuple[str, str], int]] = (
    {("TCP", "http"): 8080, ("UDP", "dns"): 53},
    {("TCP", "http"): 80},
    {},
)
BLOCKS = (
    {"cidr": "0.0.0.0/0"},
    {"cidr": "0.0.0.0/0", "except": ["10.244.0.0/16"]},
    {"cidr": "10.244.0.0/16", "except": ["10.244.1.0/24", "10.244.2.2/32"]},
    {"cidr": "10.89.0.1/32"},
    {"cidr": "10.244.1.2/32", "except": ["10.244.1.0/31"]},
    {"cidr": "10.244.1.2/32", "except": ["10.0.0.0/8"]},
    {"cidr": "239.255.0.1/32"},
    {"cidr": "fd00::/8"},
)
NODES = ("one", "two")
GROUP = "239.255.0.1"
OUTSIDE = (PlacedPod(NetworkPeer("host", "10.89.0.1")), PlacedPod(NetworkPeer("away", "203.0.113.9")))


def _placed() -> list[PlacedPod]:
    placed = []
    for number, (namespace, app) in enumerate((ns, app) for ns in TEAMS for app in ("web", "store")):
        for node, name in enumerate(NODES, 1):
            peer = NetworkPeer(
                f"{app}-{name}", f"10.244.{node}.{number + 2}", namespace, {"app": app, "on": name},
                {"team": TEAMS[namespace], "name": namespace}, NAMED[(number + node) % len(NAMED)],
            )  # fmt: skip
            placed.append(PlacedPod(peer, name, f"veth{node}{number}"))
    return placed


PODS = _placed()


def _selectors(keys: Mapping[str, Sequence[str]]) -> st.SearchStrategy[dict[str, Any]]:
    labels = st.one_of(*(st.fixed_dictionaries({key: st.sampled_from(values)}) for key, values in keys.items()))
    some = st.sampled_from([(key, tuple(values)) for key, values in keys.items()])
    expressions = st.one_of(
        st.builds(
            lambda key, operator, count: {"key": key[0], "operator": operator, "values": list(key[1][:count])},
            some, st.sampled_from(["In", "NotIn"]), st.integers(1, 2),
        ),
        st.builds(
            lambda key, operator: {"key": key, "operator": operator},
            st.sampled_from([*keys, "missing"]), st.sampled_from(["Exists", "DoesNotExist"]),
        ),
    )  # fmt: skip
    return st.one_of(
        st.just({}),
        st.fixed_dictionaries({"matchLabels": labels}),
        st.fixed_dictionaries({"matchExpressions": st.lists(expressions, min_size=1, max_size=2)}),
    )


POD_SELECTORS = _selectors({"app": ("web", "store"), "on": NODES})
NAMESPACE_SELECTORS = _selectors({"team": ("blue", "red"), "name": tuple(TEAMS)})
PEERS = st.one_of(
    st.fixed_dictionaries({"podSelector": POD_SELECTORS}),
    st.fixed_dictionaries({"namespaceSelector": NAMESPACE_SELECTORS}),
    st.fixed_dictionaries({"podSelector": POD_SELECTORS, "namespaceSelector": NAMESPACE_SELECTORS}),
    st.fixed_dictionaries({"ipBlock": st.sampled_from(BLOCKS)}),
)
RULE_PORTS = st.one_of(
    st.fixed_dictionaries({"protocol": st.sampled_from(["TCP", "UDP", "SCTP"])}),
    st.fixed_dictionaries({"port": st.sampled_from([80, 8080, 9000, "http"])}),
    st.fixed_dictionaries({"port": st.just(80), "endPort": st.sampled_from([80, 8080, 65535])}),
    st.fixed_dictionaries({"protocol": st.just("UDP"), "port": st.sampled_from([53, "dns"])}),
)


def _rules(key: str) -> st.SearchStrategy[list[dict[str, Any]]]:
    rule = st.fixed_dictionaries(
        {}, optional={key: st.lists(PEERS, max_size=3), "ports": st.lists(RULE_PORTS, max_size=2)}
    )
    return st.lists(rule, max_size=2)


SPECS = st.fixed_dictionaries(
    {"podSelector": POD_SELECTORS},
    optional={
        "policyTypes": st.sampled_from([["Ingress"], ["Egress"], ["Ingress", "Egress"]]),
        "ingress": _rules("from"),
        "egress": _rules("to"),
    },
)
DOCUMENTS = st.lists(st.tuples(st.sampled_from(sorted(TEAMS)), SPECS), max_size=5).map(
    lambda chosen: [
        {"metadata": {"namespace": namespace, "name": f"policy-{number}"}, "spec": spec}
        for number, (namespace, spec) in enumerate(chosen)
    ]
)
POLICIES: st.SearchStrategy[list[NetworkPolicy]] = DOCUMENTS.map(lambda made: [read_policy(one) for one in made])


def network(policies: Sequence[NetworkPolicy], pods: Sequence[PlacedPod] = tuple(PODS)) -> Network:
    """The rules of both nodes, read again."""
    book = Rulebook(policies, [pod.peer for pod in pods])
    texts = {node: book.node([AttachedPod(pod.port, pod.peer) for pod in pods if pod.node == node]) for node in NODES}
    return Network({node: read(text) for node, text in texts.items()})
