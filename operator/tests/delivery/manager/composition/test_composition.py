"""Composition, placement and planning on the real catalogue of registry/: what comes, what goes, what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.commit_messages import read_message, write_message
from robotkube.delivery.deployment.core.policies.initial import InitialPolicy, read_initial_policy
from robotkube.delivery.deployment.core.releases import Release, Tree, read_tree
from robotkube.delivery.manager.core.composition.composer import Composition, Demand, Inputs, Met, Refused, compose
from robotkube.delivery.manager.core.composition.initial_demands import initial_demands
from robotkube.delivery.manager.core.placement.placement import Agent, Fleet, NodeState, fleet
from robotkube.delivery.manager.core.plans import Plan, describe, differences, make_plan
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.registry.catalogue.core.catalogue import Catalogue, read_catalogue
from tests.stages.paths import REGISTRY

CHARTS = "oci://forge.robotkube.svc.cluster.local:3000/staging"
RENDER = Jinja2Templates().render
NOW = "20261121-100000"


def catalogue_files(state: str = "staged", assurance: str = "none") -> dict[str, str]:
    """The registry as the publisher writes it into the catalogue repository."""
    files = {str(p.relative_to(REGISTRY)): p.read_text() for p in REGISTRY.glob("applications/*.yaml")}
    for index, path in enumerate(sorted(REGISTRY.glob("charts/*/*.yaml"))):
        document = yaml.load(path.read_text(), yaml.CSafeLoader)
        document["status"] = {"state": state, "digest": f"sha256:{index:064x}", "images": []}
        files[str(path.relative_to(REGISTRY))] = yaml.dump(document, Dumper=yaml.CSafeDumper)
    return {**files, "policies/release.yaml": f"assurance: {assurance}\n"}


CATALOGUE = read_catalogue(catalogue_files())
STRICT = read_catalogue(catalogue_files(assurance="verified"))
WITHDRAWN = read_catalogue(catalogue_files(state="withdrawn"))
NO_CAPABILITY: dict[str, Any] = {"capabilities": frozenset()}


def make_fleet(vehicles: int = 3, clouds: int = 1, **changes: Any) -> Fleet:
    names = [(f"vehicle-{i:02d}", "vehicle") for i in range(vehicles)] + [
        (f"cloud-{i}", "cloud") for i in range(clouds)
    ]
    agents = [Agent(name, role, name) for name, role in names]
    nodes = [
        replace(
            NodeState(name, name, role, frozenset({"recording"} if role == "cloud" else ()), True),
            **changes.get(name.replace("-", "_"), {}),
        )
        for name, role in names
    ]
    return fleet(agents, [n for n in nodes if n.name not in changes.get("without", ())])


def watched(composition: Composition) -> list[Any]:
    """The agents that the cloud's detector compares, a list for each of its rules."""
    release = composition.releases["releases/cloud-0/event-detector.yaml"]
    return [rule["agents"] for rule in release.values["detector"]["rules"]]


def lidars(*agents: str) -> dict[str, Any]:
    return {agent.replace("-", "_"): {"capabilities": frozenset({"lidar"})} for agent in agents}


def test_the_detector_compares_the_vehicles_that_have_a_lidar() -> None:
    """The catalogue names no vehicle; with one lidar there is no pair, so there is no rule."""
    by_fleet = [
        (lidars("vehicle-00"), []),
        (lidars("vehicle-01", "vehicle-02"), [["vehicle-01", "vehicle-02"]]),
        (lidars("vehicle-00", "vehicle-01", "vehicle-02"), [["vehicle-00", "vehicle-01", "vehicle-02"]]),
    ]
    for changes, expected in by_fleet:
        known = make_fleet(**changes)
        demands = initial_demands(CATALOGUE, InitialPolicy(), known)
        composition = compose(demands, Inputs(CATALOGUE, known, {}, RENDER, validate))
        assert watched(composition) == expected
        assert all(isinstance(outcome, Met) for outcome in composition.outcomes.values())


def task(
    name: str = "meeting", vehicles: Sequence[str] = ("vehicle-00", "vehicle-01"), **changes: Any
) -> TaskDescription:
    description = TaskDescription(
        "cloud-0",
        name,
        1,
        "2026-11-21T10:00:00Z",
        "cloud-0/event-detector",
        "lidar-proximity",
        f"event-{name}",
        "a" * 32,
        "vehicle-00, vehicle-01 within 400 m",
        "pose-point-cloud-recording",
        {"vehicles": list(vehicles)},
    )
    return replace(description, **changes)


def recording_of(composition: Composition, vehicle: str) -> dict[str, Any]:
    """The recording reaction of a vehicle's recorder."""
    release = composition.releases[f"releases/cloud-0/recorder-{vehicle}.yaml"]
    [reaction] = release.values["detector"]["reactions"]
    return dict(reaction)


def test_tasks_of_one_name_in_two_namespaces_have_a_recording_each() -> None:
    """Both were Ready, and shared one recording whose provenance named the first alone."""
    same = task("atk-same", ["vehicle-00"]), task("atk-same", ["vehicle-01"], namespace="vehicle-01")
    composition = compute(same)
    assert all(isinstance(outcome, Met) for outcome in composition.outcomes.values())
    first, second = (recording_of(composition, vehicle) for vehicle in ("vehicle-00", "vehicle-01"))
    assert (first["recording"], second["recording"]) == ("cloud-0.atk-same", "vehicle-01.atk-same")
    assert (first["provenance"]["task"], second["provenance"]["task"]) == ("cloud-0/atk-same", "vehicle-01/atk-same")


def demand(description: TaskDescription) -> Demand:
    return Demand(description.key, description.application, description.parameters, task=description)


def compute(
    tasks: Sequence[TaskDescription] = (),
    present: dict[str, Release] | None = None,
    catalogue: Catalogue = CATALOGUE,
    on: Fleet | None = None,
    policy: InitialPolicy | None = None,
) -> Composition:
    on = on or make_fleet()
    demands = initial_demands(catalogue, policy or InitialPolicy(), on) + [demand(t) for t in tasks]
    return compose(demands, Inputs(catalogue, on, present or {}, RENDER, validate))


def plan(tasks: Sequence[TaskDescription], tree: Tree, **options: Any) -> tuple[Plan | None, Composition]:
    desired = compute(tasks, dict(tree.releases), **options)
    changes = differences(desired.releases, tree.releases)
    if not changes:
        return None, desired
    named = {t.key: t for t in tasks}
    catalogue = options.get("catalogue", CATALOGUE)
    made = make_plan(changes, tree, desired, named, catalogue, CHARTS, "b" * 40, NOW)
    assert describe(made, desired, named, catalogue, ("static",))
    return made, desired


def apply(files: dict[str, str], made: Plan | None) -> dict[str, str]:
    changes = made.files if made else {}
    return {path: text for path, text in {**files, **changes}.items() if text is not None}


def settle(tasks: Sequence[TaskDescription], files: dict[str, str], **options: Any) -> dict[str, str]:
    """Files after planning and applying; planning again finds nothing, and the tree is sound."""
    made, _ = plan(tasks, read_tree(files), **options)
    after = apply(files, made)
    tree = read_tree(after)
    assert tree.problems == ()
    assert plan(tasks, tree, **options)[0] is None
    if made:
        assert read_message(write_message(made.message.signed("manager", 1))).plan == made.id
    return after


def test_initial_configuration_of_three_vehicles() -> None:
    desired = compute()
    assert sorted(r.key for r in desired.releases.values()) == [
        "cloud-0/event-detector", "cloud-0/mqtt-bridge",
        "vehicle-00/mqtt-bridge", "vehicle-01/mqtt-bridge", "vehicle-02/mqtt-bridge",
    ]  # fmt: skip
    cloud = desired.releases["releases/cloud-0/mqtt-bridge.yaml"]
    assert [t["name"] for t in cloud.values["bridge"]["in"]] == [f"/vehicles/vehicle_0{i}/pose" for i in range(3)]
    assert cloud.values["bridge"]["out"] == []
    assert cloud.values["placement"] == {"agent": "cloud-0"}
    made, _ = plan((), Tree({}, {}))
    assert made is not None
    assert made.message.initial
    assert made.message.causes == ()
    assert made.title == "deploy(initial): 5 releases"


def test_a_task_adds_a_recorder_and_extends_three_bridges() -> None:
    before = settle((), {})
    made, desired = plan([task()], read_tree(before))
    assert made is not None
    assert [(c.kind, c.release.key) for c in made.changes] == [
        ("change", "cloud-0/mqtt-bridge"), ("add", "cloud-0/recorder-vehicle-00-vehicle-01"),
        ("change", "vehicle-00/mqtt-bridge"), ("change", "vehicle-01/mqtt-bridge"),
    ]  # fmt: skip
    assert made.title == "deploy(recording): vehicle-00, vehicle-01 within 400 m"
    assert not made.message.initial
    assert {c.name for c in made.message.charts} == {"event-detector", "mqtt-bridge"}
    out = desired.releases["releases/vehicle-00/mqtt-bridge.yaml"].values["bridge"]["out"]
    assert [t["name"].rsplit("/", 1)[1] for t in out] == ["pointcloud", "transform", "pose"]
    outcome = desired.outcomes["cloud-0/meeting"]
    assert isinstance(outcome, Met)
    assert "cloud-0/recorder-vehicle-00-vehicle-01" in outcome.releases
    recorder = desired.releases["releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml"].values["detector"]
    assert len(recorder["topics"]) == 6
    assert recorder["reactions"][0]["provenance"]["task"] == "cloud-0/meeting"
    release = desired.releases["releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml"]
    chart = f"event-detector@{release.version}@{release.digest}"
    assert recorder["reactions"][0]["provenance"]["chart"] == chart


def without_plans(files: dict[str, str]) -> dict[str, str]:
    return {p: "\n".join(line for line in t.splitlines() if "robotkube.io/plan" not in line) for p, t in files.items()}


def test_withdrawing_returns_to_before_but_for_plans() -> None:
    before = settle((), {})
    during = settle([task()], before)
    made, _ = plan((), read_tree(during))
    assert made is not None
    assert made.message.verb == "withdraw"
    assert [(c.task, c.event, c.rule, c.trace) for c in made.message.causes] == [
        ("cloud-0/meeting", "event-meeting", "lidar-proximity", "a" * 32)
    ]
    assert made.title == "withdraw(recording): cloud-0/meeting"
    assert without_plans(apply(during, made)) == without_plans(before)


def test_two_tasks_share_bridges_and_the_last_one_takes_them_away() -> None:
    before = settle((), {})
    first, second = task("a"), task("b", ("vehicle-00", "vehicle-02"))
    both = settle([first, second], settle([first], before))
    bridge = read_tree(both).releases["releases/vehicle-00/mqtt-bridge.yaml"]
    assert [c.task for c in bridge.causes] == ["cloud-0/a", "cloud-0/b"]
    assert len(bridge.values["bridge"]["out"]) == 3
    assert without_plans(settle([second], both)) == without_plans(settle([second], before))


def test_equal_tasks_share_a_recorder() -> None:
    one = settle([task("a")], {})
    two = settle([task("a"), task("b")], one)
    recorder = "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml"
    assert [c.task for c in read_tree(two).releases[recorder].causes] == ["cloud-0/a", "cloud-0/b"]
    assert read_tree(two).releases[recorder].values == read_tree(one).releases[recorder].values


def outcome_of(description: TaskDescription, **options: Any) -> Refused:
    desired = compute([description], **options)
    outcome = desired.outcomes[description.key]
    assert isinstance(outcome, Refused)
    assert desired.releases == compute(**options).releases  # a refused demand leaves no trace
    return outcome


@pytest.mark.parametrize(
    ("description", "options", "reason", "text"),
    [
        (task(application="nothing"), {}, "UnknownApplication", "'nothing'"),
        (task(parameters={}), {}, "InvalidParameters", "'vehicles' is a required property"),
        (task(parameters={"vehicles": ["vehicle-00"], "x": 1}), {}, "InvalidParameters", "'x' was unexpected"),
        (
            task(vehicles=["vehicle-09"]),
            {},
            "NoCapableNode",
            "agent 'vehicle-09' is not declared; name one that is (cloud-0, vehicle-00, vehicle-01, vehicle-02), or "
            "declare it (values `agents` of the chart robotkube)",
        ),
        (task(), {"on": make_fleet(without=("vehicle-01",))}, "NoCapableNode", "'vehicle-01' has no Node"),
        (task(), {"on": make_fleet(cloud_0={"ready": False})}, "NoCapableNode", "no Node is Ready"),
        (task(), {"on": make_fleet(cloud_0=NO_CAPABILITY)}, "NoCapableNode", "lacks capability recording"),
        (task(), {"catalogue": STRICT}, "NoVerifiedVersion", "state staged is not allowed"),
        (task(), {"catalogue": WITHDRAWN}, "NoVerifiedVersion", "state withdrawn"),
    ],
)  # fmt: skip
def test_refusals(description: TaskDescription, options: dict[str, Any], reason: str, text: str) -> None:
    outcome = outcome_of(description, **options)
    assert outcome.reason == reason
    assert text in outcome.message


def changed_application(old: str, new: str, name: str = "pose-point-cloud-recording") -> Catalogue:
    files = catalogue_files()
    path = f"applications/{name}.yaml"
    assert old in files[path]
    return read_catalogue({**files, path: files[path].replace(old, new)})


@pytest.mark.parametrize(
    ("old", "new", "reason", "text"),
    [
        (
            "type: geometry_msgs/msg/PoseStamped\n      channel",
            "type: nav_msgs/msg/Odometry\n      channel",
            "LinkMismatch",
            "nav_msgs/msg/Odometry",
        ),
        ("task.trace", "task.nothing", "CompositionFailed", "has no attribute 'nothing'"),
        ('release: "recorder-{{', 'release: "Recorder {{', "CompositionFailed", "release name"),
    ],
)
def test_compositions_that_fail(old: str, new: str, reason: str, text: str) -> None:
    outcome = outcome_of(task(), catalogue=changed_application(old, new))
    assert outcome.reason == reason
    assert text in outcome.message


def test_without_a_bridge_nothing_with_links_is_composed() -> None:
    files = {p: t for p, t in catalogue_files().items() if "mqtt-bridge.yaml" not in p}
    desired = compute([task()], catalogue=read_catalogue(files))
    assert desired.releases == {}
    assert desired.outcomes["cloud-0/meeting"].reason == "CompositionFailed"  # type: ignore[union-attr]


def test_a_placed_recorder_stays_and_a_new_one_goes_to_the_emptiest_cloud() -> None:
    two = make_fleet(clouds=2)
    first = compute([task("a")], on=two)
    assert "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml" in first.releases
    moved = {
        "releases/cloud-1/recorder-vehicle-00-vehicle-01.yaml": replace(
            first.releases["releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml"], namespace="cloud-1"
        )
    }
    again = compute([task("a")], present=moved, on=make_fleet(clouds=2, cloud_1={"ready": False}))
    assert "releases/cloud-1/recorder-vehicle-00-vehicle-01.yaml" in again.releases
    both = compute([task("a"), task("b", ("vehicle-00", "vehicle-02"))], on=two)
    assert "releases/cloud-1/recorder-vehicle-00-vehicle-02.yaml" in both.releases


def test_people_add_and_remove() -> None:
    policy = read_initial_policy(
        "add:\n- {application: bag-player, forRole: vehicle, parameters: {claim: run}}\n"
        "- {application: bag-player, agents: [vehicle-01, vehicle-77]}\n"
        "remove:\n- {application: proximity-operator, agents: [cloud-0]}\n"
    )
    releases = compute(policy=policy).releases
    assert "releases/cloud-0/event-detector.yaml" not in releases
    assert releases["releases/vehicle-00/bag-player.yaml"].values["bags"] == {"claim": "run"}
    assert releases["releases/vehicle-01/bag-player.yaml"].values["bags"] == {"claim": "bags"}
    assert read_initial_policy("add: []\nremove: []\n") == InitialPolicy()


def test_a_new_chart_version_changes_its_releases_for_the_configuration() -> None:
    before = settle((), {})
    files = catalogue_files()
    newer = (
        files["charts/mqtt-bridge/0.2.3.yaml"]
        .replace("version: 0.2.3", "version: 0.2.4")
        .replace("sha256:0000", "sha256:1111")
    )
    catalogue = read_catalogue({**files, "charts/mqtt-bridge/0.2.4.yaml": newer})
    assert catalogue.problems == ()
    made, _ = plan((), read_tree(before), catalogue=catalogue)
    assert made is not None
    assert len(made.changes) == 4
    assert made.message.initial
    assert settle((), before, catalogue=catalogue) != before


def test_broken_catalogue_files_are_named_and_the_rest_stays() -> None:
    files = {
        **catalogue_files(),
        "applications/broken.yaml": "kind: Application\n",
        "charts/mqtt-bridge/0.3.0.yaml": "a: [",
    }
    catalogue = read_catalogue(files)
    assert set(CATALOGUE.applications) == set(catalogue.applications)
    assert {p.split(":")[0] for p in catalogue.problems} == {
        "applications/broken.yaml",
        "charts/mqtt-bridge/0.3.0.yaml",
    }


vehicles = st.lists(st.sampled_from([f"vehicle-0{i}" for i in range(4)]), min_size=1, max_size=3, unique=True)
task_sets = st.dictionaries(st.sampled_from("abcd"), vehicles, max_size=4)


@given(st.lists(task_sets, min_size=1, max_size=4))
def test_any_history_ends_where_its_last_demands_lead(history: list[dict[str, list[str]]]) -> None:
    options = {"on": make_fleet(4, 2)}
    files: dict[str, str] = {}
    for step in history:
        files = settle([task(name, listed) for name, listed in step.items()], files, **options)
        for release in read_tree(files).releases.values():
            topics = [t["name"] for d in ("in", "out") for t in release.values.get("bridge", {}).get(d, [])]
            assert len(topics) == len(set(topics))
    emptied = settle((), files, **options)
    assert without_plans(emptied) == without_plans(settle((), {}, **options))


@given(task_sets, st.randoms(use_true_random=False))
def test_the_order_of_tasks_decides_whose_words_stand_in_a_shared_release_and_nothing_else(
    vehicles_by_task: dict[str, list[str]], random: Any
) -> None:
    tasks = [task(name, listed) for name, listed in vehicles_by_task.items()]
    shuffled = list(tasks)
    random.shuffle(shuffled)
    first, second = compute(tasks, on=make_fleet(4)), compute(shuffled, on=make_fleet(4))
    assert {p: r.causes for p, r in first.releases.items()} == {p: r.causes for p, r in second.releases.items()}
    assert {p: r.values.get("bridge") for p, r in first.releases.items()} == {
        p: r.values.get("bridge") for p, r in second.releases.items()
    }
    assert all(isinstance(second.outcomes[vehicles_by_task.key], Met) for vehicles_by_task in tasks)
