"""The process of the inspector: it compares what runs with what may run, and names what is strange.

Started by `robotkube-inspector` or `python3 -m robotkube.delivery.inspection`. Settings: docs/reference/settings.md.
Ends with 0 on SIGTERM, 2 when the settings are wrong. Clones stand below ROBOTKUBE_WORK (default /tmp/inspector) and
can be lost at any time.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path

from robotkube.delivery.inspection.adapters.kubelets import RIGHT, Kubelets
from robotkube.delivery.inspection.adapters.kubernetes_inspections import KubernetesInspections
from robotkube.delivery.inspection.adapters.kubernetes_workloads import KubernetesWorkloads
from robotkube.delivery.inspection.loops.inspector import Inspector
from robotkube.delivery.inspection.loops.looks import NodeLooks, ReleaseLooks
from robotkube.delivery.inspection.loops.permitted import PermittedReader
from robotkube.delivery.inspection.loops.release_shapes import ReleaseShapes
from robotkube.delivery.inspection.loops.reporting import Reporter
from robotkube.delivery.inspection.settings import InspectorConfiguration, read_configuration
from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.kubernetes.adapters.http_client import ACCOUNT_FOLDER, ApiServer
from robotkube.foundation.kubernetes.adapters.kubelet_client import KubeletClient
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.health_server import HealthServer
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage
from robotkube.foundation.runtime.process import Process, run
from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing
from robotkube.registry.charts.adapters.chart_renderer import PROGRAM, PROGRAM_VARIABLE, ChartRenderer
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.loops.release_images import ReleaseObjects
from robotkube.registry.charts.ports import ChartProgram
from robotkube.registry.evidence.adapters.dsse import TrustedKeys

GRACE_SECONDS = 5.0
CONTROLLER = "inspector"


def build_source(configuration: InspectorConfiguration, work: Path, renderer: ChartProgram) -> PermittedReader:
    """What may run, on its adapters; nothing is asked of the forge yet."""
    forge = configuration.forge
    work.mkdir(parents=True, exist_ok=True)
    catalogue = forge.clone(forge.catalogue, work / "catalogue")
    deployment = forge.clone(forge.deployment, work / "deployment")
    registry = OciRegistry(forge.address.url, forge.account.username, forge.account.password)
    objects = ReleaseObjects(registry, (configuration.charts_url.rpartition("/")[2],), renderer)
    return PermittedReader(
        CatalogueListing(catalogue, TrustedKeys(configuration.keys)),
        ReleaseShapes(deployment, objects, time.monotonic),
        configuration.installation,
        time.monotonic,
    )


def build_inspector(
    configuration: InspectorConfiguration, api: ApiServer, source: PermittedReader, reporter: Reporter
) -> Inspector:
    """The inspector on the cluster's adapters; nothing is asked of it yet."""
    authority = api.authority_file if configuration.verify else None
    client = KubeletClient(RIGHT, authority, api.token_file or ACCOUNT_FOLDER / "token")
    nodes = Kubelets(api, client)
    looks = (NodeLooks(time.time), ReleaseLooks(KubernetesWorkloads(api)))
    return Inspector(nodes, looks, source, reporter, time.monotonic)


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Look, and serve health and metrics, until the process shall end."""
    configuration = files.start_with_settings(process, read_configuration, environment)
    trust(configuration.forge.address.authorities)
    work = Path(environment.get("ROBOTKUBE_WORK", "/tmp/inspector"))  # noqa: S108 - the pod's own volume
    renderer = ChartRenderer(environment.get(PROGRAM_VARIABLE, PROGRAM))
    api = ApiServer.from_environment(environment)
    inspections = KubernetesInspections(api, configuration.namespace, CONTROLLER, time.time)
    reporter = Reporter(inspections, time.time_ns)
    inspector = build_inspector(configuration, api, build_source(configuration, work, renderer), reporter)
    server = HealthServer(
        ready=lambda: "; ".join(inspector.reasons_not_ready()) or None,
        metrics=MetricsPage(reporter.metrics).text,
        port=configuration.listen.port,
        address=configuration.listen.address,
    )
    server.start()
    process.log("started", port=server.port, agents=len(configuration.installation.domain.agents))
    inspector.run(process.stopping)
    inspector.stop()
    server.close()
    renderer.close()


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("inspector", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
