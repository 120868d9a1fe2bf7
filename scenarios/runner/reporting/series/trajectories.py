"""Trajectories of the vehicles that met: the route that was played, and the poses that were stored, both thinned.

A bag's poses are those of the scenario's routes at their stamps, so the routes say where a player was; the stored poses
say what of it arrived.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from scenarios.definition import Scenario, pose_topic
from scenarios.generator import routes
from scenarios.generator.drives import Floats
from scenarios.runner.inputs import NANOSECONDS, RunInputs, Stored
from scenarios.runner.judging.encounters import Encounter
from scenarios.runner.reporting.series.thinning import HERTZ, every

AGENTS_MAX = 6
SAMPLES_MAX = 3000
DIGITS = 2


def trajectories(scenario: Scenario, inputs: RunInputs, met: Sequence[Encounter]) -> dict[str, Any] | None:
    """Positions in m by agent, times in s since the start; None when nothing was played. Without an encounter: of the
    lidar's vehicles and road-side units."""
    if not scenario.players:
        return None
    agents = [agent for agent in _partaking(scenario, met) if agent in scenario.players][:AGENTS_MAX]
    seconds = min(routes.duration_seconds(scenario.parameters), (inputs.ended - inputs.started) / NANOSECONDS)
    times = np.arange(0, min(SAMPLES_MAX, int(seconds * HERTZ) + 1), dtype=np.float64) / HERTZ
    return {
        "seconds": times.tolist(),
        "agents": {
            agent: _played(scenario, agent, times) | {"stored": _stored(inputs, met, agent)} for agent in agents
        },
    }


def _partaking(scenario: Scenario, met: Sequence[Encounter]) -> Sequence[str]:
    return sorted({agent for one in met for agent in one.agents}) or scenario.lidar_agents


def _played(scenario: Scenario, agent: str, times: Floats) -> dict[str, Any]:
    motion = routes.motion(scenario.parameters, scenario.players.index(agent), times)
    return {"x_m": np.round(motion.x, DIGITS).tolist(), "y_m": np.round(motion.y, DIGITS).tolist()}


def _stored(inputs: RunInputs, met: Sequence[Encounter], agent: str) -> dict[str, Any]:
    """Poses read back from the database, by their stamps."""
    topic = pose_topic(agent)
    poses = sorted(
        {(one.stamp, one.position) for meeting in met for one in meeting.stored if _placed(one, topic)},
        key=lambda pose: pose[0],
    )
    chosen = list(every(poses, lambda pose: pose[0], NANOSECONDS // HERTZ))[:SAMPLES_MAX]
    return {
        "seconds": [(stamp - inputs.started) / NANOSECONDS for stamp, _ in chosen],
        "x_m": [round(position[0], DIGITS) for _, position in chosen if position],
        "y_m": [round(position[1], DIGITS) for _, position in chosen if position],
    }


def _placed(message: Stored, topic: str) -> bool:
    return message.topic == topic and message.position is not None
