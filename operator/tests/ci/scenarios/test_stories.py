"""Every scenario of the folder can be told: its file, its applications, its tasks, its bags and its measures fit."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from ci import publish
from ci.cluster_contract import topology
from ci.installation import platform_values
from robotkube.delivery.tasks.core.task_description import read_task
from scenarios import definition, steps
from scenarios.generator import bags, checking, routes
from scenarios.runner.judging import expectations
from scenarios.runner.playing import acting, policy, readiness
from scenarios.steps import Heard, ReleaseState, State, TaskCount, TaskState
from tests.stages.paths import REPOSITORY

FOLDERS = sorted(path.parent for path in (REPOSITORY / "scenarios").glob("*/scenario.yaml"))
CASES = [(folder, None) for folder in FOLDERS] + [
    (folder, variant)
    for folder in FOLDERS
    for variant in yaml.safe_load((folder / "scenario.yaml").read_text()).get("variants", {})
]
QUICK = ("points=4000", "pose_hz=10", "point_cloud_hz=2")


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0].name}-{case[1] or 'as-written'}")
def scenario(request: pytest.FixtureRequest) -> definition.Scenario:
    folder, variant = request.param
    return definition.load(folder, [], variant)


def application(name: str) -> dict[str, object]:
    document = yaml.safe_load((REPOSITORY / "registry" / "applications" / f"{name}.yaml").read_text())
    return dict(document["spec"])


def test_the_stories_of_the_paper_are_there() -> None:
    assert {folder.name for folder in FOLDERS} == {
        "pose-point-cloud-db-recording",
        "three-vehicles",
        "intersection-support",
        "resource-conflict",
    }


def test_a_scenario_is_named_as_its_folder_and_found_by_name(scenario: definition.Scenario) -> None:
    assert scenario.folder.name == scenario.name
    assert definition.find(scenario.name) == scenario.folder
    assert definition.find(str(scenario.folder)) == scenario.folder


def test_what_the_person_asks_for_is_in_the_registry(scenario: definition.Scenario) -> None:
    for addition in policy.wanted(scenario):
        schema = application(addition["application"])["parameters"]
        assert set(addition.get("parameters", {})) <= set(schema.get("properties", {}))  # type: ignore[attr-defined]


def test_tasks_of_steps_can_be_read_and_fit_their_application(scenario: definition.Scenario) -> None:
    for step in scenario.steps:
        if step.action == "submit":
            description = read_task(acting.task(step.given) | {"status": {}})
            jsonschema.validate(dict(description.parameters), application(description.application)["parameters"])  # type: ignore[arg-type]


def test_steps_name_agents_and_tasks_that_are_there(scenario: definition.Scenario) -> None:
    agents = {node.agent for node in scenario.nodes}
    submitted = {f"{one.given['namespace']}/{one.given['name']}" for one in scenario.steps if one.action == "submit"}
    for step in scenario.steps:
        for state in (*step.when, *step.until):
            if isinstance(state, TaskState):
                assert state.task in submitted
            assert _place(state) in agents
        if step.action == "delete":
            assert step.given in submitted


def _place(state: State) -> str:
    """The agent that a state is about."""
    if isinstance(state, TaskCount):
        return state.namespace
    if isinstance(state, Heard):
        return state.agent
    return (state.task if isinstance(state, TaskState) else state.release).split("/")[0]


def test_charts_and_machines_are_there(scenario: definition.Scenario) -> None:
    for chart in scenario.extra_charts:
        name, _, version = chart.partition("@")
        assert (REPOSITORY / "charts" / ("earlier" if version else "apps") / name / "Chart.yaml").is_file()
    wanted = topology.read(scenario.folder / "scenario.yaml", {"vehicles": str(scenario.parameters.vehicles)})
    assert [node.name for node in wanted.nodes] == [node.name for node in scenario.nodes]
    references = dict.fromkeys(("platform", "suites", "ros", "mosquitto", "gitea", "ferretdb"), "x")
    claims = {agent["name"]: agent.get("claims") for agent in platform_values(references, wanted)["agents"]}
    assert all(claims[player] for player in scenario.players)


def test_releases_that_a_run_begins_with_are_the_players_and_operators(scenario: definition.Scenario) -> None:
    needed = readiness.Readiness(None, None, scenario)._needed()  # type: ignore[arg-type]
    players = {f"{agent}/bag-player" for agent in scenario.players}
    assert players <= set(needed)
    assert ("cloud-0/event-detector" in needed) == scenario.records


def test_a_run_waits_for_the_plan_that_gives_the_operator_its_rule(scenario: definition.Scenario) -> None:
    """After another scenario on the same cluster the operator is there already, with that one's rule."""

    def detector(agents: list[str]) -> dict[str, Any]:
        parameters = scenario.parameters
        rule = {
            "agents": agents,
            "start_distance_m": parameters.start_distance_m,
            "stop_distance_m": parameters.stop_distance_m,
        }
        return {"cloud-0/event-detector": {"spec": {"values": {"detector": {"rules": [rule]}}}}}

    ready = readiness.Readiness(None, None, scenario)  # type: ignore[arg-type]
    vehicles = list(scenario.lidar_vehicles)
    assert not ready._with_another_rule(detector(vehicles) if scenario.records else {})
    assert bool(ready._with_another_rule(detector([*vehicles, "vehicle-99"]))) == scenario.records


def test_every_expectation_has_a_measure_and_a_place_in_the_reference() -> None:
    schema = json.loads(definition.SCHEMA.read_text())
    [pattern] = schema["properties"]["expectations"]["patternProperties"]
    assert set(re.sub(r"[\^()$]", "", pattern).split("|")) == set(expectations.MEASURES)
    page = (REPOSITORY / "docs" / "reference" / "report.md").read_text()
    assert [name for name in expectations.MEASURES if f"`{name}`" not in page] == []


def test_bags_are_made_for_all_players_and_are_sound(tmp_path: Path) -> None:
    scenario = definition.load(definition.find("three-vehicles"), QUICK)
    made = bags.make_bags(scenario, tmp_path, lambda _: None)
    assert tuple(made) == scenario.players
    assert routes.duration_seconds(scenario.parameters) > 30
    for agent, folder in made.items():
        checking.check_bag(folder, scenario, agent)
    topics = yaml.safe_load((made[scenario.lidar_agents[0]] / "metadata.yaml").read_text())
    names = [
        entry["topic_metadata"]["name"] for entry in topics["rosbag2_bagfile_information"]["topics_with_message_count"]
    ]
    assert definition.cloud_topic(scenario.lidar_agents[0]) in names


def test_a_story_without_players_says_what_a_run_needs_all_the_same() -> None:
    scenario = definition.load(definition.find("resource-conflict"))
    assert scenario.players == scenario.lidar_agents == ()
    assert not scenario.records
    assert policy.changed("add: []\n", scenario) is None


def test_base_charts_are_published_anyway() -> None:
    assert not set(publish.BASE) & {chart for folder in FOLDERS for chart in definition.load(folder).extra_charts}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([{"name": "x", "do": {"explode": True}}], r"story\.steps\.0\.do"),
        ([{"name": "x", "do": {"kill": "broker"}}], r"story\.steps\.0\.do\.kill: 'broker' is not one of"),
        ([{"name": "x", "until": [{"release": "a", "is": "main"}]}], r"story\.steps\.0\.until\.0"),
        ([{"until": [{"release": "a/b", "is": "main"}]}], r"'name' is a required property"),
        ([], r"story\.steps: \[\] should be non-empty"),
    ],
)
def test_steps_that_cannot_be_done_are_refused(given: list[object], message: str, tmp_path: Path) -> None:
    document = yaml.safe_load((definition.find("resource-conflict") / "scenario.yaml").read_text())
    document["story"]["steps"] = given
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(definition.ScenarioError, match=message):
        definition.load(tmp_path)


def test_steps_are_read_with_their_states() -> None:
    [step] = steps.read_steps(
        [
            {
                "name": "all",
                "when": [{"tasks": "cloud-0", "at_least": 1}],
                "do": {"stop": "edge-0"},
                "until": [{"task": "a/b", "reason": "Postponed"}, {"release": "a/c", "is": "absent"}],
                "seconds": 5,
            }
        ]
    )
    assert (step.action, step.given, step.seconds) == ("stop", "edge-0", 5)
    assert step.when == (TaskCount("cloud-0", 1),)
    assert step.until == (TaskState("a/b", reason="Postponed"), ReleaseState("a/c", "absent"))
    assert [str(state) for state in (*step.when, *step.until)] == [
        "1 accepted tasks in cloud-0",
        "task a/b: Accepted=any Postponed",
        "release a/c absent",
    ]
