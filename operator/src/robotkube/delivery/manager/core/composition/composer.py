"""Composition: demands -> the releases that should exist, with reasons.

Services become releases; services with links of kind ros share a node; links of kind mqtt become topics of the bridge
release at both ends, merged over all demands, so that no message is carried twice. Demands are met in the order in
which they are given: what comes first has its place first. One that cannot be met is refused and leaves no trace.

Each composition starts from nothing. What it depends on is in its arguments; a memo only saves computing again what
follows from the same inputs (memo.py), and changes no answer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.accumulated_state import AccumulatedState, Contribution, release_keys
from robotkube.delivery.manager.core.composition.bridges import ImpossibleBridgeError
from robotkube.delivery.manager.core.composition.index import Index
from robotkube.delivery.manager.core.composition.inputs import Composition, Demand, Inputs, Met, Refused
from robotkube.delivery.manager.core.composition.memo import Memo
from robotkube.delivery.manager.core.composition.topic_merge import End
from robotkube.errors import DocumentError, RefusalError
from robotkube.registry.charts.core.values_schemas import Validate

__all__ = ["Composition", "Demand", "Inputs", "Memo", "Met", "Refused", "Validate", "compose"]


def compose(demands: Iterable[Demand], inputs: Inputs, memo: Memo | None = None) -> Composition:
    """Meet the demands in this order. The composition has one outcome for each; nothing is raised."""
    wanted = list(demands)
    memo = memo or Memo(kept_max=0)
    index = memo.index(inputs)
    impossible: dict[str, Refused] = {}
    while True:  # a bridge that cannot be made: each time at least one demand more is refused
        state = _accumulated(wanted, impossible, index, memo)
        try:
            return _composition(state, index, memo)
        except ImpossibleBridgeError as error:
            impossible |= dict.fromkeys(error.demands, error.refused)


def _accumulated(
    demands: Sequence[Demand], impossible: Mapping[str, Refused], index: Index, memo: Memo
) -> AccumulatedState:
    """The state after every demand was met or refused, one after the other."""
    number, state = memo.prefix(demands, impossible, index)
    for demand in demands[number:]:
        memo.note(number, state)
        state.outcomes[demand.key] = impossible.get(demand.key) or _outcome(demand, state, index, memo)
        number += 1
    memo.note(number, state)
    return state


def _outcome(demand: Demand, state: AccumulatedState, index: Index, memo: Memo) -> Contribution | Refused:
    """Expand one demand, or share the expansion of an equal one, and add it to the state."""
    mark = state.assignments.mark()
    try:
        contribution = memo.contribution(demand, state.first.get(demand.shared_key), index, state.assignments)
        state.add(contribution, index, memo.merged_release)
    except RefusalError as error:
        state.assignments.undo(mark)
        return Refused(error.reason, error.message)
    except DocumentError as error:
        state.assignments.undo(mark)
        return Refused("CompositionFailed", str(error))
    return contribution


def _composition(state: AccumulatedState, index: Index, memo: Memo) -> Composition:
    """The composition of a state: bridges are made, every release gets its causes, every demand its outcome."""
    bridges, made = memo.bridges(state, index)
    releases = {**state.releases, **made}
    contributions = {**state.contributions, **dict(zip(bridges.values(), state.bridged.values(), strict=True))}
    written = memo.written(releases, contributions, index)
    return Composition(written, memo.outcomes(state, bridges), _initial(state, bridges, releases))


def _initial(state: AccumulatedState, bridges: Mapping[End, str], releases: Mapping[str, Release]) -> frozenset[str]:
    """The paths that the initial configuration uses."""
    contributions = [
        outcome for outcome in state.outcomes.values() if isinstance(outcome, Contribution) and outcome.cause is None
    ]
    return frozenset(
        releases[key].path for contribution in contributions for key in release_keys(contribution.expansion, bridges)
    )
