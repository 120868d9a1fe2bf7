"""The process of the suite-runner: it runs suites for the gate, in the test namespaces of the pool.

Started by `robotkube-suite-runner` or `python3 -m robotkube.registry.suites`. Settings:
docs/reference/settings.md; the program helm is /usr/local/bin/helm (another one: ROBOTKUBE_HELM). Ends with 0
on SIGTERM, 2 when the settings are wrong. Nothing is kept on disk: what ran is asked for again by the gate.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.process import Process, run
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites import run_process
from robotkube.registry.suites.adapters.forked_runs import ForkedSuites
from robotkube.registry.suites.adapters.runner_protocol import RunsEndpoint
from robotkube.registry.suites.loops.images import ImagesSuite
from robotkube.registry.suites.loops.namespace_cleanup import ClusterNamespaceCleaner
from robotkube.registry.suites.loops.queue import SuiteQueue
from robotkube.registry.suites.loops.static import StaticSuite
from robotkube.registry.suites.settings import FORMER_KEYS, RunnerConfiguration, read_configuration

GRACE_SECONDS = 6.0
STOP_POLL_SECONDS = 0.2
WITHOUT_NAMESPACE = frozenset(suite.name for suite in (StaticSuite, ImagesSuite) if not suite.needs_namespace)


def needs_namespace(rule: SuiteRule) -> bool:
    """Return whether a rule's suite runs something on the cluster."""
    return bool(rule.image) or rule.name not in WITHOUT_NAMESPACE


def build_queue(configuration: RunnerConfiguration, environment: Mapping[str, str] = os.environ) -> SuiteQueue:
    """The queue on its adapters; nothing is asked of cluster or forge yet."""
    executor = ForkedSuites(run_process.run_request, preload=[run_process.__name__])
    cleaners = [
        ClusterNamespaceCleaner(run_process.namespace_objects(settings.namespace, environment), settings)
        for settings in configuration.test_namespaces
    ]
    return SuiteQueue(executor, cleaners, needs_namespace)


def build_server(configuration: RunnerConfiguration, queue: SuiteQueue) -> WebServer:
    """The web server: requests for runs go into the queue."""
    return WebServer(
        configuration.listen.address,
        configuration.listen.port,
        queue.reasons_not_ready,
        MetricsPage(queue.metrics).text,
        put=RunsEndpoint(configuration.token, queue.put).put,
        health_port=configuration.listen.health_port,
        certificate=configuration.listen.certificate,
    )


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Serve the protocol, health and metrics until the process shall end."""
    configuration = files.start_with_settings(process, read_configuration, environment, FORMER_KEYS)
    queue = build_queue(configuration, environment)
    server = build_server(configuration, queue)
    queue.start()
    server.start()
    process.log("started", **server.ports, test_namespaces=len(configuration.test_namespaces))
    while not process.stopping.wait(STOP_POLL_SECONDS):
        pass
    server.stop()
    queue.stop()


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("suite-runner", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
