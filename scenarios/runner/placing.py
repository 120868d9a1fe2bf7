"""Puts the bags into the vehicles' volume claims, before their players exist."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from scenarios.runner.access import Access
from scenarios.runner.waiting import wait_for

VOLUME_CLAIM = "bags"
LEDGER = "ledger"
OWNER = 10001  # the user of the platform's pods
BIND_SECONDS_MAX = 30.0


class Volumes(Protocol):
    """What a cluster's provider knows of its volumes."""

    def volume_path(self, namespace: str, volume_claim: str) -> Path:
        """The host's folder behind a bound volume claim."""
        ...


def place_bags(
    access: Access, volumes: Volumes, bags: Mapping[str, Path], progress: Callable[[str], None]
) -> Mapping[str, Path]:
    """Places one bag per agent and returns the volumes' folders; a player that holds an older bag is restarted."""
    for agent in bags:
        access.bind(agent, VOLUME_CLAIM)
    folders = {}
    for agent, bag in bags.items():

        def bound(agent: str = agent) -> bool:
            return access.bound(agent, VOLUME_CLAIM)

        wait_for(f"volume claim {agent}/{VOLUME_CLAIM}", BIND_SECONDS_MAX, bound, lambda: "no volume was bound to it")
        folders[agent] = volumes.volume_path(agent, VOLUME_CLAIM)
        if place(bag, folders[agent] / agent):
            _restart_player(access, agent)
    progress(f"bags: {len(folders)} in the volume claims {VOLUME_CLAIM} of their agents")
    return folders


def place(bag: Path, target: Path) -> bool:
    """Puts a bag into `target` by hard links, or copies over file systems; True when another bag had been there."""
    ledger = target.parent / LEDGER
    ledger.mkdir(exist_ok=True)
    os.chown(ledger, OWNER, OWNER)
    if target.is_dir() and _same(bag, target):
        return False
    partial = target.with_name(f".{target.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    shutil.copytree(bag, partial, copy_function=_link)
    replaced = target.exists()
    if replaced:
        shutil.rmtree(target)
    partial.rename(target)
    return replaced


def _same(bag: Path, target: Path) -> bool:
    names = {file.name for file in bag.iterdir()}
    return names == {file.name for file in target.iterdir()} and all(
        (bag / name).samefile(target / name) or _equal_copies(bag / name, target / name) for name in names
    )


def _equal_copies(first: Path, second: Path) -> bool:
    """Copies keep their time of change, so size and time tell."""
    one, other = first.stat(), second.stat()
    return (one.st_size, one.st_mtime_ns) == (other.st_size, other.st_mtime_ns)


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _restart_player(access: Access, agent: str) -> None:
    for pod in access.pods(agent):
        if (pod.metadata.labels or {}).get("app.kubernetes.io/name") == "bag-player":
            access.delete_pod(agent, pod.metadata.name)
