"""Rights at the broker: which topics the account of an agent may write there, whatever anybody deploys.

They are fixed by an agent's name and role. What it may read besides is what links on main say, so a link that is
composed always may be read. The broker enforces the same ones: `robotkube.delivery.rights` writes its table from
`own_places`, and a test compares both on a real broker (operator/tests/delivery/rights/test_broker.py).
"""

from __future__ import annotations

from typing import Protocol

from robotkube.robots.bridge.core.settings import GATEWAY_TOPICS
from robotkube.robots.ros.core.topic_patterns import AGENT, ros_name

OUT = "out"
IN = "in"
SPEAKING_ROLES = ("vehicle", "roadside")
"""Roles whose agents also have topics below /vehicles/<own name>/."""
RULES = (
    "every agent writes topics below /agents/<its own name>/, agents of role "
    f"{' or '.join(SPEAKING_ROLES)} also those below /vehicles/<their own name>/, and nobody others"
)


class Account(Protocol):
    """An agent as the broker knows it."""

    @property
    def name(self) -> str:
        """Its name, which is that of the account."""

    @property
    def role(self) -> str:
        """What kind of machine it is."""


def own_places(agent: Account) -> tuple[str, ...]:
    """The places, as ROS names without a slash at the end, below which an agent writes."""
    own = ros_name(agent.name)
    return (f"/agents/{own}", *([f"/vehicles/{own}"] if agent.role in SPEAKING_ROLES else []))


def may_anybody(direction: str, topic: str) -> bool:
    """Return whether every agent can be given the right, whatever its name and role: then no agent needs to be asked
    for."""
    if topic in GATEWAY_TOPICS:
        return GATEWAY_TOPICS[topic] == direction
    return direction == IN or topic.startswith(f"/agents/{AGENT}/")


def may(agent: Account, direction: str, topic: str) -> bool:
    """Return whether the bridge of an agent can be given the right to send (`out`) or receive (`in`) this ROS topic.
    One that names any agent (`{agent}`) may go out where the agent's own may; a bridge does not bring in its own that
    way."""
    if topic in GATEWAY_TOPICS:
        return GATEWAY_TOPICS[topic] == direction
    if direction == IN:
        return True
    name = topic.replace(AGENT, ros_name(agent.name))
    return any(f"{name}/".startswith(f"{place}/") for place in own_places(agent))
