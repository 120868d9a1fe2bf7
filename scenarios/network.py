"""What cables are like in a scenario: the section `network` of its file, by agent.

    network:
    - {role: vehicle, up_mbit: 50, round_trip_ms: 50, jitter_ms: 15, loss_percent: 0.01}
    - {agent: vehicle-00, up_mbit: 20, holes: [{at_seconds: 16, seconds: 5}, {x_m: 0, y_m: 0, radius_m: 50}]}

An agent's own entry stands in place of its role's. The form is checked by scenario.schema.json before it is read here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ci.cluster_contract.network_conditions import NetworkConditions

RATES_AND_DELAYS = ("up_mbit", "down_mbit", "round_trip_ms", "jitter_ms", "loss_percent")


@dataclass(frozen=True)
class TimeHole:
    """A hole in coverage from a time on, in s since the players' start."""

    at_seconds: float
    seconds: float


@dataclass(frozen=True)
class PlaceHole:
    """A hole in coverage within `radius_m` of a place in frame `map`."""

    x_m: float
    y_m: float
    radius_m: float


@dataclass(frozen=True)
class Cable:
    """What the cable of an agent is to be like."""

    conditions: NetworkConditions
    holes: tuple[TimeHole | PlaceHole, ...] = ()

    @property
    def asked(self) -> dict[str, float]:
        """The conditions that were asked for, by the keys of the file."""
        known = {key: getattr(self.conditions, key) for key in RATES_AND_DELAYS}
        return {key: value for key, value in known.items() if value}


class NetworkError(ValueError):
    """Something in the section `network` is wrong; the message has key, problem and way out."""


def read_network(entries: Sequence[Mapping[str, Any]], roles: Mapping[str, str]) -> dict[str, Cable]:
    """The cables by agent; `roles`: agent -> role, of the topology. NetworkError where an entry means nobody, or
    somebody twice, or nothing."""
    by_role: dict[str, Cable] = {}
    by_agent: dict[str, Cable] = {}
    for number, entry in enumerate(entries):
        key = f"network.{number}"
        if ("role" in entry) == ("agent" in entry):
            raise NetworkError(f"{key}: must name either a role or an agent: whose cables are meant")
        kind = "role" if "role" in entry else "agent"
        known = set(roles.values()) if kind == "role" else {agent for agent in roles if roles[agent] != "platform"}
        if entry[kind] not in known:
            raise NetworkError(
                f"{key}.{kind}: {entry[kind]!r} is no {kind} of the topology whose cable can have conditions; "
                f"there is: {', '.join(sorted(known - {'platform'}))}"
            )
        cables = by_role if kind == "role" else by_agent
        if entry[kind] in cables:
            raise NetworkError(f"{key}.{kind}: {entry[kind]} has an entry already; make one of both")
        cables[entry[kind]] = _cable(key, entry)
    return {agent: cable for agent, role in roles.items() if (cable := by_agent.get(agent) or by_role.get(role))}


def _cable(key: str, entry: Mapping[str, Any]) -> Cable:
    conditions = NetworkConditions(**{name: entry[name] for name in RATES_AND_DELAYS if name in entry})
    holes = tuple(TimeHole(**one) if "seconds" in one else PlaceHole(**one) for one in entry.get("holes", ()))
    if conditions == NetworkConditions() and not holes:
        wanted = ", ".join((*RATES_AND_DELAYS, "holes"))
        raise NetworkError(f"{key}: says nothing about the cable; give one of {wanted}, or leave the entry out")
    if conditions.jitter_ms > conditions.round_trip_ms:
        raise NetworkError(
            f"{key}.jitter_ms: {conditions.jitter_ms:g} must be at most round_trip_ms ({conditions.round_trip_ms:g}): "
            "no packet arrives before it was sent"
        )
    return Cable(conditions, holes)
