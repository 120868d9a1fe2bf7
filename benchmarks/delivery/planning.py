"""What a plan costs as the fleet grows: composing and planning for 150 vehicles against 15, per vehicle."""

from __future__ import annotations

from collections.abc import Mapping

import yaml

from benchmarks.measuring.comparisons import Comparison, seconds
from ci.folders import PROJECT
from robotkube.delivery.deployment.core.policies.initial import InitialPolicy
from robotkube.delivery.deployment.core.releases import Tree, read_tree
from robotkube.delivery.manager.core.composition.composer import Demand, Inputs, compose
from robotkube.delivery.manager.core.composition.initial_demands import initial_demands
from robotkube.delivery.manager.core.placement.placement import Agent, Fleet, NodeState, fleet
from robotkube.delivery.manager.core.plans import Plan, differences, make_plan
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.registry.catalogue.core.catalogue import Catalogue, read_catalogue

REGISTRY = PROJECT / "registry"
CHARTS = "oci://forge.example/staging"
FEW, MANY = 15, 150
REPETITIONS = 5
RATIO_MAX = 3.0  # 1 is linear, 10 would be quadratic


def catalogue() -> Catalogue:
    """The project's own catalogue, as the publisher writes it."""
    files = {str(path.relative_to(REGISTRY)): path.read_text() for path in REGISTRY.glob("applications/*.yaml")}
    for path in REGISTRY.glob("charts/*/*.yaml"):
        document = yaml.safe_load(path.read_text())
        document["status"] = {"state": "staged", "digest": f"sha256:{'0' * 64}", "images": []}
        files[str(path.relative_to(REGISTRY))] = yaml.safe_dump(document)
    return read_catalogue({**files, "policies/release.yaml": "assurance: none\n"})


def fleet_of(vehicles: int) -> Fleet:
    """One cloud machine that records, and vehicles."""
    machines = [("cloud-0", "cloud"), *((f"vehicle-{number:02d}", "vehicle") for number in range(vehicles))]
    nodes = [
        NodeState(name, name, role, frozenset({"recording"} if role == "cloud" else ()), True)
        for name, role in machines
    ]
    return fleet([Agent(name, role, name) for name, role in machines], nodes)


def meeting() -> TaskDescription:
    """The task of two vehicles that are near each other."""
    return TaskDescription(
        namespace="cloud-0",
        name="meeting",
        generation=1,
        created="2026-11-21T10:00:00Z",
        requester="cloud-0/event-detector",
        rule="lidar-proximity",
        event="e1",
        trace="a" * 32,
        reason="vehicle-00, vehicle-01 within 400 m",
        application="pose-point-cloud-recording",
        parameters={"vehicles": ["vehicle-00", "vehicle-01"]},
    )


def plan(known: Catalogue, machines: Fleet, tree: Tree, tasks: Mapping[str, TaskDescription]) -> Plan:
    """What the manager computes when a task comes: everything desired, and the plan that leads there from `tree`."""
    wanted = initial_demands(known, InitialPolicy(), machines)
    wanted += [Demand(task.key, task.application, task.parameters, task=task) for task in tasks.values()]
    desired = compose(wanted, Inputs(known, machines, dict(tree.releases), Jinja2Templates().render, validate))
    changes = differences(desired.releases, tree.releases)
    return make_plan(changes, tree, desired, tasks, known, CHARTS, "b" * 40, "20261121-100000")


def cost(vehicles: int) -> float:
    """Milliseconds of the plan for one task on a fleet that has its initial configuration."""
    known = catalogue()
    machines = fleet_of(vehicles)
    task = meeting()
    first = plan(known, machines, read_tree({}), {})
    tree = read_tree({path: text for path, text in first.files.items() if text is not None})
    return seconds(lambda: plan(known, machines, tree, {task.key: task}), REPETITIONS) * 1000


def compare() -> list[Comparison]:
    """Cost per vehicle at MANY against FEW."""
    few, many = cost(FEW), cost(MANY)
    name = f"plan for one task, per vehicle, {MANY} vehicles"
    return [Comparison(name, "ms", many / MANY, few / FEW, RATIO_MAX, f"the same with {FEW} vehicles")]
