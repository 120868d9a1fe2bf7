"""`python3 -m robotkube.entrypoints.teardown`: ends all releases before `helm uninstall` deletes the platform.

Settings: docs/reference/settings.md. Exit code 0 when no release is left, 2 when the settings are wrong, 3 when some
are left after the stated time.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from robotkube.adapters.argocd_releases import KubernetesInstalledReleases
from robotkube.adapters.kubernetes_http import ApiServer
from robotkube.domain.documents import Reader
from robotkube.domain.errors import DocumentError
from robotkube.entrypoints.processes import Process, read_text, run
from robotkube.services.tearing_down import Clock, tear_down

GRACE_SECONDS = 4.0
WAIT_SECONDS_MAX = 3600
LOG_LEVELS = ("debug", "info", "warning", "error")


@dataclass(frozen=True)
class TeardownSettings:
    """Whose releases end, and how long that may take."""

    namespace: str
    project: str
    application_set: str
    wait_seconds: int


def read_teardown_settings(path: Path) -> TeardownSettings:
    """Read the settings file; InputError names the file and every problem."""
    try:
        document = yaml.safe_load(read_text(path, "settings"))
    except yaml.YAMLError as error:
        raise DocumentError(str(path), [f"is not YAML: {error}"]) from error
    reader = Reader(str(path))
    root = reader.mapping(document, "", ("log_level", "argocd", "wait_seconds"))
    argocd = reader.mapping(root.get("argocd", {}), "argocd", ("namespace", "project", "application_set"))
    wait = root.get("wait_seconds")
    if not isinstance(wait, int) or isinstance(wait, bool) or not 0 < wait <= WAIT_SECONDS_MAX:
        reader.problems.append(f"wait_seconds: must be a whole number from 1 to {WAIT_SECONDS_MAX}")
    if root.get("log_level") not in LOG_LEVELS:
        reader.problems.append(f"log_level: must be one of {', '.join(LOG_LEVELS)}")
    names = {key: reader.prose(argocd.get(key, ""), f"argocd.{key}") for key in argocd}
    reader.finish()
    return TeardownSettings(wait_seconds=int(wait or 0), **names)


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Wire the API server to the service and say how many releases ended."""
    path = Path(environment.get("ROBOTKUBE_CONFIG", "/etc/robotkube/config.yaml"))
    settings = read_teardown_settings(path)
    api = ApiServer.from_environment(environment)
    releases = KubernetesInstalledReleases(api, settings.namespace, settings.project, settings.application_set)
    clock = Clock(time.monotonic, lambda seconds: not process.stopping.wait(seconds))
    fields: dict[str, Any] = {"releases": tear_down(releases, settings.wait_seconds, clock)}
    process.log("releases ended", **fields)


if __name__ == "__main__":
    run("teardown", body, grace_seconds=GRACE_SECONDS)
