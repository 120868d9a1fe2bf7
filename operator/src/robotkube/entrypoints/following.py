"""The settings of a robot process after its start: every change of its ConfigMap, and whether it is still its own."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from robotkube.entrypoints.processes import PodSettings, Process
from robotkube.services.ownership import Ownership

if TYPE_CHECKING:
    from robotkube.adapters.kubernetes_http import ConfigMapWatch

Take = Callable[[Mapping[str, str]], None]


def boot_seconds() -> float:
    """A clock that goes on while the machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def ownership_of(pod: PodSettings) -> Ownership:
    """Of the process in this pod, as the mounted settings say; nobody asks when no ConfigMap is named."""
    return Ownership(pod.node, pod.movable and pod.config_map is not None, boot_seconds)


def follow_settings(process: Process, config_map: str, ownership: Ownership, take: Take) -> ConfigMapWatch:
    """Watch `<namespace>/<name>` from now on; its data go to `take`, on another thread."""
    from robotkube.adapters.kubernetes_http import ApiServer, ConfigMapWatch, split_name  # after the subscriptions

    def failed(sentence: str) -> None:
        process.log("watch interrupted", error=sentence)

    changed = until_removed(process, ownership, take)
    api, (namespace, name) = ApiServer.from_environment(os.environ), split_name(config_map)
    watch = ConfigMapWatch(api, namespace, name, changed, failed, boot_seconds)
    ownership.follow(watch)
    watch.start()
    return watch


def until_removed(process: Process, ownership: Ownership, take: Take) -> Callable[[Mapping[str, str] | None], None]:
    """What follows the process's ConfigMap: its data go to `take`; when it was there and is gone, or names another
    node, the body is asked to return, and the process does nothing more until it is told to end.

    Then its release was removed. Usually the kubelet says so; on a node that was cut off and is back, this process
    would go on publishing and recording beside its successor elsewhere until the kubelet knows."""
    seen = threading.Event()

    def changed(data: Mapping[str, str] | None) -> None:
        own = ownership.told(data)
        if data is not None:
            seen.set()
        if own and data is not None:
            take(data)
        elif (seen.is_set() or ownership.lost) and not process.stopping.is_set():
            reason = "gone" if data is None else "for another node"
            process.log("removed", reason=f"the ConfigMap of the release is {reason}")
            process.removed.set()
            process.stop()

    return changed
