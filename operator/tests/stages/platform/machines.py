"""Agents that come and go on the shared platform: the values that declare them, and their machines."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from ci.cluster_contract.topology import NodeSpec
from ci.images import image_lock
from ci.installation import CHART, INSTALL_TIMEOUT_SECONDS, NAMESPACE
from tests.stages.platform.running_platform import Platform


def values(platform: Platform) -> dict[str, Any]:
    """The values with which the platform was installed."""
    return dict(json.loads(platform.installer.helm("-n", NAMESPACE, "get", "values", NAMESPACE, "-o", "json")))


def upgrade(platform: Platform, wanted: Mapping[str, Any], folder: Path) -> None:
    """The platform's chart with these values; its processes read the agents when they start."""
    path = folder / "values.yaml"
    path.write_text(yaml.safe_dump(dict(wanted)), encoding="utf-8")
    options = ["-n", NAMESPACE, "-f", str(CHART / "values-embedded.yaml"), "-f", str(path)]
    platform.installer.helm("upgrade", NAMESPACE, str(CHART), *options, "--timeout", f"{INSTALL_TIMEOUT_SECONDS}s")
    platform.installer.rollout(NAMESPACE)


@contextmanager
def declared(platform: Platform, agents: list[Mapping[str, Any]], folder: Path) -> Iterator[None]:
    """These agents in the chart's values, in the place of those of the same names."""
    before = values(platform)
    names = {agent["name"] for agent in agents}
    kept = [agent for agent in before["agents"] if agent["name"] not in names]
    upgrade(platform, {**before, "agents": [*kept, *agents]}, folder)
    try:
        yield
    finally:
        upgrade(platform, before, folder)


def join(platform: Platform, machine: NodeSpec) -> None:
    """A machine joins, as its owner switches it on."""
    platform.provider.join(machine, image_lock.read_lock(image_lock.lock_file()))


def leave(platform: Platform, node: str) -> None:
    """It is switched off, and its Node is deleted."""
    platform.provider.stop_node(node)
    platform.kubectl("delete", "node", node)
