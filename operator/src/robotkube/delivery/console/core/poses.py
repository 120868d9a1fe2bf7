"""Poses, thinned before anything else is done with them: at most one in SAMPLE_MS of each agent."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from robotkube.robots.mqtt.core.batches import decode_batch
from robotkube.robots.ros.core.common_messages import header_stamp, pose_and_heading

SAMPLE_MS = 500
AGENTS_MAX = 10_000
MARK = "{agent}"


class PoseSampler:
    """Which messages of which topics become poses. `pattern` is an MQTT topic with `{agent}` for one level, an agent's
    ROS name; `agents` are agents by that name."""

    def __init__(self, pattern: str, agents: Mapping[str, str]) -> None:
        before, _, behind = pattern.partition(MARK)
        self.topic = pattern.replace(MARK, "+")
        self._topic = re.compile(f"{re.escape(before)}([^/]+){re.escape(behind)}")
        self._agents = agents
        self._named: dict[str, str] = {}
        self._next_ms: dict[str, int] = {}

    def sample(self, topic: str, payload: bytes, now_ms: int) -> tuple[str, dict[str, Any]] | None:
        """The agent and its pose; None when it is not due yet, or the topic is of nobody. ValueError or
        InputError when the message is none."""
        agent = self._named.get(topic) or self._agent(topic)
        if not agent or now_ms < self._next_ms.get(agent, 0):
            return None
        messages = decode_batch(payload).messages
        if not messages:
            return None
        x, y, z, heading = pose_and_heading(messages[-1])
        # the beat is kept as long as poses come, so that 2 Hz stay 2 Hz whatever the beat of the sender is
        due = self._next_ms.get(agent, 0)
        self._next_ms[agent] = due + SAMPLE_MS if now_ms - due < SAMPLE_MS else now_ms + SAMPLE_MS
        return agent, {
            "x": round(x, 3),
            "y": round(y, 3),
            "z": round(z, 3),
            "heading": None if heading is None else round(heading, 4),
            "stamp_ms": header_stamp(messages[-1]) // 1_000_000,
            "received_ms": now_ms,
        }

    def _agent(self, topic: str) -> str:
        match = self._topic.fullmatch(topic)
        agent = self._agents.get(match.group(1), "") if match else ""
        if agent and len(self._named) < AGENTS_MAX:
            self._named[topic] = agent
        return agent
