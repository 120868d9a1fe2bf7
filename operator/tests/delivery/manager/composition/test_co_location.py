"""Charts by what they provide and guarantee, services with ros links on one node, places by capability alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Composition, Demand, Inputs, Met, Refused, compose
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.catalogue.core.catalogue import Catalogue, read_catalogue

RENDER = Jinja2Templates().render
API = "registry.robotkube.io/v1alpha1"
ANY = {"role": "edge"}


def chart(name: str, version: str = "0.1.0", state: str = "staged", **spec: Any) -> tuple[str, str]:
    document = {
        "apiVersion": API,
        "kind": "ChartVersion",
        "metadata": {"name": name},
        "spec": {
            "version": version, "description": "d", "channel": "stable",
            "platforms": ["linux/amd64"], "images": [], **spec,
        },
        "status": {"state": state, "digest": "sha256:" + "0" * 64},
    }  # fmt: skip
    return f"charts/{name}/{version}.yaml", write_mapping(document)


def service(name: str, placement: Mapping[str, Any] = ANY, **more: Any) -> dict[str, Any]:
    wanted = {"name": "worker", "version": ">=0.1.0"}
    return {"name": name, "release": name, "chart": wanted, "placement": dict(placement), **more}


def application(services: Sequence[Mapping[str, Any]], *links: tuple[str, str]) -> tuple[str, str]:
    ros = [{"kind": "ros", "from": {"service": a}, "to": {"service": b}} for a, b in links]
    parameters = {"type": "object", "properties": {"agents": {"type": "array"}}}
    spec = {"description": "d", "provides": ["x"], "parameters": parameters, "services": list(services), "links": ros}
    document = {"apiVersion": API, "kind": "Application", "metadata": {"name": "app"}, "spec": spec}
    return "applications/app.yaml", write_mapping(document)


def catalogue(*files: tuple[str, str]) -> Catalogue:
    read = read_catalogue({"policies/release.yaml": "assurance: none\n", **dict([chart("worker"), *files])})
    assert read.problems == ()
    return read


AGENTS = [Agent(f"edge-{i}", "edge", f"edge-{i}") for i in range(3)] + [Agent("cloud-0", "cloud", "cloud-0")]
NODES = [
    NodeState(a.name, a.name, a.role, frozenset({"gpu"} if a.name in ("edge-2", "cloud-0") else ()), True)
    for a in AGENTS
]


def composed(
    applications: Catalogue,
    present: Mapping[str, Release] | None = None,
    nodes: Sequence[NodeState] = NODES,
    **parameters: Any,
) -> Composition:
    return compose(
        [Demand("d", "app", parameters)], Inputs(applications, fleet(AGENTS, nodes), present or {}, RENDER, validate)
    )


def places(desired: Composition) -> dict[str, str]:
    outcome = desired.outcomes["d"]
    assert isinstance(outcome, Met), outcome
    return {release.name: release.namespace for release in desired.releases.values()}


def refused(desired: Composition) -> Refused:
    outcome = desired.outcomes["d"]
    assert isinstance(outcome, Refused)
    assert desired.releases == {}
    return outcome


def test_without_links_services_spread_and_with_ros_links_they_share_a_node() -> None:
    services = [service("a"), service("b"), service("c")]
    assert places(composed(catalogue(application(services)))) == {"a": "edge-0", "b": "edge-1", "c": "edge-2"}
    linked = composed(catalogue(application(services, ("a", "c"))))
    assert places(linked) == {"a": "edge-0", "b": "edge-1", "c": "edge-0"}
    outcome = linked.outcomes["d"]
    assert isinstance(outcome, Met)
    assert "a, c: on one node, linked by ros" in outcome.choices
    chain = composed(catalogue(application(services, ("a", "b"), ("c", "b"))))
    assert set(places(chain).values()) == {"edge-0"}


def test_the_group_needs_what_all_its_services_need() -> None:
    services = [service("a"), service("b", {"capabilities": ["gpu"]})]
    assert places(composed(catalogue(application(services, ("a", "b"))))) == {"a": "edge-2", "b": "edge-2"}
    without = [replace(node, capabilities=frozenset()) for node in NODES]
    outcome = refused(composed(catalogue(application(services, ("a", "b"))), nodes=without))
    assert outcome.reason == "NoCapableNode"
    assert "role edge, capability gpu (a, b: on one node, linked by ros)" in outcome.message
    assert "edge-0: lacks capability gpu; edge-1: lacks capability gpu" in outcome.message


@pytest.mark.parametrize(
    ("first", "second", "text"),
    [
        ({"role": "edge"}, {"role": "cloud"}, "a wants role edge, b wants role cloud"),
        ({"agent": "edge-0"}, {"agent": "edge-1"}, "a names edge-0, b names edge-1"),
        ({"agent": "edge-0"}, {"role": "cloud"}, "edge-0: has role edge, not cloud"),
        ({"agent": "edge-0"}, {"capabilities": ["gpu"]}, "edge-0: lacks capability gpu"),
    ],
)
def test_groups_that_fit_nowhere(first: dict[str, Any], second: dict[str, Any], text: str) -> None:
    services = [service("a", first), service("b", second)]
    outcome = refused(composed(catalogue(application(services, ("a", "b")))))
    assert outcome.reason == "NoCapableNode"
    assert text in outcome.message


def test_a_group_follows_a_named_agent() -> None:
    services = [service("a", {"agent": "edge-1"}), service("b")]
    assert places(composed(catalogue(application(services, ("b", "a"))))) == {"a": "edge-1", "b": "edge-1"}


def test_a_group_stays_where_most_of_it_runs() -> None:
    services = [service("a"), service("b"), service("c")]
    applications = catalogue(application(services, ("a", "b"), ("b", "c")))
    present = {
        f"releases/{namespace}/{name}.yaml": Release(namespace, name, "worker", "0.1.0", "sha256:" + "0" * 64, {})
        for name, namespace in (("a", "edge-0"), ("b", "edge-2"), ("c", "edge-2"))
    }
    away = [replace(node, ready=node.name != "edge-2") for node in NODES]
    assert set(places(composed(applications, present, away)).values()) == {"edge-2"}


def test_pairs_of_a_loop_have_a_node_each() -> None:
    loop = {"forEach": {"agent_name": "{{ parameters.agents }}"}}
    services = [
        {**service("a", {"agent": "{{ agent_name }}"}), **loop, "release": "a-{{ agent_name }}"},
        {**service("b"), **loop, "release": "b-{{ agent_name }}"},
    ]
    placed = places(composed(catalogue(application(services, ("a", "b"))), agents=["edge-2", "edge-1"]))
    assert placed == {"a-edge-1": "edge-1", "b-edge-1": "edge-1", "a-edge-2": "edge-2", "b-edge-2": "edge-2"}
    alone = [services[0], service("b")]
    outcome = refused(composed(catalogue(application(alone, ("a", "b"))), agents=["edge-2", "edge-1"]))
    assert "a names edge-2, a names edge-1" in outcome.message


def test_values_may_name_the_place_of_a_later_service_of_the_group() -> None:
    services = [service("a", values={"peer": "{{ placement.b }}"}), service("b")]
    desired = composed(catalogue(application(services, ("a", "b"))))
    assert desired.releases["releases/edge-0/a.yaml"].values["peer"] == "edge-0"


def test_a_place_by_capability_alone() -> None:
    desired = composed(catalogue(application([service("a", {"capabilities": ["gpu"]})])))
    assert places(desired) == {"a": "cloud-0"}
    outcome = refused(composed(catalogue(application([service("a", {"capabilities": ["arm"]})]))))
    assert "no agent for capability arm: cloud-0: lacks capability arm; edge-0" in outcome.message


def test_a_chart_by_what_it_provides() -> None:
    charts = [
        chart("fast", "0.2.0", provides=["relay/text"]),
        chart("also", "0.2.0", provides=["relay/text"]),
        chart("old", "0.1.0", provides=["relay/text", "relay/image"]),
        chart("gone", "0.9.0", "withdrawn", provides=["relay/text"]),
    ]
    by_text = {**service("a"), "chart": {"provides": "relay/text"}}
    desired = composed(catalogue(*charts, application([by_text])))
    assert next(iter(desired.releases.values())).chart == "also"
    outcome = desired.outcomes["d"]
    assert isinstance(outcome, Met)
    for reason in (
        "gone 0.9.0 (withdrawn): state withdrawn is not allowed",
        "also 0.2.0 (staged): taken",
        "fast 0.2.0 (staged): possible; also comes first by name",
        "old 0.1.0 (staged): older than 0.2.0 of also",
    ):
        assert reason in outcome.choices
    by_image = {**service("a"), "chart": {"provides": "relay/image", "version": ">=0.2.0"}}
    refusal = refused(composed(catalogue(*charts, application([by_image]))))
    assert refusal.reason == "NoVerifiedVersion"
    assert "chart that provides relay/image >=0.2.0" in refusal.message


def delayed(name: str, milliseconds: float) -> tuple[str, str]:
    guarantee = {"name": "delay", "atMost": milliseconds, "unit": "ms"}
    return chart(name, provides=["relay/text"], guarantees=[guarantee])


@pytest.mark.parametrize(
    ("requirement", "text"),
    [
        ({"guarantee": "delay", "atMost": 0.1, "unit": "s"}, ""),
        ({"guarantee": "delay", "atMost": 10, "unit": "ms"}, "delay at most 50 ms (declared), which is not enough"),
        ({"guarantee": "loss", "atMost": 1, "unit": "%"}, "gives no guarantee loss"),
        ({"guarantee": "delay", "atMost": 1, "unit": "s", "verified": True}, "asks for a verified one"),
    ],
)
def test_requirements_on_guarantees(requirement: dict[str, Any], text: str) -> None:
    wanted = {**service("a"), "chart": {"provides": "relay/text", "requirements": [requirement]}}
    desired = composed(catalogue(delayed("slow", 500), delayed("quick", 50), application([wanted])))
    if not text:
        assert next(iter(desired.releases.values())).chart == "quick"
        return
    outcome = refused(desired)
    assert outcome.reason == "GuaranteeNotMet"
    assert text in outcome.message
    assert "slow 0.1.0" in outcome.message


def test_a_withdrawn_version_that_would_guarantee_it_does_not_change_the_reason() -> None:
    wanted = {
        **service("a"),
        "chart": {"provides": "relay/text", "requirements": [{"guarantee": "x", "atMost": 1, "unit": "s"}]},
    }
    gone = chart("gone", state="withdrawn", provides=["relay/text"])
    assert refused(composed(catalogue(gone, application([wanted])))).reason == "NoVerifiedVersion"


@pytest.mark.parametrize(
    ("links", "text"),
    [
        ([{"kind": "ros", "from": {"service": "a"}, "to": {"service": "a"}}], "both ends are the same service"),
        (
            [{"kind": "ros", "from": {"service": "a"}, "to": {"agent": "x"}}],
            "spec.links[0].to.agent: unknown key",
        ),
        ([{"kind": "ros", "from": {"service": "a"}, "to": {"service": "b"}, "topics": []}], "topics: unknown key"),
    ],
)
def test_ros_links_that_are_refused(links: list[Any], text: str) -> None:
    path, written = application([service("a"), service("b")])
    problems = read_catalogue({path: written.replace("links: []", f"links: {links}")}).problems
    assert any(text in problem for problem in problems), problems


def test_the_evidence_of_a_release_is_that_of_its_chart() -> None:
    digest = "sha256:" + "e" * 64
    worker = replace(
        catalogue().charts["worker"][0], state="verified", evidence=digest, assured=True, evidence_problem=""
    )
    trusting = catalogue(application([service("a")]))
    strict = replace(trusting, charts={"worker": (worker,)}, assurance="verified")
    assert next(iter(composed(strict).releases.values())).evidence == digest
    assert next(iter(composed(trusting).releases.values())).evidence == "none"
    doubtful = replace(strict, charts={"worker": (replace(worker, assured=False, evidence_problem="forged"),)})
    assert "no valid evidence: forged" in refused(composed(doubtful)).message
