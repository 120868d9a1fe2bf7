"""The process `python3 -m robotkube.setup.teardown`: ends all releases before `helm uninstall` deletes the platform.

Settings: docs/reference/settings.md. Exit code 0 when no release is left, 2 when the settings are wrong, 3 when some
are left after the stated time.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.patterns import WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.process import Process, run
from robotkube.setup.adapters.argocd_releases import KubernetesInstalledReleases
from robotkube.setup.loops.teardown import TeardownClock, tear_down

GRACE_SECONDS = 4.0
WAIT_SECONDS_MAX = 3600


@dataclass(frozen=True)
class TeardownSettings:
    """The settings of the Job: whose releases end, and how long that may take."""

    log_level: str
    namespace: str
    project: str
    application_set: str
    wait_seconds: int


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> TeardownSettings:
    """Read the settings document of the Job."""
    root = reader.mapping(document, "", ["log_level", "argocd", "wait_seconds"])
    argocd = reader.mapping(root.get("argocd") or {}, "argocd", ["namespace", "project", "application_set"])
    wait = root.get("wait_seconds")
    if not isinstance(wait, int) or isinstance(wait, bool) or not 0 < wait <= WAIT_SECONDS_MAX:
        reader.problems.append(f"wait_seconds: must be a whole number from 1 to {WAIT_SECONDS_MAX}")
        wait = 1
    return TeardownSettings(
        log_level=files.log_level(reader, root.get("log_level")),
        namespace=reader.word(argocd.get("namespace"), "argocd.namespace", WORD),
        project=reader.word(argocd.get("project"), "argocd.project", WORD),
        application_set=reader.word(argocd.get("application_set"), "argocd.application_set", WORD),
        wait_seconds=wait,
    )


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Wire the API server to the service and say how many releases ended."""
    settings = files.start_with_settings(process, read_configuration, environment)
    api = ApiServer.from_environment(environment)
    releases = KubernetesInstalledReleases(api, settings.namespace, settings.project, settings.application_set)
    clock = TeardownClock(time.monotonic, lambda seconds: not process.stopping.wait(seconds))
    process.log("releases ended", releases=tear_down(releases, settings.wait_seconds, clock))


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("teardown", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
