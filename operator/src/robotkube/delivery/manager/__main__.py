"""The process of the application manager.

Started by `robotkube-manager` or `python3 -m robotkube.delivery.manager`. Settings: docs/reference/settings.md. Ends
with 0 on SIGTERM, 2 when the settings are wrong, 3 when the API server does not answer within a minute of the start.
The clones of the repositories are below ROBOTKUBE_WORK (default /tmp/manager); they can be lost at any time.
"""

from __future__ import annotations

import functools
import logging
import os
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from kubernetes.client import ApiClient

from robotkube.delivery.deployment.core.policies.agents import read_declared
from robotkube.delivery.manager.adapters.argocd import ArgoCDServer
from robotkube.delivery.manager.adapters.kubernetes_cluster import KubernetesCluster
from robotkube.delivery.manager.adapters.leader_proxy import LeaderRequests
from robotkube.delivery.manager.core.broken_links import BrokenLinks, broken_links
from robotkube.delivery.manager.core.placement.placement import Agent
from robotkube.delivery.manager.loops.explain import Explainer
from robotkube.delivery.manager.loops.main_reader import MainReader
from robotkube.delivery.manager.loops.planner import ManagerSettings, Planner
from robotkube.delivery.manager.loops.proposals.plan_observer import PlanObserver
from robotkube.delivery.manager.loops.reconciler import (
    APPLICATIONS,
    CATALOGUE,
    DEPLOYMENT,
    NODES,
    TASKS,
    ApplicationManager,
)
from robotkube.delivery.manager.loops.verified_images import VerifiedImages
from robotkube.delivery.manager.ports.manager_ports import ManagerPorts
from robotkube.delivery.manager.scope_settings import read_operators, read_seconds
from robotkube.delivery.manager.task_gateways import STOP_SECONDS_MAX, task_gateway
from robotkube.delivery.manager.telemetry import ManagerTelemetry, read_traces
from robotkube.delivery.tasks.loops.device_holds import DeviceHolds
from robotkube.delivery.tasks.loops.link_reports import LinkReports
from robotkube.delivery.tasks.loops.mqtt_gateway import MqttTaskGateway, gateway_metrics
from robotkube.errors import UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.certificates.settings import read_authorities
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.core.patterns import CHARTS_URL, DNS_NAME, HTTP_URL, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.forge.adapters.git.notes import GitNotes
from robotkube.foundation.forge.adapters.push_hooks import ObjectsRelay, SignedPushHook
from robotkube.foundation.forge.connect import ForgeSettings, read_forge
from robotkube.foundation.kubernetes.adapters.client import api_client
from robotkube.foundation.kubernetes.adapters.lease import LeaseElection, identity_of
from robotkube.foundation.kubernetes.ports import Leadership
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.prometheus_series import series_text
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery
from robotkube.foundation.runtime.garbage_collection import Sweeper
from robotkube.foundation.runtime.process import Process, run
from robotkube.registry.catalogue.adapters.bounded_validation import BoundedSchemas
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.registry.charts.adapters.chart_renderer import PROGRAM, PROGRAM_VARIABLE, ChartRenderer
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.loops.release_images import ReleaseImages
from robotkube.registry.charts.ports import ChartProgram
from robotkube.registry.evidence.adapters.dsse import TrustedKeys
from robotkube.robots.bridge.core.link_reports import LinkReport
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.broker_settings import read_broker

GRACE_SECONDS = 5.0
SYNC_SECONDS_MAX = 60.0
REGISTRY_SECONDS_MAX = 5.0  # a plan waits for a chart no longer: the gate looks at it then
COMMIT_AUTHOR = "robotkube-manager"
FORMER_KEYS = (files.OCI_REGISTRY,)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ManagerConfiguration:
    """Everything the process needs, secrets included. `server_name` is the name in the certificate of the processes
    that wait for the Lease, `authorities` a file with those that may have signed it, and the gate's."""

    listen: files.Listen
    log_level: str
    forge: ForgeSettings
    argocd_url: str
    argocd_authorities: Path | None
    argocd_account: files.Credentials
    argocd_namespace: str
    argocd_project: str
    hook_url: str
    hook_secret: str
    webhook_secret: str
    gate_objects_url: str
    lease_namespace: str
    lease_name: str
    server_name: str
    broker: BrokerAccount | None
    evidence_keys: Path
    traces: str
    manager: ManagerSettings
    authorities: Path | None = None


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> ManagerConfiguration:
    """Read the settings document of the manager."""
    keys = ["listen", "log_level", "forge", "oci_registry", "evidence", "argocd", "hook", "webhook"]
    keys += ["agents", "lease", "scope", "operators", "node_lost_seconds"]
    root = reader.mapping(document, "", keys, ["broker", "traces", "gate", "managers", "authorities"])
    oci_registry = reader.mapping(root.get("oci_registry") or {}, "oci_registry", ["charts"])
    argocd = reader.mapping(
        root.get("argocd") or {}, "argocd", ["url", "credentials", "namespace", "project"], ["authorities"]
    )
    hook = reader.mapping(root.get("hook") or {}, "hook", ["url", "secret"])
    lease = reader.mapping(root.get("lease") or {}, "lease", ["namespace", "name"], ["server_name"])
    webhook = reader.mapping(root.get("webhook") or {}, "webhook", ["secret"])
    evidence = reader.mapping(root.get("evidence") or {}, "evidence", ["keys"])
    gate = reader.mapping(root.get("gate") or {}, "gate", [], ["objects"])
    agents = _agents(reader, root.get("agents"))
    listen = files.listen(reader, root.get("listen"), encrypts=True)
    if (listen.certificate is None) != (lease.get("server_name") is None):
        reader.problems.append(
            "lease.server_name: goes with listen.certificate: the name in that certificate, by which the processes of "
            "this manager verify each other; give both or neither"
        )
    return ManagerConfiguration(
        listen=listen,
        log_level=files.log_level(reader, root.get("log_level")),
        forge=read_forge(reader, root.get("forge")),
        argocd_url=reader.word(argocd.get("url"), "argocd.url", HTTP_URL),
        argocd_authorities=read_authorities(reader, argocd, "argocd"),
        argocd_account=files.credentials(reader, argocd.get("credentials"), "argocd.credentials"),
        argocd_namespace=reader.word(argocd.get("namespace"), "argocd.namespace", WORD),
        argocd_project=reader.word(argocd.get("project"), "argocd.project", WORD),
        hook_url=reader.word(hook.get("url"), "hook.url", HTTP_URL),
        hook_secret=files.secret(reader, hook.get("secret"), "hook.secret"),
        webhook_secret=files.secret(reader, webhook.get("secret"), "webhook.secret"),
        gate_objects_url=reader.word(gate.get("objects"), "gate.objects", HTTP_URL, default=""),
        lease_namespace=reader.word(lease.get("namespace"), "lease.namespace", WORD),
        lease_name=reader.word(lease.get("name"), "lease.name", WORD),
        server_name=reader.word(lease.get("server_name"), "lease.server_name", DNS_NAME, default=""),
        broker=read_broker(reader, root["broker"]) if root.get("broker") is not None else None,
        evidence_keys=Path(reader.word(evidence.get("keys"), "evidence.keys", files.PATH)),
        traces=read_traces(reader, root.get("traces")),
        manager=ManagerSettings(
            agents=agents,
            charts_url=reader.word(oci_registry.get("charts"), "oci_registry.charts", CHARTS_URL),
            operators=read_operators(reader, root, [agent.name for agent in agents]),
            node_lost_seconds=read_seconds(reader, root.get("node_lost_seconds"), "node_lost_seconds"),
        ),
        authorities=read_authorities(reader, root, ""),
    )


def _agents(reader: Reader, value: Any) -> tuple[Agent, ...]:
    agents = []
    for index, item in enumerate(reader.sequence(value, "agents")):
        path = f"agents[{index}]"
        agents.append(Agent(*read_declared(reader, item, path)))
    return tuple(agents)


class BackgroundCall:
    """One call at a time on a thread of its own; a call that comes while one is running is dropped."""

    def __init__(self) -> None:
        self._busy = threading.Semaphore(1)

    def __call__(self, call: Callable[[], None]) -> None:
        """Start the call, or drop it."""
        if self._busy.acquire(blocking=False):
            threading.Thread(target=self._run, args=(call,), daemon=True).start()

    def _run(self, call: Callable[[], None]) -> None:
        try:
            call()
        finally:
            self._busy.release()


def build_manager(
    configuration: ManagerConfiguration,
    cluster: KubernetesCluster,
    work: Path,
    schemas: BoundedSchemas,
    leadership: Leadership,
    holds: DeviceHolds,
    renderer: ChartProgram | None = None,
    links: Callable[[], Sequence[LinkReport]] = tuple,
) -> ApplicationManager:
    """The manager on its adapters; nothing is asked of the forge yet. Without a `renderer` it proposes what the gate
    alone looks at."""
    access = configuration.forge
    work.mkdir(parents=True, exist_ok=True)
    deployment = access.clone(access.deployment, work / "deployment")
    forge = access.pull_requests(access.deployment)
    secret = configuration.webhook_secret.encode()
    gate_url = configuration.gate_objects_url
    send = ObjectsRelay(gate_url, secret, access.deployment).send if gate_url else None
    proposals = access.address.writer(
        forge, work / "deployment", access.account, COMMIT_AUTHOR, time.time, access.branch, send
    )
    clone = access.clone(access.catalogue, work / "catalogue")
    catalogue = AssuredCatalogue(clone, TrustedKeys(configuration.evidence_keys))
    account = access.account
    notes = GitNotes(access.address.url, access.deployment, account.username, account.password, work / "notes")
    main = MainReader(deployment, notes)
    deployment_url = f"{access.address.url}/{access.deployment}"
    signed = configuration.hook_secret.encode()
    hook = SignedPushHook(configuration.hook_url, signed, deployment_url, branch=access.branch)
    argocd_account = (configuration.argocd_account.username, configuration.argocd_account.password)
    argocd = ArgoCDServer(
        *(configuration.argocd_url, *argocd_account, hook, configuration.argocd_project),
        configuration.argocd_authorities,
    )
    render = Jinja2Templates().render
    images = _images(configuration, renderer) if renderer else None
    ahead = schemas.ahead()
    planner = Planner(
        *(configuration.manager, cluster, cluster, catalogue, main, render, ahead.validate, holds),
        VerifiedImages(images),
        ahead.settled,
    )
    observer = PlanObserver(cluster, argocd, BackgroundCall(), time.time_ns, time.monotonic)
    broken = functools.partial(_broken_links, links, cluster)
    ports = ManagerPorts(cluster, cluster, deployment, proposals, forge, leadership, access.account.username, broken)
    sweeper = Sweeper(time.monotonic)
    return ApplicationManager(ports, catalogue, main, planner, observer, time.time_ns, time.monotonic, sweeper)


def _images(configuration: ManagerConfiguration, renderer: ChartProgram) -> ReleaseImages:
    """What releases of published charts would run."""
    url, account = configuration.forge.address.url, configuration.forge.account
    registry = OciRegistry(url, account.username, account.password, seconds=REGISTRY_SECONDS_MAX)
    return ReleaseImages(registry, configuration.manager.charts_url.rpartition("/")[2], renderer)


def renderer_of(environment: Mapping[str, str]) -> ChartRenderer | None:
    """The program that renders charts; None, with a warning, where it is not installed."""
    program = environment.get(PROGRAM_VARIABLE, PROGRAM)
    if Path(program).is_file():
        return ChartRenderer(program)
    log.warning("images are looked up by the gate alone, there is no program %s", program)
    return None


class Waker:
    """A callable that passes on what changed, once there is a manager to wake."""

    def __init__(self) -> None:
        self.manager: ApplicationManager | None = None

    def __call__(self, what: str) -> None:
        """Something changed."""
        if self.manager is not None:
            self.manager.wake(what)


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Run the manager's steps beside its watches, webhooks and pages until the process shall end."""
    configuration = files.start_with_settings(process, read_configuration, environment, FORMER_KEYS)
    trust(configuration.forge.address.authorities, configuration.authorities)
    kubeconfig = environment.get("KUBECONFIG")
    api = api_client(kubeconfig, in_cluster=kubeconfig is None)
    waker = Waker()
    namespaces = configuration.manager.operators.manager.named_namespaces
    home = configuration.lease_namespace
    cluster = KubernetesCluster(api, configuration.argocd_namespace, waker, time.time, namespaces, home)
    work = Path(environment.get("ROBOTKUBE_WORK", "/tmp/manager"))  # noqa: S108 - the pod's own volume
    schemas = BoundedSchemas()
    election = _election(configuration, api, waker, environment)
    holds = DeviceHolds(time.time_ns, lambda: waker(NODES))
    links = LinkReports(lambda: waker(APPLICATIONS))
    renderer = renderer_of(environment)
    manager = build_manager(configuration, cluster, work, schemas, election, holds, renderer, links)
    gateway = _task_gateway(configuration, api, cluster, election, holds, links)
    account = configuration.forge.account.username
    telemetry = ManagerTelemetry(manager, cluster, cluster, holds, configuration.traces, account)
    leader = LeaderRequests(election, server_name=configuration.server_name)
    server = build_server(configuration, manager, cluster, gateway, telemetry, leader)
    server.start()
    cluster.start()
    election.start()
    process.log("started", **server.ports, agents=len(configuration.manager.agents))
    if not cluster.wait_until_synced(SYNC_SECONDS_MAX):
        raise UnavailableError("; ".join(cluster.complaints()))
    waker.manager = manager
    if gateway is not None:
        gateway.start()
    threading.Thread(target=_stop_with, args=(process, manager), daemon=True).start()
    manager.run(process.stopping)
    if gateway is not None:
        gateway.stop(STOP_SECONDS_MAX)
    election.stop()
    cluster.stop()
    server.stop()
    leader.close()
    telemetry.close()
    schemas.close()
    if renderer is not None:
        renderer.close()


def _election(
    configuration: ManagerConfiguration, api: ApiClient, waker: Waker, environment: Mapping[str, str]
) -> LeaseElection:
    """The election between the pods of this manager."""
    pod = environment.get("POD_NAME") or socket.gethostname()
    host = environment.get("POD_IP") or configuration.listen.address
    identity = identity_of(pod, host, configuration.listen.port)
    lease = (configuration.lease_namespace, configuration.lease_name)
    return LeaseElection(api, *lease, identity, time.monotonic, lambda: datetime.now(UTC), lambda: waker(TASKS))


def _task_gateway(
    configuration: ManagerConfiguration,
    api: ApiClient,
    cluster: KubernetesCluster,
    leadership: Leadership,
    holds: DeviceHolds,
    links: LinkReports,
) -> MqttTaskGateway | None:
    """The MQTT task gateway for the agents of this manager's scope; None when the settings name no broker."""
    scope = configuration.manager.operators.manager
    agents = [agent for agent in configuration.manager.agents if scope.covers_agent(agent.name)]
    operators = {agent.name: agent.namespace for agent in agents}
    broker = configuration.broker
    return task_gateway(broker, operators, api, cluster, leadership, holds, links) if broker else None


def _broken_links(links: Callable[[], Sequence[LinkReport]], cluster: KubernetesCluster) -> BrokenLinks:
    """The links that bridges report as broken, as far as the cluster shows the processes that do."""
    return broken_links(links(), cluster.pods)


def _stop_with(process: Process, manager: ApplicationManager) -> None:
    process.stopping.wait()
    manager.stop(process.stopping)


def changed_by(delivery: WebhookDelivery, catalogue: str) -> tuple[str, str] | None:
    """The arguments of ApplicationManager.wake for a delivery: what may have changed, and main's new tip when the
    delivery names it. None when nothing has changed by it, as when a proposal was opened, or merged: the push of the
    merge has a delivery of its own."""
    moved = delivery.event == "push" and delivery.payload.get("ref") == "refs/heads/main"
    merged = (delivery.payload.get("pull_request") or {}).get("merged") is True
    if not moved and (delivery.payload.get("action") != "closed" or merged):
        return None
    tip = delivery.payload.get("after") if moved else ""
    return CATALOGUE if delivery.repository == catalogue else DEPLOYMENT, tip if isinstance(tip, str) else ""


def build_server(
    configuration: ManagerConfiguration,
    manager: ApplicationManager,
    cluster: KubernetesCluster,
    gateway: MqttTaskGateway | None,
    telemetry: ManagerTelemetry,
    leader: LeaderRequests,
) -> WebServer:
    """The web server: its deliveries wake the manager, its pages and answers are those of the one that leads."""

    def deliver(delivery: WebhookDelivery) -> None:
        if change := changed_by(delivery, configuration.forge.catalogue):
            manager.wake(*change)

    def metrics() -> str:
        return telemetry.text() + (series_text(gateway_metrics(gateway)) if gateway else "")

    return WebServer(
        configuration.listen.address,
        configuration.listen.port,
        lambda: [*manager.reasons_not_ready(), *cluster.complaints()],
        metrics,
        configuration.webhook_secret.encode(),
        deliver,
        {
            "/plans": manager.records.as_json,
            "/catalogue": manager.catalogue_page,
            "/updates": manager.statistics.updates_page,
        },
        posts={"/explain": Explainer(manager.what_if, cluster)},
        forward=leader,
        health_port=configuration.listen.health_port,
        certificate=configuration.listen.certificate,
    )


def main() -> None:
    """Run the manager until SIGTERM; exit codes as in `foundation.runtime.process`."""
    run("manager", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
