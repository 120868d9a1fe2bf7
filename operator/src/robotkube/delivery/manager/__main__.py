"""`python3 -m robotkube.delivery.manager`: the application manager.

Settings: docs/reference/settings.md. Ends with 0 on SIGTERM, 2 when the settings are wrong, 3 when the API server does
not answer within a minute of the start. The clones stand below ROBOTKUBE_WORK (default /tmp/manager); they can be lost
at any time.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from kubernetes.client import ApiClient

from robotkube.delivery.manager.adapters.argocd import ArgoCDServer
from robotkube.delivery.manager.adapters.kubernetes_cluster import KubernetesCluster
from robotkube.delivery.manager.core.placement.placement import Agent
from robotkube.delivery.manager.loops.explain import Explainer
from robotkube.delivery.manager.loops.main_reader import MainReader
from robotkube.delivery.manager.loops.planner import ManagerSettings, Planner
from robotkube.delivery.manager.loops.proposals.plan_observer import PlanObserver
from robotkube.delivery.manager.loops.reconciler import (
    CATALOGUE,
    DEPLOYMENT,
    NODES,
    TASKS,
    ApplicationManager,
    ManagerPorts,
)
from robotkube.delivery.manager.scope_settings import read_operators, read_seconds
from robotkube.delivery.manager.task_gateways import STOP_SECONDS_MAX, BrokerSettings, read_broker, task_door
from robotkube.delivery.manager.telemetry import ManagerTelemetry, read_traces
from robotkube.delivery.tasks.loops.device_holds import DeviceHolds
from robotkube.delivery.tasks.loops.mqtt_gateway import MqttTaskGateway, gateway_metrics
from robotkube.errors import UnavailableError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.core.patterns import CHARTS_URL, HTTP_URL, REPOSITORY, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.forge.adapters.push_hooks import ObjectsRelay, SignedPushHook
from robotkube.foundation.forge.connect import ForgeAddress, read_address
from robotkube.foundation.kubernetes.adapters.client import api_client
from robotkube.foundation.kubernetes.adapters.leader_proxy import LeaderRequests
from robotkube.foundation.kubernetes.adapters.lease import LeaseElection, identity_of
from robotkube.foundation.kubernetes.ports import Leadership
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.prometheus_series import series_text
from robotkube.foundation.runtime.adapters.webhook_server import WebhookDelivery, WebServer
from robotkube.foundation.runtime.garbage_collection import Sweeper
from robotkube.foundation.runtime.process import Process, run
from robotkube.registry.catalogue.adapters.bounded_validation import BoundedSchemas
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.registry.evidence.adapters.dsse import TrustedKeys

GRACE_SECONDS = 5.0
SYNC_SECONDS_MAX = 60.0
COMMIT_AUTHOR = "robotkube-manager"


@dataclass(frozen=True)
class ManagerConfiguration:
    """Everything the process needs, secrets included."""

    listen: files.Listen
    log_level: str
    forge: ForgeAddress
    account: files.Credentials
    deployment: str
    catalogue: str
    branch: str
    argocd_url: str
    argocd_account: files.Credentials
    argocd_namespace: str
    argocd_project: str
    hook_url: str
    hook_secret: str
    webhook_secret: str
    gate_objects_url: str
    lease_namespace: str
    lease_name: str
    broker: BrokerSettings | None
    evidence_keys: Path
    traces: str
    manager: ManagerSettings


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> ManagerConfiguration:
    """The settings document of the manager."""
    keys = ["listen", "log_level", "forge", "registry", "evidence", "argocd", "hook", "webhook"]
    keys += ["agents", "lease", "scope", "operators", "node_lost_seconds"]
    root = reader.mapping(document, "", keys, ["broker", "traces", "gate", "managers"])
    forge_keys = ["url", "credentials", "deployment", "catalogue", "branch"]
    forge = reader.mapping(root.get("forge") or {}, "forge", forge_keys, ["kind", "api"])
    registry = reader.mapping(root.get("registry") or {}, "registry", ["charts"])
    argocd = reader.mapping(root.get("argocd") or {}, "argocd", ["url", "credentials", "namespace", "project"])
    hook = reader.mapping(root.get("hook") or {}, "hook", ["url", "secret"])
    lease = reader.mapping(root.get("lease") or {}, "lease", ["namespace", "name"])
    webhook = reader.mapping(root.get("webhook") or {}, "webhook", ["secret"])
    evidence = reader.mapping(root.get("evidence") or {}, "evidence", ["keys"])
    gate = reader.mapping(root.get("gate") or {}, "gate", [], ["objects"])
    agents = _agents(reader, root.get("agents"))
    return ManagerConfiguration(
        listen=files.listen(reader, root.get("listen")),
        log_level=files.log_level(reader, root.get("log_level")),
        forge=read_address(reader, forge),
        account=files.credentials(reader, forge.get("credentials"), "forge.credentials"),
        deployment=reader.word(forge.get("deployment"), "forge.deployment", REPOSITORY),
        catalogue=reader.word(forge.get("catalogue"), "forge.catalogue", REPOSITORY),
        branch=reader.word(forge.get("branch"), "forge.branch", WORD),
        argocd_url=reader.word(argocd.get("url"), "argocd.url", HTTP_URL),
        argocd_account=files.credentials(reader, argocd.get("credentials"), "argocd.credentials"),
        argocd_namespace=reader.word(argocd.get("namespace"), "argocd.namespace", WORD),
        argocd_project=reader.word(argocd.get("project"), "argocd.project", WORD),
        hook_url=reader.word(hook.get("url"), "hook.url", HTTP_URL),
        hook_secret=files.secret(reader, hook.get("secret"), "hook.secret"),
        webhook_secret=files.secret(reader, webhook.get("secret"), "webhook.secret"),
        gate_objects_url=reader.word(gate.get("objects"), "gate.objects", HTTP_URL, default=""),
        lease_namespace=reader.word(lease.get("namespace"), "lease.namespace", WORD),
        lease_name=reader.word(lease.get("name"), "lease.name", WORD),
        broker=read_broker(reader, root.get("broker")),
        evidence_keys=Path(reader.word(evidence.get("keys"), "evidence.keys", files.PATH)),
        traces=read_traces(reader, root.get("traces")),
        manager=ManagerSettings(
            agents=agents,
            charts_url=reader.word(registry.get("charts"), "registry.charts", CHARTS_URL),
            operators=read_operators(reader, root, [agent.name for agent in agents]),
            node_lost_seconds=read_seconds(reader, root.get("node_lost_seconds"), "node_lost_seconds"),
        ),
    )


def _agents(reader: Reader, value: Any) -> tuple[Agent, ...]:
    found = []
    for index, item in enumerate(reader.sequence(value, "agents")):
        path = f"agents[{index}]"
        agent = reader.mapping(item, path, ["name", "role", "namespace", "records"])
        words = [reader.word(agent.get(key), f"{path}.{key}", WORD) for key in ("name", "role", "namespace")]
        found.append(Agent(*words))
    return tuple(found)


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
    found: ManagerConfiguration,
    cluster: KubernetesCluster,
    work: Path,
    schemas: BoundedSchemas,
    leadership: Leadership,
    holds: DeviceHolds,
) -> ApplicationManager:
    """The manager on its adapters; nothing is asked of the forge yet."""
    url, account, branch = found.forge.url, found.account, found.branch
    work.mkdir(parents=True, exist_ok=True)
    deployment = found.forge.clone(found.deployment, account, work / "deployment", branch)
    forge = found.forge.pull_requests(found.deployment, account, branch)
    gate, secret = found.gate_objects_url, found.webhook_secret.encode()
    send = ObjectsRelay(gate, secret, found.deployment).send if gate else None
    proposals = found.forge.writer(forge, work / "deployment", account, COMMIT_AUTHOR, time.time, branch, send)
    clone = found.forge.clone(found.catalogue, account, work / "catalogue", branch)
    catalogue = AssuredCatalogue(clone, TrustedKeys(found.evidence_keys))
    main = MainReader(deployment)
    hook = SignedPushHook(found.hook_url, found.hook_secret.encode(), f"{url}/{found.deployment}", branch=found.branch)
    argocd_account = (found.argocd_account.username, found.argocd_account.password)
    argocd = ArgoCDServer(found.argocd_url, *argocd_account, hook, found.argocd_project)
    render = Jinja2Templates().render
    planner = Planner(found.manager, cluster, cluster, catalogue, main, render, schemas.validate, holds)
    observer = PlanObserver(cluster, argocd, BackgroundCall(), time.time_ns, time.monotonic)
    world = ManagerPorts(cluster, cluster, deployment, proposals, forge, leadership, found.account.username)
    rest = Sweeper(time.monotonic)
    return ApplicationManager(world, catalogue, main, planner, observer, time.time_ns, time.monotonic, rest)


class Waker:
    """Passes on what changed once there is a manager to wake."""

    def __init__(self) -> None:
        self.manager: ApplicationManager | None = None

    def __call__(self, what: str) -> None:
        """Something changed."""
        if self.manager is not None:
            self.manager.wake(what)


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Watch, serve webhooks and pages, run the manager's steps until the process shall end."""
    found = files.read_settings(files.settings_path(environment), read_configuration)
    files.send_logs(process, found.log_level)
    kubeconfig = environment.get("KUBECONFIG")
    api = api_client(kubeconfig, in_cluster=kubeconfig is None)
    waker = Waker()
    scope, home = found.manager.operators.manager, found.lease_namespace
    cluster = KubernetesCluster(api, found.argocd_namespace, waker, time.time, scope.named_namespaces, home)
    work = Path(environment.get("ROBOTKUBE_WORK", "/tmp/manager"))  # noqa: S108 - the pod's own volume
    schemas = BoundedSchemas()
    election = _election(found, api, waker, environment)
    holds = DeviceHolds(time.time_ns, lambda: waker(NODES))
    manager = build_manager(found, cluster, work, schemas, election, holds)
    door = _door(found, api, cluster, election, holds)
    names = [agent.name for agent in found.manager.agents]
    account = found.account.username
    telemetry = ManagerTelemetry(manager, cluster, cluster, names, holds, found.traces, account)
    leader = LeaderRequests(election)
    server = _server(found, manager, cluster, door, telemetry, leader)
    server.start()
    cluster.start()
    election.start()
    process.log("started", port=server.port, agents=len(found.manager.agents))
    if not cluster.wait_until_synced(SYNC_SECONDS_MAX):
        raise UnavailableError("; ".join(cluster.complaints()))
    waker.manager = manager
    if door is not None:
        door.start()
    threading.Thread(target=_stop_with, args=(process, manager), daemon=True).start()
    manager.run(process.stopping)
    if door is not None:
        door.stop(STOP_SECONDS_MAX)
    election.stop()
    cluster.stop()
    server.stop()
    leader.close()
    telemetry.close()
    schemas.close()


def _election(
    found: ManagerConfiguration, api: ApiClient, waker: Waker, environment: Mapping[str, str]
) -> LeaseElection:
    """The election between the pods of this manager."""
    pod, host = environment.get("POD_NAME") or socket.gethostname(), environment.get("POD_IP") or found.listen.address
    identity = identity_of(pod, host, found.listen.port)
    lease = (found.lease_namespace, found.lease_name)
    return LeaseElection(api, *lease, identity, time.monotonic, lambda: datetime.now(UTC), lambda: waker(TASKS))


def _door(
    found: ManagerConfiguration, api: ApiClient, cluster: KubernetesCluster, leadership: Leadership, holds: DeviceHolds
) -> MqttTaskGateway | None:
    """The MQTT door for the agents of this manager's scope, when the settings name a broker."""
    scope = found.manager.operators.manager
    operators = {agent.name: agent.namespace for agent in found.manager.agents if scope.covers_agent(agent.name)}
    return task_door(found.broker, operators, api, cluster, leadership, holds) if found.broker else None


def _stop_with(process: Process, manager: ApplicationManager) -> None:
    process.stopping.wait()
    manager.stop(process.stopping)


def news(delivery: WebhookDelivery, catalogue: str) -> tuple[str, str] | None:
    """What to wake the manager with: what may have changed, and main's new tip when the delivery says it. None for what
    is no news, such as that a proposal was opened, or that one was merged: the push that did it is told for itself."""
    moved = delivery.event == "push" and delivery.payload.get("ref") == "refs/heads/main"
    merged = (delivery.payload.get("pull_request") or {}).get("merged") is True
    if not moved and (delivery.payload.get("action") != "closed" or merged):
        return None
    tip = delivery.payload.get("after") if moved else ""
    return CATALOGUE if delivery.repository == catalogue else DEPLOYMENT, tip if isinstance(tip, str) else ""


def _server(
    found: ManagerConfiguration,
    manager: ApplicationManager,
    cluster: KubernetesCluster,
    door: MqttTaskGateway | None,
    telemetry: ManagerTelemetry,
    leader: LeaderRequests,
) -> WebServer:
    def deliver(delivery: WebhookDelivery) -> None:
        if heard := news(delivery, found.catalogue):
            manager.wake(*heard)

    def metrics() -> str:
        return telemetry.text() + (series_text(gateway_metrics(door)) if door else "")

    return WebServer(
        found.listen.address,
        found.listen.port,
        lambda: [*manager.reasons_not_ready(), *cluster.complaints()],
        metrics,
        found.webhook_secret.encode(),
        deliver,
        {"/plans": manager.records.as_json, "/catalogue": manager.catalogue_page},
        posts={"/explain": Explainer(manager.what_if, cluster)},
        forward=leader,
    )


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("manager", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
