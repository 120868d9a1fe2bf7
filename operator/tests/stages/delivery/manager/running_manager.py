"""The manager on a real forge, in this process; its cluster is in memory."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.loops.main_reader import MainReader
from robotkube.delivery.manager.loops.planner import ManagerSettings, Planner
from robotkube.delivery.manager.loops.proposals.plan_observer import PlanObserver
from robotkube.delivery.manager.loops.reconciler import ApplicationManager
from robotkube.delivery.manager.loops.verified_images import VerifiedImages
from robotkube.delivery.manager.ports.manager_ports import ManagerPorts
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from robotkube.foundation.forge.adapters.push_hooks import ObjectsRelay
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.registry.charts.ports import RenderedImages
from robotkube.testing.clusters import MemoryArgoCD, MemoryCluster, MemoryTasks
from robotkube.testing.leadership import MemoryLeadership
from tests.stages.delivery.manager.manager_process import AGENTS
from tests.stages.forge.catalogue_evidence import trusted_keys
from tests.stages.forge.installation import (
    CHARTS_URL,
    TERM,
    Installation,
    objects_relay,
)


@dataclass
class RunningManager:
    """The manager as its entry point wires it, but for the cluster."""

    manager: ApplicationManager
    thread: threading.Thread
    stopping: threading.Event
    tasks: MemoryTasks
    cluster: MemoryCluster
    deployment: GitClone
    forge: GiteaForge
    catalogue: AssuredCatalogue
    relay: ObjectsRelay

    def stop(self) -> None:
        self.manager.stop(self.stopping)
        self.thread.join(10)
        self.forge.disconnect()
        self.relay.disconnect()

    def plans(self) -> list[dict[str, Any]]:
        return list(self.manager.records.as_json()["plans"])

    def last_plan_is(self, step: str) -> bool:
        plans = self.plans()
        return bool(plans) and plans[-1][step] is not None


def start_manager(
    installation: Installation,
    folder: Path,
    tasks: MemoryTasks,
    leadership: MemoryLeadership | None = None,
    images: RenderedImages | None = None,
    reserved: Sequence[str] = (),
) -> RunningManager:
    """A new manager on `folder`; it leads, unless a test says otherwise. `images`: what renders releases; `reserved`:
    agents that main may enroll, whose Nodes, of vehicles, are there."""
    url = installation.url
    account = ("manager", installation.passwords["manager"])
    deployment = GitClone(url, "robotkube/deployment", *account, folder / "deployment")
    relay = objects_relay(installation)
    proposals = ProposalWriter(folder / "deployment", *account, "robotkube-manager", time.time, send_objects=relay.send)
    catalogue = AssuredCatalogue(GitClone(url, "robotkube/catalogue", *account, folder / "catalogue"), trusted_keys())
    machines = (*AGENTS, *((name, "vehicle") for name in reserved))
    nodes = [NodeState(name, name, role, frozenset({"recording"}), True) for name, role in machines]
    cluster = MemoryCluster(nodes)
    main = MainReader(deployment)
    agents = (*AGENTS, *((name, "") for name in reserved))
    settings = ManagerSettings(tuple(Agent(name, role, name) for name, role in agents), CHARTS_URL)
    render = Jinja2Templates().render
    looked_up = VerifiedImages(images)
    planner = Planner(settings, tasks, cluster, catalogue, main, render, validate, images=looked_up)
    observer = PlanObserver(cluster, MemoryArgoCD(), lambda call: call(), time.time_ns, time.monotonic)
    forge = GiteaForge(url, "robotkube/deployment", *account)
    ports = ManagerPorts(tasks, cluster, deployment, proposals, forge, leadership or MemoryLeadership(TERM))
    manager = ApplicationManager(ports, catalogue, main, planner, observer, time.time_ns, time.monotonic)
    stopping = threading.Event()
    thread = threading.Thread(target=manager.run, args=(stopping,), daemon=True)
    thread.start()
    return RunningManager(manager, thread, stopping, tasks, cluster, deployment, forge, catalogue, relay)
