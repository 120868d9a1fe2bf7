"""registry/: schemas and readers agree, and what composition makes of it fits the charts' own schemas."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.deployment.core.policies.initial import read_initial_policy
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Demand, Inputs, Met, compose
from robotkube.delivery.manager.core.composition.initial_demands import initial_demands
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.delivery.tasks.core.task_description import read_task
from robotkube.errors import DocumentError, RefusalError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import check_schema, validate
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.catalogue.core.catalogue import (
    PERSON,
    ChartRequirement,
    ReleasePolicy,
    read_application,
    read_catalogue,
    read_chart_version,
    read_release_policy,
)
from robotkube.registry.catalogue.core.versions import in_range
from robotkube.robots.detector.core.settings import read_detector_settings
from tests.stages.paths import REPOSITORY

REGISTRY = REPOSITORY / "registry"
APPLICATIONS = sorted(REGISTRY.glob("applications/*.yaml"))
CHARTS = sorted(REGISTRY.glob("charts/*/*.yaml"))
STATUS = {"state": "staged", "digest": "sha256:" + "0" * 64, "images": []}


@dataclass(frozen=True)
class Assessment:
    """What was found about some evidence."""

    assured: bool
    problems: tuple[str, ...] = ()
    findings: tuple[Mapping[str, Any], ...] = ()


def schema(name: str) -> dict[str, Any]:
    return dict(json.loads((REGISTRY / "schemas" / f"{name}.json").read_text()))


def load(path: Path) -> dict[str, Any]:
    return dict(yaml.safe_load(path.read_text()))


@pytest.mark.parametrize("path", APPLICATIONS, ids=lambda p: p.stem)
def test_applications_are_valid(path: Path) -> None:
    assert validate(schema("application"), load(path)) == []
    application = read_application(path.read_text(), f"applications/{path.name}")
    assert check_schema(application.parameters) == []
    assert application.parameters["additionalProperties"] is False


@pytest.mark.parametrize("path", CHARTS, ids=lambda p: f"{p.parent.name}-{p.stem}")
def test_chart_versions_are_valid_with_and_without_a_status(path: Path) -> None:
    assert validate(schema("chart-version"), load(path)) == []
    published = {**load(path), "status": STATUS}
    assert validate(schema("chart-version"), published) == []
    version = read_chart_version(write_mapping(published), str(path.relative_to(REGISTRY)))
    assert (version.chart, version.version) == (path.parent.name, path.stem)
    folders = [load(file) for file in REPOSITORY.glob(f"charts/*/{version.chart}/Chart.yaml")]
    assert (version.chart, version.version) in [(chart["name"], chart["version"]) for chart in folders]


def test_the_release_policy_is_valid() -> None:
    path = REGISTRY / "policies" / "release.yaml"
    assert validate(schema("release-policy"), load(path)) == []
    assert read_release_policy(path.read_text(), "policies/release.yaml") == ReleasePolicy(
        "verified", PERSON, "verified"
    )
    assert read_release_policy("assurance: verified\n", "policies/release.yaml").initial_for == PERSON
    with pytest.raises(DocumentError, match="must be one of none, verified"):
        read_release_policy("assurance: some\n", "policies/release.yaml")
    with pytest.raises(DocumentError, match=r"initialFor: .*must be one of person, automatic"):
        read_release_policy("assurance: verified\ninitialFor: nobody\n", "policies/release.yaml")


BREAKS: list[tuple[str, Any]] = [
    ("spec.surprise", 1),
    ("spec.initialFor", "Not A Role"),
    ("spec.parameters", {"type": "array"}),
    ("spec.services.0.chart.version", "latest"),
    ("spec.services.0.placement", {"role": "cloud", "agent": "a"}),
    ("spec.services.0.placement", {}),
    ("spec.services.0.values.placement", {"agent": "x"}),
    ("spec.services.0.forEach", {"task": [1]}),
    ("spec.links.0.kind", "carrier-pigeon"),
    ("spec.links.0.to", {}),
    ("spec.links.0.topics.0.extra", 1),
    ("metadata.name", "Upper"),
    ("kind", "Chart"),
]


@pytest.mark.parametrize(("key", "value"), BREAKS, ids=[key for key, _ in BREAKS])
def test_schema_and_reader_refuse_the_same(key: str, value: Any) -> None:
    document = copy.deepcopy(load(REGISTRY / "applications" / "pose-point-cloud-recording.yaml"))
    place: Any = document
    *parents, last = key.split(".")
    for part in parents:
        place = place[int(part)] if part.isdecimal() else place[part]
    place[last] = value
    assert validate(schema("application"), document) != []
    with pytest.raises(DocumentError):
        read_application(write_mapping(document), "applications/pose-point-cloud-recording.yaml")


TASKS: dict[str, dict[str, Any]] = {
    "pose-point-cloud-recording": {"vehicles": ["vehicle-00"]},
    "environment-perception": {"sensor": "roadside-0"},
    "roadside-operator": {"site": "roadside-0", "vehicle": "vehicle-00"},
    "uncertainty-operator": {"site": "roadside-0", "vehicle": "vehicle-00"},
}
INITIAL = """add:
- {application: bag-player, forRole: vehicle}
- {application: intersection-operator, forRole: cloud}
"""


def everything(tasks: Mapping[str, Mapping[str, Any]], perceiving: str = "roadside-0") -> dict[str, Any]:
    """All releases of a small fleet: players, an operator at an intersection, and what `tasks` (application ->
    parameters) ask for; one agent offers perception."""
    files = {str(p.relative_to(REGISTRY)): p.read_text() for p in APPLICATIONS}
    files |= {str(p.relative_to(REGISTRY)): write_mapping({**load(p), "status": STATUS}) for p in CHARTS}
    catalogue = read_catalogue({**files, "policies/release.yaml": "assurance: none\n"})
    roles = {"cloud-0": "cloud", "roadside-0": "roadside", "vehicle-00": "vehicle"}
    agents = [Agent(name, role, name) for name, role in roles.items()]
    able = {agent.name: {"perception"} if agent.name == perceiving else set() for agent in agents}
    able["cloud-0"].add("recording")
    nodes = [NodeState(a.name, a.name, a.role, frozenset(able[a.name]), True) for a in agents]
    machines = fleet(agents, nodes)
    demands = initial_demands(catalogue, read_initial_policy(INITIAL), machines)
    for application, parameters in tasks.items():
        event = {"rule": "near", "id": "e1", "trace": "0" * 32, "time": "2026-11-21T10:00:00Z"}
        spec = {"event": event, "application": application, "parameters": parameters}
        task = read_task({"metadata": {"namespace": "cloud-0", "name": application}, "spec": spec})
        demands.append(Demand(task.key, task.application, task.parameters, task=task))
    desired = compose(demands, Inputs(catalogue, machines, {}, Jinja2Templates().render, validate))
    refused = {key: outcome for key, outcome in desired.outcomes.items() if not isinstance(outcome, Met)}
    assert refused == {}
    return dict(desired.releases)


RELEASES = everything(TASKS)


@pytest.mark.parametrize("path", sorted(RELEASES))
def test_composed_values_fit_the_charts(path: str) -> None:
    release = RELEASES[path]
    chart_schema = json.loads((REPOSITORY / "charts" / "apps" / release.chart / "values.schema.json").read_text())
    values = {**release.values, "global": {"plan": "p"}}
    assert validate(chart_schema, values) == []


def test_every_chart_is_used() -> None:
    assert {release.chart for release in RELEASES.values()} == {path.parent.name for path in CHARTS}
    assert {release.version for release in RELEASES.values() if release.chart.startswith("object-")} == {"0.2.3"}
    assert sorted(release.key for release in RELEASES.values()) == [
        "cloud-0/event-detector",
        "cloud-0/intersection-operator",
        "cloud-0/mqtt-bridge",
        "cloud-0/recorder-vehicle-00",
        "roadside-0/mqtt-bridge",
        "roadside-0/object-detection-roadside-0",
        "roadside-0/object-tracking-roadside-0",
        "roadside-0/roadside-operator-vehicle-00",
        "vehicle-00/bag-player",
        "vehicle-00/mqtt-bridge",
        "vehicle-00/object-detection-vehicle-00",
        "vehicle-00/uncertainty-operator-roadside-0",
    ]


@pytest.mark.parametrize(
    ("sensor", "agent", "place"),
    [
        ("roadside-0", "roadside-0", "/vehicles/roadside_0"),
        ("vehicle-00", "cloud-0", "/agents/cloud_0/vehicles/vehicle_00"),
    ],
)
def test_results_have_a_name_that_their_agent_may_write(sensor: str, agent: str, place: str) -> None:
    """On the sensor's own agent the sensor's; elsewhere the same below the agent's: the sensor's agent hears it."""
    releases = everything({"object-detection": {"sensor": sensor}}, perceiving=agent)
    by_key = {release.key: release for release in releases.values()}
    detection = by_key[f"{agent}/object-detection-{sensor}"].values["detection"]
    results = [f"{place}/{word}" for word in ("objects", "uncertainty")]
    assert [detection["objects"], detection["uncertainty"]] == results
    bridge = by_key[f"{agent}/mqtt-bridge"].values["bridge"]
    assert [topic["name"] for topic in bridge["out"] if not topic["name"].endswith("/pose")] == results
    clouds = [topic["name"] for topic in bridge["in"] if topic["name"].endswith("/pointcloud")]
    assert clouds == ([] if sensor == agent else ["/vehicles/vehicle_00/lidar_center/pointcloud"])
    hearing = [key.split("/")[0] for key, one in by_key.items() if brought_in(one) & set(results)]
    assert hearing == (["cloud-0"] if sensor == agent else ["vehicle-00"])


@pytest.mark.parametrize(
    ("sensor", "receiver", "topic"),
    [
        ("vehicle-00", "roadside-0", "/agents/cloud_0/vehicles/vehicle_00/objects"),
        ("roadside-0", "vehicle-00", "/vehicles/roadside_0/objects"),
    ],
)
def test_results_go_to_who_is_named(sensor: str, receiver: str, topic: str) -> None:
    parameters = {"sensor": sensor, "receivers": [receiver]}
    where = "cloud-0" if sensor == "vehicle-00" else sensor
    releases = everything({"object-detection": parameters}, perceiving=where).values()
    hearing = {release.key: brought_in(release) for release in releases}
    assert topic in hearing[f"{receiver}/mqtt-bridge"]
    assert hearing[f"{sensor}/mqtt-bridge"] == set()


def brought_in(release: Release) -> set[str]:
    """The topics that a bridge brings in."""
    return {topic["name"] for topic in release.values.get("bridge", {}).get("in", [])}


@pytest.mark.parametrize("receivers", [[], ["vehicle-00"], ["vehicle-00", "cloud-0", "roadside-0"]])
def test_results_of_perception_arrive_where_they_are_wanted(receivers: list[str]) -> None:
    """Under the names that they have where they are made, and once, whoever else wants them."""
    releases = everything({"environment-perception": {"sensor": "roadside-0", "receivers": receivers}})
    results = [f"/vehicles/roadside_0/{word}" for word in ("objects", "tracks")]

    def carried(agent: str, direction: str) -> list[str]:
        values = {release.key: release.values for release in releases.values()}
        topics = [topic["name"] for topic in values[f"{agent}/mqtt-bridge"]["bridge"][direction]]
        return [name for name in topics if name in results]

    assert carried("roadside-0", "out") == carried("cloud-0", "in") == results
    assert carried("vehicle-00", "in") == (results if "vehicle-00" in receivers else [])
    assert carried("roadside-0", "in") == []


def test_composed_detectors_read_their_settings() -> None:
    """What the charts write from these values, the detector takes; operators of a chain name the task above them."""
    tasks = {}
    for release in RELEASES.values():
        if release.chart == "event-detector":
            settings = read_detector_settings({"name": release.key, **release.values["detector"]}, release.key)
            tasks[release.name] = settings.task
    assert tasks["roadside-operator-vehicle-00"] == "cloud-0/roadside-operator"
    assert tasks["uncertainty-operator-roadside-0"] == "cloud-0/uncertainty-operator"
    assert tasks["intersection-operator"] == ""


@pytest.mark.parametrize(
    ("version", "requirement", "expected"),
    [
        ("0.1.0", ">=0.1.0 <0.2.0", True),
        ("0.1.9", ">=0.1.0 <0.2.0", True),
        ("0.2.0", ">=0.1.0 <0.2.0", False),
        ("0.10.0", ">0.9.0", True),
        ("1.0.0-rc.1", ">=1.0.0", False),
        ("1.0.0", "=1.0.0", True),
        ("1.0.0", "<=0.9.9", False),
    ],
)
def test_version_ranges(version: str, requirement: str, expected: bool) -> None:
    assert in_range(version, requirement) is expected


def test_the_highest_allowed_version_is_taken_and_every_candidate_has_its_reason() -> None:
    files = {}
    states = {"0.1.0": "verified", "0.1.1": "staged", "0.1.2": "withdrawn", "0.2.0": "verified"}
    for version, state in states.items():
        document = load(CHARTS[0])
        document["spec"].pop("replaces", None)
        document["spec"]["version"] = version
        document["status"] = {**STATUS, "state": state}
        files[f"charts/{CHARTS[0].parent.name}/{version}.yaml"] = write_mapping(document)
    wanted = ChartRequirement(CHARTS[0].parent.name, ">=0.1.0 <0.2.0")
    selected, reasons = read_catalogue({**files, "policies/release.yaml": "assurance: none\n"}).select(wanted)
    assert selected.version == "0.1.1"
    assert len(reasons) == 4
    strict = read_catalogue(files)  # without a policy: verified only, and only with evidence
    with pytest.raises(RefusalError, match="no valid evidence: its evidence was not assessed"):
        strict.select(wanted)
    chart = CHARTS[0].parent.name
    proven = strict.with_evidence(
        {(chart, "0.1.0"): Assessment(True), (chart, "0.2.0"): Assessment(False, ("forged",))}
    )
    assert proven.select(wanted)[0].version == "0.1.0"
    with pytest.raises(RefusalError, match="no valid evidence: forged"):
        proven.select(replace(wanted, version=">=0.2.0"))
    with pytest.raises(RefusalError, match=r"not in >=3\.0\.0"):
        read_catalogue(files).select(ChartRequirement(CHARTS[0].parent.name, ">=3.0.0"))
