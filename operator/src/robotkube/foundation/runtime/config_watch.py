"""The ConfigMap watch of a robot process: every change of its settings, and whether the release is still its own."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.foundation.runtime.process import PodSettings, Process

if TYPE_CHECKING:
    from robotkube.foundation.kubernetes.adapters.http_client import ConfigMapWatch

ApplySettings = Callable[[Mapping[str, str]], None]


def boot_seconds() -> float:
    """The seconds since the machine started, those while it slept included."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def fencing_of(pod: PodSettings) -> Fencing:
    """The fencing of the process in this pod, as the mounted settings say; nothing is fenced without a ConfigMap."""
    return Fencing(pod.node, pod.movable and pod.config_map is not None, boot_seconds)


def watch_settings(process: Process, config_map: str, fencing: Fencing, apply: ApplySettings) -> ConfigMapWatch:
    """Watch the ConfigMap `<namespace>/<name>` from now on; its data go to `apply`, on another thread."""
    from robotkube.foundation.kubernetes.adapters.http_client import (
        ApiServer,
        ConfigMapWatch,
        split_name,  # after the subscriptions
    )

    def failed(sentence: str) -> None:
        process.log("watch interrupted", error=sentence)

    changed = until_removed(process, fencing, apply)
    api = ApiServer.from_environment(os.environ)
    namespace, name = split_name(config_map)
    watch = ConfigMapWatch(api, namespace, name, changed, failed, boot_seconds)
    fencing.watch(watch)
    watch.start()
    return watch


def until_removed(
    process: Process, fencing: Fencing, apply: ApplySettings
) -> Callable[[Mapping[str, str] | None], None]:
    """The handler of changes of the process's ConfigMap: its data go to `apply`; when it was there and is gone, or
    names another node, the body is asked to return, and the process does nothing more until a signal ends it.

    Then its release was removed. Usually the kubelet says so; on a node that was cut off and is back, this process
    would go on publishing and recording next to its successor elsewhere until the kubelet knows."""
    seen = threading.Event()

    def changed(data: Mapping[str, str] | None) -> None:
        own = fencing.observe(data)
        if data is not None:
            seen.set()
        if own and data is not None:
            apply(data)
        elif (seen.is_set() or fencing.lost) and not process.stopping.is_set():
            reason = "gone" if data is None else "for another node"
            process.log("removed", reason=f"the ConfigMap of the release is {reason}")
            process.removed.set()
            process.stop()

    return changed
