"""The process of the remover: it takes away what inspections name as strangers, in agents' namespaces.

Started by `robotkube-remover` or `python3 -m robotkube.delivery.removal`. Settings: docs/reference/settings.md. Ends
with 0 on SIGTERM, 2 when the settings are wrong. Nothing is kept: what still stands there is named again.
"""

from __future__ import annotations

import os
import random
import time
from collections.abc import Mapping

from robotkube.delivery.removal.adapters.removal_cluster import KubernetesRemoval
from robotkube.delivery.removal.loops.remover import Remover
from robotkube.delivery.removal.settings import read_configuration
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.process import Process, run

GRACE_SECONDS = 12.0  # of which one request may take 10


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Remove, and serve health and metrics, until the process shall end."""
    settings = files.start_with_settings(process, read_configuration, environment)
    cluster = KubernetesRemoval(ApiServer.from_environment(environment), settings.namespace, time.time_ns)
    remover = Remover(cluster, settings.policy, time.monotonic, time.time_ns, random.random)
    listen = settings.listen
    server = WebServer(listen.address, listen.port, remover.reasons_not_ready, MetricsPage(remover.metrics).text)
    server.start()
    process.log("started", **server.ports, agents=len(settings.policy.agents))
    remover.run(process.stopping)
    server.stop()


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("remover", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
