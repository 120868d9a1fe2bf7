"""The process of the console: the page that shows the fleet, what runs, and why.

Started by `robotkube-console` or `python3 -m robotkube.delivery.console`. Settings: docs/reference/console.md. Ends
with 0 on SIGTERM, 2 when the settings are wrong. It keeps nothing: all that it shows is read again after a restart.
"""

from __future__ import annotations

import os
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import urlsplit

from kubernetes import client

from robotkube.delivery.console.adapters.broker_poses import BrokerPoses
from robotkube.delivery.console.adapters.cluster_watches import ClusterWatches, ConfigMapSettings
from robotkube.delivery.console.adapters.peoples_tasks import ImpersonatedTasks
from robotkube.delivery.console.adapters.web.application import Console, ConsoleSurroundings
from robotkube.delivery.console.adapters.web.asking import AskedParties
from robotkube.delivery.console.adapters.web.openid_connect import OpenIdConnect
from robotkube.delivery.console.adapters.web.page_files import read_files
from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.adapters.web.server import AsgiServer
from robotkube.delivery.console.core.poses import PoseSampler
from robotkube.delivery.console.loops.link_reading import LinkReader
from robotkube.delivery.console.loops.model import ReadModel
from robotkube.delivery.console.loops.page_reading import CertificateReader, DetectorReader, GateReader, ManagerReader
from robotkube.delivery.console.settings import ConsoleConfiguration, read_configuration
from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.kubernetes.adapters.client import api_client
from robotkube.foundation.kubernetes.core.service_names import service_of
from robotkube.foundation.pages.adapters.http_pages import AGENT_PAGE_BYTES_MAX, HttpPages
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.health_server import HealthServer
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage
from robotkube.foundation.runtime.process import Process, run
from robotkube.robots.ros.core.topic_patterns import ros_name

GRACE_SECONDS = 8.0


class ConsoleProcess:
    """The process's parts on their adapters; nothing is asked before `run`."""

    def __init__(self, configuration: ConsoleConfiguration, api: client.ApiClient) -> None:
        self.model = ReadModel(secrets.token_hex(4), lambda: time.time_ns() // 1_000_000)
        self._pages, self._pages_of_agents = HttpPages(), HttpPages(AGENT_PAGE_BYTES_MAX)
        self._managers = [
            ManagerReader(self.model, self._pages, manager, time.monotonic) for manager in configuration.managers
        ]
        self._gate = GateReader(self.model, self._pages, configuration.gate) if configuration.gate else None
        url = configuration.certificates
        self._certificates = CertificateReader(self.model, self._pages, url) if url else None
        gate = service_of(urlsplit(configuration.gate).netloc) or ("", "")
        namespaces = (configuration.namespace, configuration.argocd_namespace, gate[0])
        self.watches = ClusterWatches(api, self.model, namespaces, configuration.agents, self._wake)
        settings = ConfigMapSettings(api)
        self._detectors = DetectorReader(
            self.model, self._pages_of_agents, settings, self.watches.detectors, time.monotonic
        )
        self._links = LinkReader(self.model, self._pages_of_agents, self.watches.bridges)
        self._poses = _poses(configuration, self.model)
        sign_in = configuration.sign_in
        trust(*configuration.authorities)
        page = read_files(configuration.page)
        encrypted = sign_in is not None and sign_in.encrypted
        around = ConsoleSurroundings(configuration.hosts, encrypted, configuration.links, page)
        provider = OpenIdConnect(sign_in, client_id_file=configuration.client_id_file) if sign_in else None
        people = People(sign_in, provider, configuration.writers)
        asking = AskedParties(configuration.managers, self._pages, ImpersonatedTasks(api))
        self.console = Console(self.model, people, asking, around)
        self.server = AsgiServer(
            self.console.app, configuration.address, configuration.listen.port, configuration.proxies
        )
        sources = [self.model.metrics, self.console.metrics, *([self._poses.metrics] if self._poses else [])]
        self.health = HealthServer(
            ready=lambda: "; ".join(self.watches.missing()) or None,
            metrics=MetricsPage(*sources).text,
            port=configuration.listen.health_port or 0,
            address=configuration.listen.address,
        )

    def _wake(self) -> None:
        for manager in self._managers:
            manager.wake()
        self._detectors.wake()
        if self._gate is not None:
            self._gate.wake()

    def run(self, stopping: threading.Event) -> None:
        """Read and serve until `stopping` is set."""
        loops = [self.watches.run, self._detectors.run, self._links.run, *(manager.run for manager in self._managers)]
        loops += [reader.run for reader in (self._poses, self._gate, self._certificates) if reader is not None]
        threads = [_started(loop, stopping) for loop in loops]
        self.health.start()
        self.server.start()
        stopping.wait()
        self._wake()
        if self._certificates is not None:
            self._certificates.wake()
        self.console.streams.stop()
        self.server.stop()
        self.health.close()
        for thread in threads:
            thread.join(1.0)
        self._pages.close()
        self._pages_of_agents.close()


def _poses(configuration: ConsoleConfiguration, model: ReadModel) -> BrokerPoses | None:
    poses = configuration.poses
    if poses is None:
        return None
    names = {ros_name(str(agent["name"])): str(agent["name"]) for agent in configuration.agents}
    return BrokerPoses(lambda: poses.broker, PoseSampler(poses.topic, names), model, model.now_ms)


def _started(loop: Callable[[threading.Event], Any], stopping: threading.Event) -> threading.Thread:
    thread = threading.Thread(target=loop, args=(stopping,), name=loop.__qualname__, daemon=True)
    thread.start()
    return thread


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Show what is there until the process shall end."""
    configuration = files.start_with_settings(process, read_configuration, environment)
    in_cluster = "KUBERNETES_SERVICE_HOST" in environment
    console = ConsoleProcess(configuration, api_client(in_cluster=in_cluster))
    signed = configuration.who_signs_in()
    process.log("started", port=console.server.port, health_port=console.health.port, sign_in=signed)
    console.run(process.stopping)


def main() -> None:
    """Run until SIGTERM; exit codes as in `foundation.runtime.process`."""
    run("console", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
