"""Publishers and subscriptions of the ROS graph as values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Endpoint:
    """A publisher (`out`) or subscription (`in`) in the ROS graph; `node` is empty while its name is not known."""

    topic: str
    direction: str
    type: str
    reliability: str
    durability: str
    node: str = ""
