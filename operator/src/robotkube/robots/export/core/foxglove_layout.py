"""The layout of a recording for Foxglove and Lichtblick: its topics in space, how they come in time, and as they are.

Both read the same JSON form (`configById`, `layout`), in which a panel's name ends with `!` and a word of its own. What
each panel does with a topic it decides by the topic's type, so topics are given by their names alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

TOPICS_MAX = 200
PLOTTED_MAX = 10
SUFFIX = ".layout.json"
"""What the layout of a recording's file is called, behind the recording's name."""
POSE = "pose"
SPACE, PLOT, MESSAGES, GRAPH = "3D!space", "Plot!positions", "RawMessages!first", "SourceInfo!topics"

GRID = {
    **{"layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid", "visible": True, "frameLocked": True},
    **{"size": 1000, "divisions": 20, "lineWidth": 1, "color": "#808080", "position": [0, 0, 0], "rotation": [0, 0, 0]},
}


def recording_layout(topics: Iterable[str]) -> dict[str, Any]:
    """The layout of a recording with these topics, at most the first TOPICS_MAX by name."""
    names = sorted(set(topics))[:TOPICS_MAX]
    poses = [name for name in names if name.rpartition("/")[2] == POSE]
    return {
        "configById": {
            SPACE: {
                "cameraState": {"perspective": False, "distance": 300, "phi": 0, "thetaOffset": 0},
                "scene": {"enableStats": False},
                "topics": {name: {"visible": True} for name in names},
                "layers": {GRID["instanceId"]: GRID},
            },
            PLOT: {
                "title": "Positions in m",
                "paths": [_path(name, axis) for name in poses[:PLOTTED_MAX] for axis in ("x", "y")],
                "showLegend": True,
                "isSynced": True,
                "xAxisVal": "timestamp",
            },
            MESSAGES: {"topicPath": (poses or names or [""])[0], "diffEnabled": False},
            GRAPH: {},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": SPACE,
            "second": {
                "direction": "column",
                "first": PLOT,
                "second": {"direction": "row", "first": MESSAGES, "second": GRAPH},
                "splitPercentage": 50,
            },
            "splitPercentage": 60,
        },
    }


def _path(topic: str, axis: str) -> dict[str, Any]:
    """The curve of one axis of a pose over time, by the stamps of its messages."""
    value = f"{topic}.pose.position.{axis}"
    return {"value": value, "label": f"{topic} {axis}", "enabled": True, "timestampMethod": "headerStamp"}
