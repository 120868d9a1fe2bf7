"""Rules for tests: documents in, an engine with message definitions of its own out."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.reader import Reader
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.rules.core import Edge, Message, Rule, RuleEngine, read_rules
from robotkube.robots.rules.core.conditions.external import AskRule

MS, SECOND = 1_000_000, 1_000_000_000
NOW = 1_795_250_000 * SECOND
POSE, NUMBER, TEXT = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/Float64", "std_msgs/msg/String"
LINE = "=" * 80
DEFINITIONS = {
    POSE: f"""std_msgs/Header header
Pose pose
{LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{LINE}
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
{LINE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{LINE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
""",
    NUMBER: "float64 data\n",
    TEXT: "string data\n",
}
POSES, NUMBERS = "/vehicles/{agent}/pose", "/vehicles/{agent}/value"
TOPICS = {POSES: POSE, NUMBERS: NUMBER, "/words": TEXT, "/value": NUMBER}


def layouts() -> Layouts:
    """The definitions above."""
    return Layouts(DEFINITIONS.__getitem__)


def read(
    *documents: object, topics: Mapping[str, str] = TOPICS, plugins: Sequence[str] | None = None
) -> tuple[Rule, ...]:
    """The rules of these documents; DocumentError with all problems."""
    reader = Reader("rules")
    items = [reader.keys_of(document, f"rules[{index}]") for index, document in enumerate(documents)]
    rules = read_rules(items, topics, layouts(), plugins)
    reader.finish()
    return rules


def problems_of(*documents: object, plugins: Sequence[str] | None = None) -> tuple[str, ...]:
    """What is wrong with these documents."""
    try:
        read(*documents, plugins=plugins)
    except DocumentError as error:
        return error.problems
    return ()


def pose(x: float, y: float = 0.0, z: float = 0.0, stamp: int = 0) -> bytes:
    """A serialised PoseStamped."""
    head = struct.pack("<iII4s", *divmod(stamp, SECOND), 4, b"map\0")
    return b"\0\1\0\0" + head + struct.pack("<7d", x, y, z, 0, 0, 0, 1)


def number(value: float) -> bytes:
    """A serialised Float64."""
    return b"\0\1\0\0" + struct.pack("<d", value)


class RuleStage:
    """An engine; times are given in seconds since NOW, and messages are received when they are measured. `begin`: NOW
    by the clock of the sources."""

    def __init__(self, *documents: dict[str, Any], ask: AskRule | None = None, begin: int = NOW) -> None:
        rules = read(*documents)
        self.begin = begin
        self.engine = RuleEngine(rules, layouts(), "cloud-0", ask) if ask else RuleEngine(rules, layouts(), "cloud-0")

    def send(
        self, agent: str, value: float | tuple[float, ...], at: float, received: float | None = None
    ) -> list[Edge]:
        """A number, or a position, of `agent`."""
        stamp, later = self.begin + round(at * SECOND), NOW + round((at if received is None else received) * SECOND)
        name = agent.replace("-", "_")
        if isinstance(value, tuple):
            message = Message(f"/vehicles/{name}/pose", POSE, stamp, later, pose(*value, stamp=stamp))
        else:
            message = Message(f"/vehicles/{name}/value", NUMBER, stamp, later, number(value))
        return self.engine.observe(message)

    def tick(self, at: float) -> list[Edge]:
        """The time goes on."""
        return self.engine.tick(NOW + round(at * SECOND))


def seconds(edges: Sequence[Edge], begin: int = NOW) -> list[tuple[str, tuple[str, ...], float]]:
    """Edge, agents and stamp in seconds since `begin` (whole ms)."""
    return [(edge.edge, edge.agents, round((edge.stamp - begin) / SECOND, 3)) for edge in edges]
