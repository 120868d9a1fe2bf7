"""The times at which agents of a scenario are in holes of coverage: those by time as they stand, those by place from
the routes.

Times in s since the players' start.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from scenarios.definition import Scenario, ScenarioError
from scenarios.generator import routes
from scenarios.network import PlaceHole, TimeHole

STEP_SECONDS = 0.05
HOLE_SECONDS_MIN = 0.1  # a shorter one is no hole in the coverage of anything that drives


@dataclass(frozen=True, order=True)
class CoverageHole:
    """A hole that an agent is in."""

    at_seconds: float
    seconds: float
    agent: str


def coverage_holes(scenario: Scenario) -> tuple[CoverageHole, ...]:
    """Every hole of a run in the order of time, those of one agent that overlap as one. ScenarioError for a hole that
    no run would show."""
    holes_of = {agent: list(_holes(scenario, agent)) for agent in scenario.network}
    for place in {hole for cable in scenario.network.values() for hole in cable.holes if isinstance(hole, PlaceHole)}:
        if not any(one == place for holes in holes_of.values() for one, _ in holes):
            raise _problem(
                scenario,
                f"nobody who has a hole there comes within {place.radius_m:g} m of ({place.x_m:g}, {place.y_m:g}); "
                "name a place on their way",
            )
    return tuple(sorted(one for agent in holes_of for one in _joined(agent, [hole for _, hole in holes_of[agent]])))


def _problem(scenario: Scenario, text: str) -> ScenarioError:
    return ScenarioError(f"{scenario.folder / 'scenario.yaml'}: network: {text}")


def _holes(scenario: Scenario, agent: str) -> Iterator[tuple[TimeHole | PlaceHole, TimeHole]]:
    """Each hole as it stands, with when the agent is in it."""
    end = routes.duration_seconds(scenario.parameters) if scenario.players else None
    for hole in scenario.network[agent].holes:
        if isinstance(hole, PlaceHole):
            yield from ((hole, one) for one in _at_place(scenario, agent, hole))
        elif end is not None and hole.at_seconds + hole.seconds > end:
            raise _problem(
                scenario,
                f"the hole of {agent} at {hole.at_seconds:g} s for {hole.seconds:g} s ends after the run, which lasts "
                f"{end} s; let it begin earlier",
            )
        else:
            yield hole, hole


def _at_place(scenario: Scenario, agent: str, hole: PlaceHole) -> Iterator[TimeHole]:
    if agent not in scenario.players:
        raise _problem(
            scenario, f"{agent} does not drive, so it comes to no place; give its holes at_seconds and seconds"
        )
    times = np.arange(0.0, routes.duration_seconds(scenario.parameters), STEP_SECONDS)
    path = routes.motion(scenario.parameters, scenario.players.index(agent), times)
    within = np.hypot(path.x - hole.x_m, path.y - hole.y_m) <= hole.radius_m
    edges = np.flatnonzero(np.diff(np.concatenate(([False], within, [False])).astype(int)))
    for begin, end in edges.reshape(-1, 2):
        seconds = float(end - begin) * STEP_SECONDS
        if seconds >= HOLE_SECONDS_MIN:
            yield TimeHole(round(float(begin) * STEP_SECONDS, 3), round(seconds, 3))


def _joined(agent: str, holes: Sequence[TimeHole]) -> list[CoverageHole]:
    joined: list[CoverageHole] = []
    for hole in sorted(holes, key=lambda one: one.at_seconds):
        last = joined[-1] if joined else None
        if last is None or hole.at_seconds > last.at_seconds + last.seconds:
            joined.append(CoverageHole(hole.at_seconds, hole.seconds, agent))
        else:
            end = max(last.at_seconds + last.seconds, hole.at_seconds + hole.seconds)
            joined[-1] = CoverageHole(last.at_seconds, end - last.at_seconds, agent)
    return joined
