"""What the drawings of a report are made of: the key `drawings` of report.json, bounded in size.

trajectories   where the vehicles that met were, as they were played and as they were stored
ages           pose ages: their distribution, and over time per vehicle
ways           what happened from an event to the first stored cloud, and from its end to the removal
cores          cores over time by component
coverage       recordings: their windows, what they hold and what is missing in them
thinning       fewer values of a series
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from scenarios.definition import Scenario
from scenarios.runner.inputs import RunInputs
from scenarios.runner.judging.encounters import Encounter
from scenarios.runner.reporting.series import ages, cores, coverage, trajectories, ways

Source = Callable[[Scenario, RunInputs, Sequence[Encounter]], Any]
SOURCES: dict[str, Source] = {
    "encounters": ways.encounters,
    "trajectories": trajectories.trajectories,
    "pose_ages": ages.ages,
    "cores": cores.cores,
    "recordings": coverage.recordings,
}


def series(scenario: Scenario, inputs: RunInputs, met: Sequence[Encounter]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """All series by name, and a warning for each that could not be made: none of them loses a report."""
    made = {}
    warnings = []
    for name, source in SOURCES.items():
        try:
            made[name] = source(scenario, inputs, met)
        except Exception as error:  # of odd inputs: the metrics do not need the series
            made[name] = None
            warnings.append(f"series {name} of the drawings: {type(error).__name__}: {error}")
    return made, tuple(warnings)
