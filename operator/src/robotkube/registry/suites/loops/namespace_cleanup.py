"""Emptying a test namespace: nothing of a run is left there when the next one begins, whatever the run was."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping

from robotkube.errors import UnavailableError
from robotkube.registry.suites.core import namespace_contents as contents
from robotkube.registry.suites.core import pod_descriptions
from robotkube.registry.suites.core.namespace_contents import BROKER_SECRET, DATABASE_SECRET, HelperPod
from robotkube.registry.suites.loops.cluster_namespace import (
    BROKER,
    DATABASE,
    EMPTY_GRACE_SECONDS,
    KEPT_CONFIG_MAPS,
    POLL_SECONDS,
    SCRATCH_USED,
    SuiteNamespaceSettings,
)
from robotkube.registry.suites.ports.suites import NamespaceObjects

CLEAN_SECONDS_MAX = 60
SECRETS = (BROKER_SECRET, DATABASE_SECRET, BROKER, DATABASE)
CLEAN = """
import pathlib, shutil
for place in pathlib.Path({!r}).iterdir():
    shutil.rmtree(place) if place.is_dir() and not place.is_symlink() else place.unlink()
"""


class ClusterNamespaceCleaner:
    """The port NamespaceCleaner."""

    def __init__(
        self,
        api: NamespaceObjects,
        settings: SuiteNamespaceSettings,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._api = api
        self._settings = settings
        self._clock = clock
        self._sleep = sleep

    @property
    def name(self) -> str:
        """The name of the test namespace."""
        return self._settings.namespace

    def empty(self, seconds: float) -> None:
        """Delete everything a run may have made; clean the volume claim when it was used."""
        deadline = self._clock() + seconds
        self._wait_empty(deadline)
        if self._api.get("ConfigMap", SCRATCH_USED):
            self._clean_scratch(deadline)
            self._api.delete("ConfigMap", SCRATCH_USED)

    def _wait_empty(self, deadline: float) -> None:
        for name in SECRETS:
            self._api.delete("Secret", name)
        while left := self._delete_all({SCRATCH_USED}):
            if self._clock() >= deadline:
                raise UnavailableError(f"{self.name}: still there after the time for emptying: {', '.join(left[:5])}")
            self._sleep(POLL_SECONDS)

    def _delete_all(self, spared: Collection[str]) -> list[str]:
        """Delete every object that is there; their kinds and names."""
        left = []
        for kind in (*contents.KINDS, "Pod"):
            items, _ = self._api.list(kind)
            for item in items:
                name = item["metadata"]["name"]
                if name in spared or (kind == "ConfigMap" and name in KEPT_CONFIG_MAPS):
                    continue
                self._api.delete(kind, name, EMPTY_GRACE_SECONDS if kind == "Pod" else None)
                left.append(f"{kind} {name}")
        return left

    def _clean_scratch(self, deadline: float) -> None:
        settings = self._settings
        name = "suite-clean"
        volume, mount = contents.scratch_volume()
        command = ["python3", "-c", CLEAN.format(contents.SCRATCH_FOLDER)]
        pod = HelperPod(
            name, settings.observer_image, settings.agent, settings.domain_id, command,
            volumes=[volume], mounts=[mount], seconds=CLEAN_SECONDS_MAX,
        )  # fmt: skip
        document = pod.document()
        document["spec"]["securityContext"] |= {"fsGroupChangePolicy": "Always"}  # files of any user can be deleted
        self._api.create("Pod", document)
        codes: Mapping[str, int | None] = {}
        while codes.get(name) is None:
            if self._clock() >= deadline:
                raise UnavailableError(
                    f"{self.name}: the volume claim {contents.SCRATCH_VOLUME_CLAIM} was not emptied in time"
                )
            self._sleep(POLL_SECONDS)
            codes = pod_descriptions.exit_codes(self._api.get("Pod", name) or {})
        if codes[name] != 0:
            raise UnavailableError(
                f"{self.name}: the volume claim {contents.SCRATCH_VOLUME_CLAIM} could not be emptied"
            )
        self._wait_empty(deadline)
