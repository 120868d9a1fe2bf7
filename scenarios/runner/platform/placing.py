"""Puts the bags into the vehicles' volume claims, before their players exist."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from ci.cluster_contract.provider import Volumes
from scenarios.runner.platform.access import Access

VOLUME_CLAIM = "bags"
LEDGER = "ledger"


def place_bags(access: Access, volumes: Volumes, bags: Mapping[str, Path], progress: Callable[[str], None]) -> None:
    """Places one bag per agent, in the folder of its name; a player that holds an older bag is restarted."""
    volumes.use([(agent, VOLUME_CLAIM) for agent in bags])
    for agent, bag in bags.items():
        volumes.make((agent, VOLUME_CLAIM), LEDGER)
        if volumes.place((agent, VOLUME_CLAIM), bag):
            _restart_player(access, agent)
    progress(f"bags: {len(bags)} in the volume claims {VOLUME_CLAIM} of their agents")


def _restart_player(access: Access, agent: str) -> None:
    for pod in access.pods(agent):
        if (pod.metadata.labels or {}).get("app.kubernetes.io/name") == "bag-player":
            access.delete_pod(agent, pod.metadata.name)
