"""Driving on after a run: the players go round once more, and again, so that there is something to try things on.

Nobody measures these laps and no ledger is kept of them. They end after the given time, with `KEEP_DRIVING=0`, and
before the next run on the same cluster.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

from scenarios.definition import Scenario
from scenarios.generator import routes
from scenarios.runner.platform.access import Access
from scenarios.runner.waiting import wait_for

NANOSECONDS = 1_000_000_000
START_DELAY_SECONDS = 3
PAUSE_SECONDS = 2  # between two laps, so that the last messages of one are out before the next begins
LAPS_MIN = 2
PARTED_SECONDS_MAX = 180  # an event ends 60 s after its agents' last pose at the latest; its releases go after that
POLL_SECONDS = 1.0
MINUTES_MAX = 1440


def minutes(text: str) -> float:
    """A time in minutes on a command line, from 0 to a day."""
    try:
        number = float(text)
    except ValueError:
        number = -1
    if not 0 <= number <= MINUTES_MAX:
        raise argparse.ArgumentTypeError(f"{text!r} must be minutes from 0 to {MINUTES_MAX}; 0 ends the driving")
    return number


def laps(scenario: Scenario, length: float) -> tuple[int, int]:
    """The number of laps that fill `length` minutes, and the seconds from one to the next."""
    seconds = routes.duration_seconds(scenario.parameters) + PAUSE_SECONDS
    return max(LAPS_MIN, round(length * 60 / seconds)), seconds


def drive(access: Access, scenario: Scenario, length: float, progress: Callable[[str], None]) -> None:
    """Let all players of the scenario go round for about `length` minutes; 0 lets them stand."""
    if not scenario.players or not length:
        stop(access, scenario, progress)
        return
    count, seconds = laps(scenario, length)
    start = (time.time_ns() // NANOSECONDS + 1 + START_DELAY_SECONDS) * NANOSECONDS
    name = f"drive-{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}"
    for agent in scenario.players:
        access.put_simulation(agent, name, start, count, seconds * NANOSECONDS)
    until = time.strftime("%H:%M", time.gmtime(start / NANOSECONDS + count * seconds))
    progress(
        f"{len(scenario.players)} players go on driving until {until} UTC ({count} laps of {seconds} s), so that there "
        "is something to try on; `make drive KEEP_DRIVING=0` ends them, `make drive` sends them round again"
    )


def stop(access: Access, scenario: Scenario, progress: Callable[[str], None]) -> None:
    """End the driving when the event that lasts is over and its task is gone; nothing to do when nobody drives."""
    driving = [agent for agent in scenario.players if access.simulation(agent).get("laps", "1") != "1"]
    if not driving:
        return
    progress(f"{len(driving)} players are driving since the last run; they end when nobody is near another")
    _await_no_task(access, scenario, progress)
    for agent in driving:
        access.remove_simulation(agent)
    _await_no_task(access, scenario, progress)


def _await_no_task(access: Access, scenario: Scenario, progress: Callable[[str], None]) -> None:
    def left() -> str:
        return "\n".join(f"task {name}" for name in access.tasks_of_rule(scenario.story.rule)) or "no task"

    wait_for(
        "the last event of the driving to end", PARTED_SECONDS_MAX, lambda: left() == "no task", left, POLL_SECONDS,
        progress,
    )  # fmt: skip
