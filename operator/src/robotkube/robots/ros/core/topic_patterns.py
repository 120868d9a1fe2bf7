"""Topic names of agents: `/vehicles/{agent}/pose` and the agent `vehicle-00`, which is `vehicle_00` in ROS names."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from robotkube.foundation.documents.core.patterns import ROS_AGENT, ROS_TOPIC, ROS_TOPIC_CHARACTERS_MAX

AGENT = "{agent}"
_IN_BRACES = re.compile(r"\{[^{}]*\}")
UNREADABLE_TOPIC = "/_unreadable_"
"""The stand-in for a topic whose name could not be read; that problem was reported, and others about it are not."""


def ros_name(agent: str) -> str:
    """The agent's name as a part of ROS names."""
    return agent.replace("-", "_")


def agent_name(ros: str) -> str:
    """The agent's name of a part of a ROS name; agents' names have no underscore."""
    return ros.replace("_", "-")


def length_problem(topic: str) -> str:
    """Why ROS does not take a topic of this length, as the end of a sentence; empty when it does. A name in braces,
    such as that of an agent, counts as one character, the least that can stand for it."""
    if len(_IN_BRACES.sub("a", topic)) <= ROS_TOPIC_CHARACTERS_MAX:
        return ""
    return f"has {len(topic)} characters, and ROS takes {ROS_TOPIC_CHARACTERS_MAX}; give it a shorter name"


@dataclass(frozen=True)
class TopicPattern:
    """A topic's name, or one per agent when `text` holds `{agent}` once. ValueError says what is wrong with `text`."""

    text: str
    _before: str = field(init=False, repr=False, compare=False)
    _after: str = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.text.count(AGENT) > 1:
            raise ValueError(f"{self.text} holds {AGENT} more than once; name it once")
        if not ROS_TOPIC.fullmatch(self.text.replace(AGENT, "a")):
            raise ValueError(f"{self.text} is not a full ROS topic name such as /vehicles/{AGENT}/pose")
        if problem := length_problem(self.text):
            raise ValueError(f"{self.text:.60}... {problem}")
        before, _, after = self.text.partition(AGENT)
        object.__setattr__(self, "_before", before)
        object.__setattr__(self, "_after", after)

    @property
    def general(self) -> bool:
        """Return whether the pattern stands for one topic per agent."""
        return AGENT in self.text

    def topic(self, agent: str) -> str:
        """The topic of an agent."""
        return self.text.replace(AGENT, ros_name(agent))

    def agent(self, topic: str) -> str | None:
        """The agent whose topic this is; None when the topic does not fit, `""` when the pattern names no agent."""
        if not self.general:
            return "" if topic == self.text else None
        middle = topic[len(self._before) : len(topic) - len(self._after)]
        fits = topic == f"{self._before}{middle}{self._after}" and ROS_AGENT.fullmatch(middle)
        return agent_name(middle) if fits else None
