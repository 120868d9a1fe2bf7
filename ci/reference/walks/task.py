"""The walk of a task to a commit: a manager of a vehicle and a cloud, in whose catalogue is one application."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ci.reference.walks.recording import Route, WalkRecorder
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.adapters.argocd import ArgoCDServer
from robotkube.delivery.manager.adapters.kubernetes_cluster import KubernetesCluster
from robotkube.delivery.manager.core.composition.accumulated_state import Contribution
from robotkube.delivery.manager.core.composition.expansion import Expansion
from robotkube.delivery.manager.core.composition.inputs import Composition, Demand
from robotkube.delivery.manager.core.conflicts import Resolution
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.core.plans import Change, Plan
from robotkube.delivery.manager.core.standing_demands import StandingDemands
from robotkube.delivery.manager.loops.main_reader import MainReader
from robotkube.delivery.manager.loops.planner import ManagerSettings, Planner
from robotkube.delivery.manager.loops.proposals.plan_observer import PlanObserver
from robotkube.delivery.manager.loops.reconciler import TASKS, ApplicationManager
from robotkube.delivery.manager.ports.manager_ports import ManagerPorts
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.registry.evidence.adapters.dsse import TrustedKeys
from robotkube.testing.clusters import MemoryArgoCD, MemoryCluster, MemoryTasks
from robotkube.testing.forges import MemoryForge, MemoryRepository
from robotkube.testing.leadership import MemoryLeadership

START_NS = 1_795_250_000_000_000_000
CHARTS = "oci://forge.example/verified"
VEHICLE, CLOUD = "vehicle-00", "cloud-0"

Document = Mapping[str, Any]


def route() -> Route:
    """The forms of a task."""
    asked = (TaskDescription, StandingDemands, Demand)
    decided = (Expansion, Contribution, Release, Composition, Resolution, Change, Plan)
    adapters = {
        MemoryTasks: (KubernetesCluster,),
        MemoryCluster: (KubernetesCluster,),
        MemoryForge: (ProposalWriter, GiteaForge),
        MemoryRepository: (GitClone,),
        MemoryArgoCD: (ArgoCDServer,),
    }
    return Route((*asked, *decided), MemoryForge.propose, adapters, (MemoryTasks.tasks, MemoryForge.commit))


def run(recorder: WalkRecorder) -> None:
    """Have the manager find nothing to do, and record its step after a task was made."""
    with tempfile.TemporaryDirectory() as folder:
        tasks = MemoryTasks()
        manager = _manager(Path(folder), tasks)
        manager.step()
        event = {"rule": "near", "id": "event", "trace": "a" * 32, "time": "2026-11-21T10:00:00Z"}
        asked = {"application": "recording", "parameters": {"vehicle": VEHICLE}}
        tasks.create(CLOUD, "walk", {"requester": f"{CLOUD}/detector", "event": event, "reason": "near", **asked})
        manager.wake(TASKS)
        with recorder.recording():
            manager.step()


def _manager(trusted_keys: Path, tasks: MemoryTasks) -> ApplicationManager:
    """A manager of a vehicle and a cloud; its catalogue needs no evidence."""
    machines = ((VEHICLE, "vehicle"), (CLOUD, "cloud"))
    cluster = MemoryCluster([NodeState(name, name, role, frozenset(), True) for name, role in machines])
    main, published = MemoryRepository(), MemoryRepository()
    main.push({"policies/initial.yaml": "add: []\nremove: []\n"})
    published.push(_catalogue())
    forge = MemoryForge(main)
    forge.decide = forge.leave
    catalogue = AssuredCatalogue(published, TrustedKeys(trusted_keys))
    settings = ManagerSettings(tuple(Agent(name, role, name) for name, role in machines), CHARTS)
    reader = MainReader(main)
    planner = Planner(settings, tasks, cluster, catalogue, reader, Jinja2Templates().render, validate)
    observer = PlanObserver(cluster, MemoryArgoCD(), lambda call: call(), lambda: START_NS, lambda: 0.0)
    ports = ManagerPorts(tasks, cluster, main, forge, forge, MemoryLeadership())
    return ApplicationManager(ports, catalogue, reader, planner, observer, lambda: START_NS, lambda: 0.0)


def _catalogue() -> dict[str, str | None]:
    """The application `recording`, whose recorder runs in the cloud, and the bridge that carries its topic there."""
    quality = {"reliability": "reliable", "durability": "volatile", "depth": 10}
    name = "/vehicles/{{ parameters.vehicle | ros }}/pose"
    topic = {"name": name, "type": "geometry_msgs/msg/PoseStamped", "channel": "telemetry", **quality}
    link = {"kind": "mqtt", "from": {"agent": "{{ parameters.vehicle }}"}, "to": {"service": "recorder"}}
    recorder = _service("recorder", {"role": "cloud"}, {"task": "{{ task.name }}"})
    bridge = _service("bridge", {"agent": "{{ agent }}"}, {"out": "{{ topics.out }}", "in": "{{ topics['in'] }}"})
    parameters = {"vehicle": {"type": "string"}}
    return {
        "policies/release.yaml": "assurance: none\n",
        "applications/recording.yaml": _application("recording", parameters, recorder, [{**link, "topics": [topic]}]),
        "applications/bridge.yaml": _application("link/mqtt", {}, bridge, []),
        "charts/recorder/0.1.0.yaml": _chart("recorder", 1),
        "charts/bridge/0.1.0.yaml": _chart("bridge", 2),
    }


def _document(kind: str, name: str, spec: Document, **more: Document) -> str:
    head = {"apiVersion": "registry.robotkube.io/v1alpha1", "kind": kind, "metadata": {"name": name}}
    return json.dumps({**head, "spec": spec, **more})


def _service(name: str, placement: Document, values: Document) -> Document:
    chart = {"name": name, "version": ">=0.1.0"}
    return {"name": name, "release": name, "chart": chart, "placement": placement, "values": values}


def _application(provides: str, parameters: Document, service: Document, links: list[Document]) -> str:
    schema = {"type": "object", "additionalProperties": False, "required": list(parameters), "properties": parameters}
    spec = {"description": "d", "provides": [provides], "parameters": schema, "services": [service], "links": links}
    return _document("Application", provides.replace("link/mqtt", "bridge"), spec)


def _chart(name: str, number: int) -> str:
    spec = {"version": "0.1.0", "description": "d", "channel": "stable", "platforms": ["linux/amd64"], "images": []}
    return _document("ChartVersion", name, spec, status={"state": "verified", "digest": f"sha256:{number:064x}"})
