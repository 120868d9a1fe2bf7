"""Rights at the broker: which topics the account of an agent may write and read there.

They are fixed by an agent's name and role, and the broker enforces the same ones: charts/robotkube renders them
(templates/_broker.tpl), and a test compares both on a real broker (operator/tests/charts/test_broker.py).
"""

from __future__ import annotations

from typing import Protocol

from robotkube.robots.bridge.core.settings import GATEWAY_TOPICS
from robotkube.robots.ros.core.topic_patterns import AGENT, ros_name

OUT = "out"
IN = "in"
SPEAKING_ROLES = ("vehicle", "roadside")
"""Roles whose agents have topics of their own; agents of all other roles listen."""
RULES = (
    f"agents of role {' or '.join(SPEAKING_ROLES)} write and read topics below /vehicles/<their own name>/ and no "
    "others, agents of other roles read every topic and write none"
)


class Account(Protocol):
    """An agent as the broker knows it."""

    @property
    def name(self) -> str:
        """Its name, which is that of the account."""

    @property
    def role(self) -> str:
        """What kind of machine it is."""


def may(agent: Account, direction: str, topic: str) -> bool:
    """Whether the broker lets the agent's bridge send (`out`) or receive (`in`) this ROS topic. One that names any
    agent (`{agent}`) may go out where the agent's own may; a bridge does not bring in its own that way."""
    if topic in GATEWAY_TOPICS:
        return GATEWAY_TOPICS[topic] == direction
    if agent.role not in SPEAKING_ROLES:
        return direction == IN
    own = ros_name(agent.name)
    name = topic.replace(AGENT, own) if direction == OUT else topic
    return f"{name}/".startswith(f"/vehicles/{own}/")
