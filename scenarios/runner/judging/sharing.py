"""What encounters that overlap share: one release with the demands of both, kept until the second has ended.

Pure; None means that the inputs do not contain it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, groupby

from scenarios.runner.inputs import RunInputs
from scenarios.runner.judging.encounters import Encounter

UPLINK = "mqtt-bridge"


def overlapping(encounters: Sequence[Encounter]) -> tuple[tuple[Encounter, Encounter, str], ...]:
    """Pairs of encounters of which the second began before the first had ended, with the agent that is in both."""
    return tuple(
        (first, second, agent)
        for first, second in combinations(encounters, 2)
        if first.stop is not None and second.start.time < first.stop.time
        for agent in first.agents
        if agent in second.agents
    )


def demands_max(inputs: RunInputs, encounters: Sequence[Encounter]) -> int | None:
    """The greatest number of the encounters' tasks that one shared uplink named at one commit."""
    named = [len(tasks) for shared in overlapping(encounters) for tasks in _named(inputs, *shared)]
    return max(named, default=None)


def kept(inputs: RunInputs, encounters: Sequence[Encounter]) -> bool | None:
    """Return whether every shared uplink named the first task, then both, then the second alone, without a commit
    between them that named none."""
    shared = overlapping(encounters)
    if not shared or not inputs.history:
        return None
    return all(_is_kept(inputs, *one) for one in shared)


def _is_kept(inputs: RunInputs, first: Encounter, second: Encounter, agent: str) -> bool:
    steps = [tasks for tasks, _ in groupby(_named(inputs, first, second, agent))]
    while steps and not steps[0]:
        steps.pop(0)
    while steps and not steps[-1]:
        steps.pop()
    both = frozenset(_tasks(first, second))
    return both in steps and all(steps) and steps[-1] == frozenset(_tasks(second))


def _named(inputs: RunInputs, first: Encounter, second: Encounter, agent: str) -> Iterator[frozenset[str]]:
    """The two encounters' tasks that the agent's uplink names, commit by commit."""
    both = frozenset(_tasks(first, second))
    for state in inputs.history:
        yield both & frozenset(state.tasks.get(f"{agent}/{UPLINK}", ()))


def _tasks(*encounters: Encounter) -> list[str]:
    return [encounter.start.task for encounter in encounters if encounter.start.task]


def pods(inputs: RunInputs, encounters: Sequence[Encounter]) -> int | None:
    """The greatest number of pods that a shared uplink had during the run: 1 when none of its changes cost a
    restart."""
    agents = {agent for _, _, agent in overlapping(encounters)}
    counts = [
        sum(pod.namespace == agent and pod.name.startswith(f"{UPLINK}-") for pod in inputs.pods) for agent in agents
    ]
    return max(counts, default=None)


def recordings(encounters: Sequence[Encounter]) -> int | None:
    """Recordings of the run that hold messages that can be read."""
    return len(_recordings(encounters)) or None


def pairs_recorded(encounters: Sequence[Encounter]) -> int | None:
    """Different pairs of vehicles with such a recording."""
    return len({encounter.agents for encounter in encounters if encounter.readable}) or None


def _recordings(encounters: Sequence[Encounter]) -> set[str]:
    return {message.recording for encounter in encounters for message in encounter.readable}
