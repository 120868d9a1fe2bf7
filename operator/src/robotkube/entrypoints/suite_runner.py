"""`python3 -m robotkube.entrypoints.suite_runner`: runs suites for the gate, in the rooms of the pool.

Settings: docs/reference/settings.md; the program helm is /usr/local/bin/helm (another one: ROBOTKUBE_HELM). Ends with 0
on SIGTERM, 2 when the settings are wrong. Nothing is kept on disk: what ran is asked for again by the gate.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from robotkube.adapters.suite_processes import ForkedSuites
from robotkube.adapters.suite_runner_server import RunsEndpoint
from robotkube.adapters.webhooks import WebServer
from robotkube.domain.verification import SuiteRule
from robotkube.entrypoints import settings as files
from robotkube.entrypoints import suite_process
from robotkube.entrypoints.processes import Process, run
from robotkube.entrypoints.suite_settings import RunnerConfiguration, read_configuration
from robotkube.services.suite_emptying import ClusterRoomKeeper
from robotkube.services.suite_images import ImagesSuite
from robotkube.services.suite_runner import SuiteQueue
from robotkube.services.suite_static import StaticSuite

GRACE_SECONDS = 6.0
STOP_LOOK_SECONDS = 0.2
ROOMLESS = frozenset(suite.name for suite in (StaticSuite, ImagesSuite) if not suite.needs_room)


def needs_room(rule: SuiteRule) -> bool:
    """Whether a rule's suite runs something on the cluster."""
    return bool(rule.image) or rule.name not in ROOMLESS


def build_queue(found: RunnerConfiguration, environment: Mapping[str, str] = os.environ) -> SuiteQueue:
    """The queue on its adapters; nothing is asked of the world yet."""
    executor = ForkedSuites(suite_process.run_request, preload=[suite_process.__name__])
    keepers = [ClusterRoomKeeper(suite_process.room_objects(room.namespace, environment), room) for room in found.rooms]
    return SuiteQueue(executor, keepers, needs_room)


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Serve the protocol, health and metrics until the process shall end."""
    found = files.read_settings(files.settings_path(environment), read_configuration)
    files.send_logs(process, found.log_level)
    queue = build_queue(found, environment)
    endpoint = RunsEndpoint(found.token, queue.put)
    server = WebServer(
        found.listen.address, found.listen.port, queue.reasons_not_ready, queue.metrics, put=endpoint.put
    )
    queue.start()
    server.start()
    process.log("started", port=server.port, rooms=len(found.rooms))
    while not process.stopping.wait(STOP_LOOK_SECONDS):
        pass
    server.stop()
    queue.stop()


if __name__ == "__main__":
    run("suite-runner", body, grace_seconds=GRACE_SECONDS)
