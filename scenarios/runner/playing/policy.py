"""The initial configuration that the person asks for: players on the vehicles, the operator's rule with the scenario's
distances, and what the story adds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from scenarios.definition import Scenario

PATH = "policies/initial.yaml"
OPERATOR = "proximity-operator"


def wanted(scenario: Scenario) -> list[dict[str, Any]]:
    """The additions to the initial configuration that the scenario needs."""
    additions: list[dict[str, Any]] = []
    if scenario.story.player_application:
        additions.append({"application": scenario.story.player_application, "forRole": "vehicle"})
    if scenario.records:
        additions.append(_operator(scenario))
    return additions + [dict(entry) for entry in scenario.story.policies]


def _operator(scenario: Scenario) -> dict[str, Any]:
    """The operator that watches the vehicles, with the scenario's distances."""
    parameters = scenario.parameters
    rule = {
        "agents": list(scenario.lidar_vehicles),
        "application": scenario.story.application,
        "start_distance_m": parameters.start_distance_m,
        "stop_distance_m": parameters.stop_distance_m,
    }
    return {"application": OPERATOR, "agents": [scenario.story.recording_agent], "parameters": rule}


def changed(text: str, scenario: Scenario) -> str | None:
    """The file with the scenario's additions, what others added kept; None when it says so already."""
    document: Mapping[str, Any] = yaml.safe_load(text) or {}
    additions = wanted(scenario)
    mine = {addition["application"] for addition in additions}
    present = list(document.get("add") or [])
    kept = [addition for addition in present if addition.get("application") not in mine]
    if [addition for addition in present if addition.get("application") in mine] == additions:
        return None
    return yaml.safe_dump(dict(document) | {"add": kept + additions}, sort_keys=True)
