"""Borders between the scopes of managers: which scope an agent belongs to, and what may be heard over a border.

An agent says topics below its own name alone, so a topic's name says whose it is: /vehicles/<agent>/ and
/agents/<agent>/. One that names any agent (`{agent}`) is heard of those agents whose topic may be heard.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from robotkube.delivery.deployment.core.policies.links import LinkConsents
from robotkube.robots.mqtt.core.message_properties import MQTT_PREFIX
from robotkube.robots.ros.core.topic_patterns import AGENT, agent_name, ros_name

SPEAKERS = ("vehicles", "agents")
ANY_LEVEL = "+"


def said_as(topic_filter: str) -> str:
    """The name under which agents say what an MQTT filter asks for; empty when no agent says it."""
    if not topic_filter.startswith(f"{MQTT_PREFIX}/"):
        return ""
    return "/".join(AGENT if level == ANY_LEVEL else level for level in topic_filter[len(MQTT_PREFIX) :].split("/"))


def speaker(topic: str) -> str:
    """The agent that says a topic, `{agent}` for any; empty when no agent does."""
    parts = topic.split("/")
    return agent_name(parts[2]) if len(parts) > 2 and not parts[0] and parts[1] in (*SPEAKERS, AGENT) else ""


@dataclass(frozen=True)
class Borders:
    """The borders between scopes. `scopes`: agent -> its scope, which is called by its manager's name; empty where one
    manager has everything, so that there are no borders. `consents`: what main lets pass."""

    scopes: Mapping[str, str] = field(default_factory=dict)
    consents: LinkConsents = field(default_factory=LinkConsents)

    def missing(self, topic: str, listener: str) -> tuple[str, ...]:
        """What main lacks for an agent to hear a topic as agents say it: file and entry of each side that does not
        consent. Nothing within one scope, nor of a topic of any agent."""
        sender, receiver = self.scopes.get(speaker(topic)), self.scopes.get(listener)
        if sender is None or receiver is None or sender == receiver:
            return ()
        return self.consents.missing(topic, sender, receiver)

    def heard_of(self, topic: str, listener: str) -> Iterator[str]:
        """The topics that an agent may hear of one that names any agent: its own scope's, and others' by consent."""
        for agent in sorted(self.scopes):
            named = topic.replace(AGENT, ros_name(agent))
            if not self.missing(named, listener):
                yield named

    def obstacle(self, topic: str, listener: str) -> str:
        """Why an agent may not hear a topic, with the way out; empty when it may."""
        missing = self.missing(topic, listener)
        if not missing:
            return ""
        whose = speaker(topic)
        return (
            f"topic {topic} is said by {whose} of scope {self.scopes[whose]}, and {listener} is of scope "
            f"{self.scopes[listener]}: a link over this border needs the consent of both, and main lacks "
            f"{' and '.join(missing)}; people add it by pull request"
        )


def scopes_of(managers: Iterable[tuple[str, Iterable[str]]]) -> dict[str, str]:
    """Agent -> scope, of managers with the agents that they name; none where only one of them is."""
    every = list(managers)
    return {agent: name for name, agents in every for agent in agents} if len(every) > 1 else {}
