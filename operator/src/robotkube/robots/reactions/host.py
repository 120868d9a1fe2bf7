"""The process of one installed reaction: `python3 -m robotkube.robots.reactions.host`, started by the detector."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from typing import Any

from robotkube.robots.reactions.adapters.child_processes import serve
from robotkube.robots.reactions.core.plugin_api import ENTRY_POINT_GROUP


def load(plugin: str, settings: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], None]:
    """The reaction of that name; LookupError when no installed package offers it."""
    points = entry_points(group=ENTRY_POINT_GROUP, name=plugin)
    if not points:
        raise LookupError(f"no installed package offers the reaction {plugin}")
    react: Callable[[Mapping[str, Any]], None] = next(iter(points)).load()(settings).react
    return react


if __name__ == "__main__":
    serve(load)
