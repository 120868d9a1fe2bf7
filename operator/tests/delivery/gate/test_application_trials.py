"""Trials of applications: what a sample of their parameters leads to, and the sentence their author reads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.gate.loops import application_trials
from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.application_statements import TrialResult
from tests.stages.attacks import shown
from tests.stages.delivery.gate.trials import (
    FOREIGN,
    IMAGE,
    application,
    catalogue,
    objects,
    reference,
    relay,
    trials,
)
from tests.stages.registry.submissions import POLICY as DOCUMENT

CHOICE = {"choice": {"enum": ["good", "bad"], "default": "good"}}


def tried(folder: Path, *parts: Mapping[str, str], versions: tuple[str, ...] = ("0.1.0",)) -> TrialResult:
    files = catalogue(*(parts if len(parts) > 1 else (relay(), *parts)))
    return trials(folder)(files, ["relaying"], [reference(version) for version in versions])["relaying"]


def bad(good: Any, wrong: Any, key: str) -> dict[str, str]:
    """An application whose parameter `choice` leads from a good value to a bad one, told apart in a list."""
    pick = f"{{{{ ({[good, wrong]!r})[1 if parameters.choice == 'bad' else 0] }}}}"
    return application(CHOICE, {key: pick})


def test_an_application_that_is_all_right_names_what_it_was_tried_with(tmp_path: Path) -> None:
    trial = tried(tmp_path, application({"rate": {"type": "integer", "minimum": 1, "maximum": 5}}))
    assert trial == TrialResult((), (reference(),), trial.samples, 1)
    assert trial.samples > 3


@pytest.mark.parametrize(
    ("key", "good", "wrong", "words"),
    [
        (
            "image",
            IMAGE,
            FOREIGN,
            f"a pod would run image {FOREIGN}, which was not verified with chart {reference()} (images: {IMAGE})",
        ),
        ("metadata", {}, {"namespace": "kube-system"}, "Deployment relay: metadata.namespace is set"),
        (
            "container",
            {},
            {"securityContext": {"privileged": True}},
            "privileged is true: it could do everything that root can do on the node",
        ),
        (
            "pod",
            {},
            {"volumes": [{"name": "host", "hostPath": {"path": "/"}}]},
            "Deployment relay: volume host: type hostPath: a folder of the node; use only volumes of the types",
        ),
        ("pod", {}, {"hostNetwork": True}, "hostNetwork is true: the pod would share this with its node"),
        ("kind", "Deployment", "DaemonSet", "DaemonSet relay (apps/v1): the platform's AppProject lets no release"),
        ("metadata", {}, {"annotations": {"argocd.argoproj.io/hook": "PreSync"}}, "hooks are no part of a release"),
        ("broken", False, True, "the chart cannot be rendered: no such template"),
        ("rate", 5, 5000, "chart relay 0.1.0: values.rate: 5000 is greater than the maximum of 1000"),
    ],
)
def test_a_parameter_that_leads_where_no_release_may_go_is_named_with_its_value(
    tmp_path: Path, key: str, good: Any, wrong: Any, words: str
) -> None:
    problems = tried(tmp_path, bad(good, wrong, key)).problems
    assert problems
    text = next(problem for problem in problems if words in problem)
    place = "spec.services[0]" if key != "rate" else "spec"
    assert text.startswith(f"{place}: with parameters {{'choice': 'bad'}}: ")
    if key == "image":
        shown("gate", text, "image-by-publisher")
    if "hostPath" in text:
        shown("gate", text, "application-to-the-machine")
    if key != "rate":
        assert text.endswith("; release cloud-00/relay of chart relay 0.1.0")


def test_two_parameters_that_are_harmless_one_by_one_are_tried_together(tmp_path: Path) -> None:
    pick = f"{{{{ '{FOREIGN}' if parameters.a != parameters.b and parameters.a == 2 else '{IMAGE}' }}}}"
    both = {"a": {"enum": [1, 2, 3]}, "b": {"enum": [1, 2, 3]}}
    trial = tried(tmp_path, application(both, {"image": pick}))
    assert FOREIGN in trial.problems[0]
    assert trial == tried(tmp_path, application(both, {"image": pick}))


def test_without_the_static_suite_only_what_endangers_others_is_asked(tmp_path: Path) -> None:
    others = [suite for suite in DOCUMENT["spec"]["suites"] if suite["name"] != "static"]
    policy = {"policies/verification.yaml": write_mapping({**DOCUMENT, "spec": {"suites": others}})}
    plain = {"container": {"resources": {}}}
    assert "resources.requests.cpu is missing" in tried(tmp_path, application({}, plain)).problems[0]
    assert tried(tmp_path, relay(), application({}, plain), policy).problems == ()
    for wrong in ({"kind": "Secret"}, {"pod": {"hostPID": True}}, {"image": FOREIGN}, {"metadata": {"namespace": "x"}}):
        assert tried(tmp_path, relay(), application({}, wrong), policy).problems, wrong


def test_agents_that_parameters_and_templates_name_are_there(tmp_path: Path) -> None:
    sensor = {"sensor": {"type": "string", "pattern": "^[a-z]+-[0-9]$", "examples": ["mast-7"]}}
    service = {
        "name": "relay",
        "release": "relay-{{ parameters.sensor }}",
        "chart": {"name": "relay", "version": ">=0.1.0"},
        "placement": {"agent": "{{ parameters.sensor }}-edge"},
    }
    other = {**service, "name": "other", "release": "other", "placement": {"role": "edge", "capabilities": ["gpu"]}}
    parameters = {"type": "object", "required": ["sensor"], "properties": sensor}
    trial = tried(tmp_path, application(parameters=parameters, services=[service, other]))
    assert trial.problems == ()
    assert trial.releases >= 2


def test_a_bridge_is_tried_as_it_bridges(tmp_path: Path) -> None:
    values = {"pod": {"hostIPC": "{{ topics.out | length > 0 }}"}}
    bridging = application({}, values, provides=["link/mqtt"])
    bridging["applications/relaying.yaml"] = bridging["applications/relaying.yaml"].replace(
        "role: cloud", "agent: '{{ agent }}'"
    )
    trial = tried(tmp_path, bridging)
    assert "hostIPC is true" in trial.problems[0]
    assert trial.problems[0].startswith("spec.services[0]: ")


def test_a_link_whose_type_no_bridge_knows_is_refused_before_it_is_published(tmp_path: Path) -> None:
    topic = {"name": "/vehicles/vehicle_00/fix", "type": "rover_msgs/msg/Fix", "channel": "telemetry"}
    topic |= {"reliability": "reliable", "durability": "volatile", "depth": 1}
    ends: dict[str, Any] = {"from": {"agent": "vehicle-00"}, "to": {"role": "cloud"}}
    (text,) = application({}, provides=["link/mqtt"]).values()
    bridge = text.replace("name: relaying", "name: bridge").replace("role: cloud", "agent: '{{ agent }}'")
    linked = application({}, links=[{"kind": "mqtt", **ends, "topics": [topic]}])
    trial = tried(tmp_path, relay(), linked, {"applications/bridge.yaml": bridge})
    assert "type rover_msgs/msg/Fix: none of the packaged images has the message package" in trial.problems[0]


def test_a_link_that_its_chart_takes_otherwise_is_refused_before_it_is_published(tmp_path: Path) -> None:
    topic = {"name": "/vehicles/vehicle_00/level", "type": "std_msgs/msg/Float32", "channel": "telemetry"}
    topic |= {"reliability": "reliable", "durability": "volatile", "depth": 1}
    (text,) = application({}, provides=["link/mqtt"]).values()
    bridge = text.replace("name: relaying", "name: bridge").replace("role: cloud", "agent: '{{ agent }}'")
    interface: dict[str, Any] = {"name": "level", "medium": "ros", "direction": "in", "topic": topic["name"]}
    interface |= {"type": "std_msgs/msg/Float64", "qos": {"reliability": "reliable", "durability": "volatile"}}
    chart = relay()
    path = "charts/relay/0.1.0.yaml"
    chart[path] = write_mapping(merged(chart[path], {"interfaces": [interface]}))
    ends: dict[str, Any] = {"from": {"agent": "vehicle-00"}, "to": {"service": "relay"}}
    linked = application({}, links=[{"kind": "mqtt", **ends, "topics": [topic]}])
    trial = tried(tmp_path, chart, linked, {"applications/bridge.yaml": bridge})
    assert (
        "spec.links[0].topics[0].type: topic /vehicles/vehicle_00/level is std_msgs/msg/Float32 here"
        in trial.problems[0]
    )
    interface["type"] = topic["type"]
    chart[path] = write_mapping(merged(chart[path], {"interfaces": [interface]}))
    assert tried(tmp_path, chart, linked, {"applications/bridge.yaml": bridge}).problems == ()


def test_a_topic_that_only_some_senders_may_write_is_refused_before_it_is_published(tmp_path: Path) -> None:
    """That the leader follows itself in one of the samples does not make the application right."""
    topic = {"name": "/vehicles/{{ parameters.leader | ros }}/alarm", "type": "std_msgs/msg/String"}
    topic |= {"channel": "telemetry", "reliability": "reliable", "durability": "volatile", "depth": 1}
    (text,) = application({}, provides=["link/mqtt"]).values()
    bridge = text.replace("name: relaying", "name: bridge").replace("role: cloud", "agent: '{{ agent }}'")
    vehicles = {"type": "string", "default": "vehicle-00", "examples": ["vehicle-00", "vehicle-01"]}
    both = {"leader": vehicles, "follower": vehicles}
    ends: dict[str, Any] = {"from": {"agent": "{{ parameters.follower }}"}, "to": {"role": "cloud"}}
    linked = application(both, links=[{"kind": "mqtt", **ends, "topics": [topic]}])
    trial = tried(tmp_path, relay(), linked, {"applications/bridge.yaml": bridge})
    assert "may not write it at the broker" in trial.problems[0]
    assert "'follower': 'vehicle-0" in trial.problems[0]


def merged(text: str, spec: Mapping[str, Any]) -> dict[str, Any]:
    """A document with more in its spec."""
    document = yaml.safe_load(text)
    return {**document, "spec": {**document["spec"], **spec}}


def test_one_that_runs_by_itself_is_tried_for_an_agent_of_its_role(tmp_path: Path) -> None:
    values = {"pod": {"hostIPC": "{{ agent == 'mast-00' }}"}}
    trial = tried(tmp_path, application({}, values, initialFor="mast"))
    assert "hostIPC is true" in trial.problems[0]


def test_a_version_that_was_withdrawn_is_not_composed_with(tmp_path: Path) -> None:
    withdrawn = {path: text.replace("state: staged", "state: withdrawn") for path, text in relay().items()}
    trial = tried(tmp_path, withdrawn, application(), versions=())
    assert "no version of chart relay >=0.1.0 with assurance verified" in trial.problems[0]
    assert "state withdrawn is not allowed" in trial.problems[0]
    assert tried(tmp_path, withdrawn, relay("0.2.0"), application(), versions=("0.2.0",)).problems == ()


def test_older_versions_in_the_range_are_tried_as_well(tmp_path: Path) -> None:
    older = relay("0.0.9", properties={"placement": {}, "global": {}}, additionalProperties=False)
    newer = relay("0.2.0")
    versions = ("0.0.9", "0.2.0")
    ranged = application({}, {"rate": 5})
    ranged["applications/relaying.yaml"] = ranged["applications/relaying.yaml"].replace(">=0.1.0", ">=0.0.1")
    trial = tried(tmp_path, older, newer, ranged, versions=versions)
    assert (
        "chart relay 0.0.9: values: Additional properties are not allowed ('rate' was unexpected)" in trial.problems[0]
    )
    assert "narrow the range of chart relay" in trial.problems[0]
    good = tried(tmp_path, relay("0.0.9"), newer, ranged, versions=versions)
    assert good.charts == (reference("0.0.9"), reference("0.2.0"))


def test_what_was_not_submitted_counts_by_its_own_evidence(tmp_path: Path) -> None:
    trial = tried(tmp_path, relay(), application(), versions=())
    assert "relay 0.1.0 (staged): state staged is not allowed" in trial.problems[0]


def test_parameters_for_which_no_value_is_found_are_named(tmp_path: Path) -> None:
    secret = {"word": {"type": "string", "pattern": "^(?=open)sesame$"}}
    required = application(parameters={"type": "object", "required": ["word"], "properties": secret})
    assert tried(tmp_path, required).problems == (
        "spec.parameters: no set of values was found that the schema accepts; add `examples: [...]` to the parameters",
    )


def test_one_that_no_sampled_fleet_can_serve_is_refused(tmp_path: Path) -> None:
    spread = {
        "name": "relay",
        "release": "relay-{{ one }}",
        "chart": {"name": "relay", "version": ">=0.1.0"},
        "placement": {"role": "cloud", "spread": True},
        "forEach": {"one": list("abcdefgh")},
    }
    assert "no sample could be composed: NoCapableNode" in tried(tmp_path, application(services=[spread])).problems[0]


def test_trials_are_bounded_in_releases_and_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rate = {"rate": {"type": "integer", "minimum": 1, "maximum": 9, "default": 5}}
    files = catalogue(relay(), application(rate, {"rate": "{{ parameters.rate }}"}))

    def result(seconds_each: float = 0.0) -> TrialResult:
        trial = trials(tmp_path, seconds_each=seconds_each)(files, ["relaying"], [reference()])["relaying"]
        assert trial.finished is trial.passed
        return trial

    looks_while_composing = 2 * result().samples + 2
    for seconds_each in (50.0, 60 / (looks_while_composing + 1)):  # while it composes, and while it renders
        assert "needs more than 500 different releases, or 60 s with the others" in result(seconds_each).problems[0]
    monkeypatch.setattr(application_trials, "RELEASES_MAX", 1)
    assert "needs more than 1 different releases" in result().problems[0]


def test_while_charts_cannot_be_rendered_nothing_is_decided(tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match="the OCI registry is away"):
        tried(tmp_path, application({}, {"away": True}))


def test_without_a_verification_policy_nothing_is_tried(tmp_path: Path) -> None:
    files = catalogue()
    del files["policies/verification.yaml"]
    assert trials(tmp_path)(files, ["relaying"], [reference()]) == {}


def test_only_what_was_asked_for_is_tried(tmp_path: Path) -> None:
    rendered: list[ChartReference] = []

    def counting(chart: ChartReference, *rest: Any) -> Any:
        rendered.append(chart)
        return objects(chart, *rest)

    assert trials(tmp_path, counting)(catalogue(), ["unknown"], [reference()]) == {}
    assert rendered == []
