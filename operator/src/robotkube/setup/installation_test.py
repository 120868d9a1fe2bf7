"""The process `robotkube-installation-test`: has one recording made by a task, and withdraws it again (`helm test`).

Settings: docs/reference/settings.md. Exit code 0 when a message was recorded and task and recording have ended; 2
with a sentence about what failed, or about the settings.
"""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.database.adapters.connection import connect, read_account
from robotkube.foundation.documents.core.patterns import NAME, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.process import Process, run
from robotkube.setup.adapters.installation_task import KubernetesTask
from robotkube.setup.adapters.recorded_events import DatabaseRecording
from robotkube.setup.loops.installation_test import TestClock, TestedPlatform, try_installation

GRACE_SECONDS = 4.0
NAME_BYTES = 4
"""Random ones in the name of each test's task: recordings of two tests have two names."""


@dataclass(frozen=True)
class InstallationTestSettings:
    """The settings of the Job: `application` with `parameters` is asked for in the name of `agent`, whose account of
    the database is in the folder `database`; where the platform and Argo CD are, for its words."""

    log_level: str
    agent: str
    application: str
    parameters: Mapping[str, Any]
    database: Path
    platform_namespace: str
    argocd_namespace: str


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> InstallationTestSettings:
    """Read the settings document of the Job."""
    keys = ["log_level", "agent", "application", "parameters", "database", "platform_namespace", "argocd_namespace"]
    root = reader.mapping(document, "", keys)
    return InstallationTestSettings(
        log_level=files.log_level(reader, root.get("log_level")),
        agent=reader.word(root.get("agent"), "agent", NAME),
        application=reader.word(root.get("application"), "application", NAME),
        parameters=reader.keys_of(root).any_mapping("parameters"),
        database=Path(reader.word(root.get("database"), "database", files.PATH)),
        platform_namespace=reader.word(root.get("platform_namespace"), "platform_namespace", WORD),
        argocd_namespace=reader.word(root.get("argocd_namespace"), "argocd_namespace", WORD),
    )


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Wire API server and database to the test, and say how long it took."""
    settings = files.start_with_settings(process, read_configuration, environment)
    name = f"installation-test-{secrets.token_hex(NAME_BYTES)}"
    task = KubernetesTask(
        ApiServer.from_environment(environment),
        settings.agent,
        name,
        settings.application,
        settings.parameters,
        time_text(time.time_ns()),
    )
    asking = f"{settings.agent}/{name}"
    database = connect(read_account(settings.database))
    process.log("asks", task=asking, application=settings.application)
    result = try_installation(
        task,
        DatabaseRecording(database, f"{settings.agent}.{name}"),
        TestedPlatform(settings.platform_namespace, settings.argocd_namespace, asking, settings.application),
        TestClock(time.monotonic, lambda seconds: not process.stopping.wait(seconds)),
    )
    database.client.close()
    if result.problem:
        raise InputError(result.problem)
    recorded, ended = round(result.recorded_seconds, 1), round(result.ended_seconds, 1)
    process.log("recorded one event, and withdrew it", task=asking, recorded_seconds=recorded, ended_seconds=ended)


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("installation-test", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
