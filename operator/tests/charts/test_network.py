"""Who may reach whom: the rendered NetworkPolicies say of every pair of pods, at every port, what the table of
docs/reference/network.md says, and deny everything else."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci.cluster.embedded.network.addresses import PLANS
from gitops.argocd import network as argocd_network
from gitops.argocd.render import external_forge
from robotkube.foundation.kubernetes.core.network_policies import NetworkPeer, NetworkPolicy, may_connect, read_policy
from tests.stages.paths import CHARTS, REPOSITORY

pytestmark = pytest.mark.toolchain

Object = dict[str, Any]
Reach = tuple[str, str, str, int]  # who, whom, protocol, port

PLATFORM = CHARTS / "robotkube"
PROFILES = Path(__file__).parent / "profiles"
PAGE = REPOSITORY / "docs" / "reference" / "network.md"
EDGE = re.compile(r"^\| (`.*`) \| `([a-z-]+)` \| (?:TCP (\d+)[^|]*|[^|]+) \|", re.MULTILINE)
PORTS = (53, 80, 443, 1883, 3000, 6379, 6443, 7000, 7400, 8080, 8081, 8083, 8883, 10250, 22, 27017, 27018)
ASKED = [*(("TCP", port) for port in PORTS), ("UDP", 53), ("UDP", 7400), ("UDP", 8080)]
AT = {"name-service": [("TCP", 53), ("UDP", 53)], "api-server": [("TCP", 6443)], "kubelets": [("TCP", 10250)]}

MONITORING = {"namespaceSelector": {"matchLabels": {"kubernetes.io/metadata.name": "monitoring"}}}
STATED: Object = {  # what people state on a cluster of their own
    "apiServer": {"to": [{"ipBlock": {"cidr": "172.18.0.2/32"}}], "ports": [6443]},
    "kubelets": {"to": [{"ipBlock": {"cidr": "172.18.0.4/32"}}]},
    "clients": {
        key: [{"ipBlock": {"cidr": "192.0.2.10/32"}}]
        for key in ("forge", "manager", "gate", "rights", "console", "broker", "database")
    },
    "metrics": {"from": [MONITORING]},
}
ELSEWHERE = (
    NetworkPeer("api-server", "172.18.0.2"),
    NetworkPeer("kubelet", "172.18.0.4"),
    NetworkPeer("client", "192.0.2.10"),
    NetworkPeer("internet", "203.0.113.9"),
    NetworkPeer("group", "239.255.0.1"),
)
HOST = NetworkPeer("host", str(PLANS["test"].gateway))
NODE = NetworkPeer("node", str(PLANS["test"].node(0)))


def pod(namespace: str, name: str, labels: Mapping[str, str], number: int) -> NetworkPeer:
    return NetworkPeer(
        f"{namespace}/{name}", f"10.1.{number // 200}.{number % 200 + 1}", namespace, labels,
        {"kubernetes.io/metadata.name": namespace},
    )  # fmt: skip


def templates(objects: Sequence[Object], namespace: str) -> Iterator[tuple[str, str, Object]]:
    for one in objects:
        if one["kind"] in ("Deployment", "StatefulSet", "Job"):
            yield one["metadata"].get("namespace", namespace), one["metadata"]["name"], one["spec"]["template"]


def pods(
    platform: Any, argocd: Sequence[Object], apps: Mapping[str, Any], agents: Sequence[str]
) -> dict[str, NetworkPeer]:
    """The pods of every part with the labels that their charts render, by <namespace>/<name>."""
    places = [(ns, name, dict(t["metadata"]["labels"])) for ns, name, t in templates(platform.objects, "robotkube")]
    places += [(ns, name, dict(t["metadata"]["labels"])) for ns, name, t in templates(argocd, "argocd")]
    places += [("robotkube", "manager-again", labels) for _, name, labels in list(places) if name == "manager"]
    for agent, chart in product(agents, ("mqtt-bridge", "event-detector")):
        [(_, _, template)] = templates(apps[chart].objects, agent)
        places.append((agent, chart, {**template["metadata"]["labels"], "robotkube.io/agent": agent}))
    for number, kind in product(range(2), ("subject", "helper")):
        places.append((f"robotkube-suite-{number}", kind, {"robotkube.io/suite": kind}))
        places.append((f"robotkube-suite-{number}", f"{kind}-again", {"robotkube.io/suite": kind}))
    places.append(("kube-system", "coredns", {"k8s-app": "kube-dns"}))
    places.append(("kube-system", "other", {}))
    places.append(("monitoring", "prometheus", {}))
    places.append(("robotkube-probe", "probe", {"app.kubernetes.io/component": "probe"}))
    places.append(("default", "stranger", {"app.kubernetes.io/component": "manager"}))
    return {one.name: one for number, place in enumerate(places) for one in [pod(*place, number)]}


def policies(objects: Sequence[Object]) -> list[NetworkPolicy]:
    return [read_policy(one) for one in objects if one["kind"] == "NetworkPolicy"]


def meaning(everybody: Mapping[str, NetworkPeer], recording: Sequence[str]) -> dict[str, set[str]]:
    """The names of the table: which pods each means."""
    names = ["manager", "suite-runner", "inspector", "rights", "certificates", "forge", "broker", "database", *OPTIONAL]
    meant = {name: {f"robotkube/{name}"} for name in (*names, "bootstrap", "teardown", "installation-test")}
    meant |= {name: meant[name] & set(everybody) for name in OPTIONAL}
    meant["manager"].add("robotkube/manager-again")
    meant["gate"] = {"robotkube-gate/gate"}
    meant["probe"] = {"robotkube-probe/probe"}
    meant["gate-key"] = {name for name in everybody if name.startswith("robotkube/gate-key-")}
    for name in ("repo-server", "application-controller", "applicationset-controller", "redis"):
        meant[name] = {f"argocd/argocd-{name}"}
    meant["argocd-server"] = {"argocd/argocd-server"}
    applications = {name for name in everybody if name.endswith(("/mqtt-bridge", "/event-detector"))}
    meant["application"] = applications
    meant["recorder"] = {name for name in applications if name.split("/")[0] in recording}
    tested = {name for name in everybody if name.startswith("robotkube-suite-")}
    meant |= {
        "tested": tested,
        "subject": {n for n in tested if "subject" in n},
        "helper": {n for n in tested if "helper" in n},
    }
    return meant | {"collector": set(), "admission": set(), "console-sign-in": set()}  # not installed, not asked for


def expected(means: Mapping[str, set[str]]) -> set[Reach]:
    """What the table of the page allows, one pair and port each."""
    rows = EDGE.findall(PAGE.read_text(encoding="utf-8"))
    assert len(rows) > 40
    reach: set[Reach] = set()
    for who, whom, port in rows:
        for name in re.findall("`([a-z-]+)`", who):
            reach |= reaches(means, name, whom, port)
    return reach


def reaches(means: Mapping[str, set[str]], name: str, whom: str, port: str) -> set[Reach]:
    if whom == "same":
        inside = [(a, b) for a, b in product(means[name], means[name]) if a != b and a.split("/")[0] == b.split("/")[0]]
        return {(a, b, *at) for a, b in inside for at in ASKED}
    if whom == "multicast":
        return {(a, "group", *at) for a in means[name] for at in ASKED if at[0] == "UDP"}
    at = [("TCP", int(port))] if port else AT.get(whom, [])
    return {(a, b, *one) for a, b in product(means[name], means[whom]) if a != b for one in at}


def table(rules: Sequence[NetworkPolicy], everybody: Mapping[str, NetworkPeer]) -> set[Reach]:
    """What the policies allow, among all pods and addresses."""
    pairs = product(everybody.values(), everybody.values())
    return {
        (source.name, target.name, *at)
        for source, target in pairs
        if source != target and (source.namespace or target.namespace)
        for at in ASKED
        if may_connect(rules, source, target, *at).allowed
    }


def difference(found: set[Reach], wanted: set[Reach]) -> dict[str, list[Reach]]:
    return {"allowed, not in the table": sorted(found - wanted), "denied, in the table": sorted(wanted - found)}


OPTIONAL = ("remover", "console")  # where they are installed
NOTHING: dict[str, list[Reach]] = {"allowed, not in the table": [], "denied, in the table": []}
FREE = (
    "kube-system/",
    "monitoring/",
    "default/",
    "robotkube-probe/",
)  # namespaces that are not ours: nobody denies anything there


def not_ours(reach: Reach) -> bool:
    who, whom = (name.startswith(FREE) or "/" not in name for name in reach[:2])
    return who and whom


def of_ours(name: str) -> bool:
    return "/" in name and not name.startswith(FREE)


def each_side(
    rules: Sequence[NetworkPolicy], everybody: Mapping[str, NetworkPeer], wanted: set[Reach]
) -> dict[str, Any]:
    """The pairs for which one side alone would allow more or less than the table: each must hold without the other."""
    into = table([replace(rule, egress=None) for rule in rules], everybody)
    out = table([replace(rule, ingress=None) for rule in rules], everybody)
    return {
        "ingress": difference({r for r in into if of_ours(r[1])}, {r for r in wanted if of_ours(r[1])}),
        "egress": difference({r for r in out if of_ours(r[0])}, {r for r in wanted if of_ours(r[0])}),
    }


def test_the_embedded_cluster_allows_what_the_table_says_and_nothing_else(
    embedded: Any, argocd: list[Object], apps: Mapping[str, Any]
) -> None:
    everybody = pods(embedded, argocd, apps, ("vehicle-00", "cloud-0"))
    everybody |= {one.name: one for one in (HOST, NODE, *ELSEWHERE[3:])}
    means = meaning(everybody, ["cloud-0"]) | {
        word: {"host"} for word in ("api-server", "name-service", "metrics", "clients")
    }
    means["kubelets"] = {"host", "node"}  # the gateway is an address of the nodes' network
    called = {("host", name, "TCP", 8080) for name in ("robotkube-gate/gate", "robotkube/rights")}
    wanted = expected(means) - called  # nobody on the host calls these
    wanted |= {("node", "robotkube/forge", "TCP", 3000)}  # clients of the forge are the nodes, too: they pull images
    rules = [*policies(embedded.objects), *policies(argocd)]
    allowed = table(rules, everybody)
    assert difference({one for one in allowed if not not_ours(one)}, wanted) == NOTHING
    assert each_side(rules, everybody, wanted) == {"ingress": NOTHING, "egress": NOTHING}


def test_a_cluster_of_ones_own_allows_what_the_table_says_and_nothing_else(
    helm: Any, argocd: list[Object], apps: Mapping[str, Any]
) -> None:
    """Argo CD is here as its own manifests leave it: what it does elsewhere is not ours."""
    rendered = helm.template(PLATFORM, PROFILES / "official.yaml", networkPolicies=STATED)
    everybody = pods(rendered, argocd, apps, ("vehicle-00", "vehicle-01", "cloud-0"))
    everybody |= {one.name: one for one in ELSEWHERE}
    means = meaning(everybody, ["cloud-0"])
    means |= {"api-server": {"api-server"}, "name-service": {"kube-system/coredns"}, "clients": {"client"}}
    means |= {"metrics": {"monitoring/prometheus"}, "kubelets": {"kubelet"}}

    def elsewhere(reach: Reach) -> bool:
        return not_ours(reach) or all(name.startswith((*FREE, "argocd/")) or "/" not in name for name in reach[:2])

    allowed = {one for one in table(policies(rendered.objects), everybody) if not elsewhere(one)}
    assert difference(allowed, {one for one in expected(means) if not elsewhere(one)}) == NOTHING


def test_argo_cd_that_comes_with_the_platform_does_what_the_table_says_on_any_cluster(
    helm: Any, argocd: list[Object], apps: Mapping[str, Any]
) -> None:
    rendered = helm.template(PLATFORM, PROFILES / "official.yaml", networkPolicies=STATED)
    everybody = pods(rendered, argocd, apps, ("vehicle-00", "vehicle-01", "cloud-0"))
    everybody |= {one.name: one for one in ELSEWHERE}
    means = meaning(everybody, ["cloud-0"])
    means |= {"api-server": {"api-server"}, "name-service": {"kube-system/coredns"}, "clients": {"client"}}
    means |= {"metrics": {"monitoring/prometheus"}, "kubelets": {"kubelet"}}
    rules = [*policies(rendered.objects), *map(read_policy, argocd_network.policies("argocd", STATED))]
    allowed = table(rules, everybody)
    wanted = expected(means)

    def of_argo_cd(reach: Reach) -> bool:
        return any(name.startswith("argocd/") for name in reach[:2]) and not not_ours(reach)

    assert difference(set(filter(of_argo_cd, allowed)), set(filter(of_argo_cd, wanted))) == NOTHING


def test_argo_cd_where_nothing_is_stated_and_where_no_policies_are_wanted() -> None:
    rules = list(map(read_policy, argocd_network.policies("argocd", {})))
    redis = pod("argocd", "redis", {"app.kubernetes.io/name": "argocd-redis"}, 0)
    assert {at for at in ASKED if may_connect(rules, redis, ELSEWHERE[2], *at).allowed} == {("TCP", 443), ("TCP", 6443)}
    assert argocd_network.policies("argocd", {"enabled": False}) == []


@pytest.mark.parametrize(("url", "port"), [("https://git.example", 443), ("http://git.example:3000", 3000)])
def test_argo_cd_reaches_a_forge_of_others_where_policies_say_it_is(url: str, port: int) -> None:
    stated = {**STATED, "outside": {"to": [{"ipBlock": {"cidr": "203.0.113.0/24"}}]}}
    forge = external_forge({"forge": {"kind": "external", "external": {"url": url}}})
    rules = list(map(read_policy, argocd_network.policies("argocd", stated, forge)))
    of_platform = {"app.kubernetes.io/component": "forge", "app.kubernetes.io/instance": "robotkube"}

    def reached(name: str, whom: NetworkPeer) -> set[int]:
        own = pod("argocd", name, {"app.kubernetes.io/name": f"argocd-{name}"}, 0)
        return {port for protocol, port in ASKED if may_connect(rules, own, whom, protocol, port).allowed} - {53}

    assert reached("repo-server", ELSEWHERE[3]) == {port}
    assert reached("repo-server", pod("robotkube", "forge", of_platform, 1)) == set()
    assert reached("server", ELSEWHERE[3]) == set()
    assert external_forge({"forge": {"kind": "gitea", "external": {"url": ""}}}) == external_forge({}) == ""


def test_what_a_vehicle_and_a_chart_under_test_reach(
    embedded: Any, argocd: list[Object], apps: Mapping[str, Any]
) -> None:
    """Written down by hand, beside the table."""
    everybody = pods(embedded, argocd, apps, ("vehicle-00", "cloud-0"))
    everybody |= {one.name: one for one in (HOST, NODE, *ELSEWHERE[3:])}
    rules = [*policies(embedded.objects), *policies(argocd)]

    def whom(who: str) -> set[tuple[str, str, int]]:
        own = who.split("/")[0]
        others = [one for one in everybody.values() if one.namespace != own]
        return {
            (one.name, *at) for one in others for at in ASKED if may_connect(rules, everybody[who], one, *at).allowed
        }

    host = {("host", "TCP", 53), ("host", "UDP", 53), ("host", "TCP", 6443)}
    multicast = {("group", "UDP", port) for port in (53, 7400, 8080)}
    broker, database = ("robotkube/broker", "TCP", 8883), ("robotkube/database", "TCP", 27018)
    assert whom("vehicle-00/mqtt-bridge") == {*host, *multicast, broker}
    assert whom("cloud-0/event-detector") == {*host, *multicast, broker, database}
    assert whom("robotkube-suite-0/subject") == {*multicast, ("host", "TCP", 6443)}
    assert whom("robotkube-suite-0/helper") == multicast
    assert whom("robotkube/broker") == whom("robotkube/database") == set()
    assert whom("robotkube-gate/gate") == {
        ("host", "TCP", 53),
        ("host", "UDP", 53),
        ("argocd/argocd-applicationset-controller", "TCP", 7000),
        ("robotkube/forge", "TCP", 3000),
        ("robotkube/manager", "TCP", 8080),
        ("robotkube/manager-again", "TCP", 8080),
        ("robotkube/suite-runner", "TCP", 8080),
    }


def test_the_console_reaches_the_forge_where_people_sign_in_by_it_alone(helm: Any, official: Any) -> None:
    component = "app.kubernetes.io/component"
    console, forge = (
        pod("robotkube", name, {component: name, "app.kubernetes.io/instance": "robotkube"}, number)
        for number, name in enumerate(("console", "forge"))
    )
    rendered = helm.template(PLATFORM, *(PROFILES / f"{name}.yaml" for name in ("official", "forge-sign-in")))

    def reached(rules: Sequence[NetworkPolicy]) -> list[tuple[str, int]]:
        return [at for at in ASKED if may_connect(rules, console, forge, *at).allowed]

    assert reached(policies(official.objects)) == []
    assert reached(policies(rendered.objects)) == [("TCP", 3000)]


def test_without_addresses_only_ports_of_the_api_server_are_open_and_none_of_ours(official: Any) -> None:
    bridge = pod("vehicle-00", "bridge", {}, 0)
    internet = ELSEWHERE[2]
    manager = pod("robotkube", "manager", {"app.kubernetes.io/component": "manager"}, 1)
    rules = policies(official.objects)
    assert {at for at in ASKED if may_connect(rules, bridge, internet, *at).allowed} == {("TCP", 443), ("TCP", 6443)}
    assert not [at for at in ASKED if may_connect(rules, bridge, manager, *at).allowed]
    assert not [at for at in ASKED if may_connect(rules, internet, manager, *at).allowed]


def test_no_rule_lets_everybody_in(official: Any, embedded: Any, argocd: list[Object]) -> None:
    """A rule without peers would; an empty list of clients must not become one."""
    for one in [*policies(official.objects), *policies(embedded.objects), *policies(argocd)]:
        assert all(rule.peers for rule in one.ingress or ()), f"{one.namespace}/{one.name}"


@pytest.mark.parametrize("profile", ["official", "embedded"])
def test_everything_is_denied_first_in_each_namespace_of_ours(request: pytest.FixtureRequest, profile: str) -> None:
    rendered = request.getfixturevalue(profile)
    made = {one["metadata"]["name"] for one in rendered.of_kind("Namespace")} | {"robotkube"}
    denying = [policy for policy in policies(rendered.objects) if policy.name == "default-deny"]
    assert {one.namespace for one in denying} == made
    assert all((one.pods, one.ingress, one.egress) == ((), (), ()) for one in denying)


def test_the_embedded_profile_names_the_gateways_of_both_clusters() -> None:
    values = yaml.safe_load((PLATFORM / "values-embedded.yaml").read_text(encoding="utf-8"))["networkPolicies"]
    gateways = [{"ipBlock": {"cidr": f"{plan.gateway}/32"}} for plan in PLANS.values()]
    assert values["apiServer"]["to"] == values["dns"]["to"] == values["metrics"]["from"] == gateways


def test_disabled_means_none(helm: Any) -> None:
    rendered = helm.template(PLATFORM, PROFILES / "official.yaml", networkPolicies={"enabled": False})
    assert rendered.of_kind("NetworkPolicy") == []


def test_what_stands_elsewhere_is_reached_at_its_port_alone(helm: Any) -> None:
    address = [{"ipBlock": {"cidr": "198.51.100.0/24"}}]
    forge = {"kind": "external", "external": {"url": "https://git.example:8443", "protocol": "gitlab"}}
    rendered = helm.template(
        PLATFORM,
        PROFILES / "official.yaml",
        forge=forge,
        broker={"kind": "external", "external": {"host": "mqtt.example", "port": 8883}},
        tls={"mode": "off"},
        database={"kind": "external", "external": {"host": "mongo.example", "port": 27018}},
        traces={"endpoint": "http://collector.example:4318/v1/traces"},
        networkPolicies={**STATED, "outside": {"to": address}},
    )
    rules = policies(rendered.objects)
    there = NetworkPeer("there", "198.51.100.7")
    asked = [("TCP", port) for port in (443, 1883, 3000, 4318, 6443, 8443, 8883, 27017, 27018)]

    def reached(namespace: str, component: str = "") -> set[int]:
        labels = {"app.kubernetes.io/component": component, "app.kubernetes.io/instance": "robotkube"}
        own = pod(namespace, "pod", labels, 0)
        return {port for protocol, port in asked if may_connect(rules, own, there, protocol, port).allowed}

    assert reached("robotkube-gate", "gate") == {443, 8443}  # 443: gitlab's public API
    assert reached("robotkube", "manager") == {443, 8443, 8883, 4318}
    assert reached("vehicle-00") == {8883}
    assert reached("cloud-0") == {8883, 27018}


def test_every_part_of_the_chart_may_be_given_further_rules() -> None:
    table = yaml.safe_load((PLATFORM / "files" / "network.yaml").read_text(encoding="utf-8"))
    parties = [name for name, party in table["parties"].items() if party["namespaces"] not in ("argocd", "probe")]
    schema = json.loads((PLATFORM / "values.schema.json").read_text(encoding="utf-8"))
    values = schema["properties"]["networkPolicies"]["properties"]
    for key in ("extraIngress", "extraEgress"):
        assert values[key]["propertyNames"]["enum"] == parties


def test_further_rules_reach_the_pods_they_are_for(helm: Any) -> None:
    webhook, dashboard = [{"ipBlock": {"cidr": "192.0.2.20/32"}}], [{"ipBlock": {"cidr": "192.0.2.30/32"}}]
    port = [{"protocol": "TCP", "port": 8443}]
    stated = {
        "extraEgress": {"application": [{"to": webhook, "ports": port}]},
        "extraIngress": {"application": [{"from": dashboard, "ports": port}]},
    }
    rules = policies(helm.template(PLATFORM, PROFILES / "official.yaml", networkPolicies=stated).objects)
    vehicle, gate = (
        pod("vehicle-00", "pod", {}, 0),
        pod("robotkube-gate", "gate", {"app.kubernetes.io/component": "gate"}, 1),
    )
    to, by = NetworkPeer("to", "192.0.2.20"), NetworkPeer("by", "192.0.2.30")
    assert may_connect(rules, vehicle, to, "TCP", 8443).allowed
    assert may_connect(rules, by, vehicle, "TCP", 8443).allowed
    assert not may_connect(rules, vehicle, by, "TCP", 8443).allowed
    assert not may_connect(rules, to, vehicle, "TCP", 8443).allowed
    assert not may_connect(rules, gate, to, "TCP", 8443).allowed
