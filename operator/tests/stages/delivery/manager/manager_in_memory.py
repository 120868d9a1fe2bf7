"""A manager with everything around it in memory; its catalogue is the project's own, published with evidence."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from robotkube.delivery.deployment.core.releases import Release, read_tree
from robotkube.delivery.manager.core.broken_links import BrokenLinks, broken_links
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.loops.main_reader import MainReader
from robotkube.delivery.manager.loops.planner import ManagerSettings, Planner
from robotkube.delivery.manager.loops.proposals.plan_observer import PlanObserver
from robotkube.delivery.manager.loops.reconciler import (
    APPLICATIONS,
    DEPLOYMENT,
    TASKS,
    ApplicationManager,
    ManagerPorts,
)
from robotkube.delivery.manager.loops.verified_images import VerifiedImages
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.catalogue.adapters.bounded_validation import ValidationAhead
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.registry.charts.core.packing import published_digest
from robotkube.registry.charts.ports import RenderedImages
from robotkube.registry.evidence.core.statements import Artefact, Listing
from robotkube.robots.bridge.core.link_reports import LinkReport
from robotkube.testing.clusters import MemoryArgoCD, MemoryCluster, MemoryTasks
from robotkube.testing.forges import MemoryForge, MemoryRepository
from robotkube.testing.leadership import MemoryLeadership
from tests.stages.paths import REGISTRY, REPOSITORY
from tests.stages.registry.answering import Answering
from tests.stages.registry.signed_evidence import (
    PLATFORM,
    POLICY_TEXT,
    Remembering,
    Signing,
    application_evidence,
    seeded_key,
    signing_key,
    trusting,
)
from tests.stages.waiting import WAIT_SECONDS_MAX

CHARTS = "oci://forge.robotkube.svc.cluster.local:3000/verified"
MEETING = "cloud-0/meeting"
SEED = 7
START_NS = 1795250000_000000000


@cache
def schema_file(chart: str, version: str) -> Mapping[str, str]:
    """The values schema of a chart of this project, with its values as default, as the gate publishes it."""
    folders = [REPOSITORY / "charts" / folder / chart for folder in ("apps", "earlier")]
    source = next(f for f in folders if yaml.safe_load((f / "Chart.yaml").read_text())["version"] == version)
    schema = json.loads((source / "values.schema.json").read_text())
    schema["default"] = yaml.safe_load((source / "values.yaml").read_text())
    return {f"charts/{chart}/{version}.schema.json": json.dumps(schema, indent=1, sort_keys=True) + "\n"}


@cache
def catalogue_files(images: tuple[str, ...] = ()) -> Mapping[str, str]:
    """The project's own catalogue, published with evidence by the key of `SEED`; its charts run these images."""
    signing = Signing(seeded_key(SEED))
    files = {str(p.relative_to(REGISTRY)): p.read_text() for p in REGISTRY.glob("applications/*.yaml")}
    for path in sorted(REGISTRY.glob("charts/*/*.yaml")):
        files |= chart_files(signing, path.parent.name, path.stem, images)
    return {**files, "policies/release.yaml": "assurance: verified\n", "policies/verification.yaml": POLICY_TEXT}


@cache
def _entry(path: str) -> Mapping[str, Any]:
    document: Mapping[str, Any] = yaml.safe_load((REGISTRY / path).read_text())
    return document


def chart_files(signing: Signing, chart: str, version: str, images: Sequence[str]) -> dict[str, str]:
    """A version of one of the project's charts, published with evidence."""
    path = f"charts/{chart}/{version}.yaml"
    document = {**_entry(path)}
    index = sorted(REGISTRY.glob("charts/*/*.yaml")).index(REGISTRY / path)
    digest = f"sha256:{index + 1:012x}{index:052x}"  # sources are named by the first twelve
    about = Artefact(chart, version, digest, PLATFORM)
    schema = schema_file(chart, version)
    signing.listed = Listing(published_digest(document["spec"], images), sha256("".join(schema.values()).encode()))
    envelopes = signing.sign(about)
    status = {"state": "verified", "digest": digest, "images": list(images), "evidence": sha256(envelopes["summary"])}
    document["status"] = {**status, "policy": signing.policy.digest}
    evidence = {f"{about.folder}/{name}.json": data.decode() for name, data in envelopes.items()}
    return {path: yaml.safe_dump(document), **schema, **evidence}


class UntilPaused(threading.Event):
    """Ends the loop that waits for it, which the manager's does after a failed step."""

    def wait(self, timeout: float | None = None) -> bool:
        self.set()
        return True


class Stage:
    """Everything around one manager; the clock moves only when a test moves it."""

    notified: Sequence[str] = ()
    images: RenderedImages | None = None
    links: Sequence[LinkReport] = ()

    def __init__(self, folder: Path, vehicles: int = 3, image: str = "", images: RenderedImages | None = None) -> None:
        """`image` is what the catalogue's charts run, `images` what releases would run when they are rendered."""
        self.images = images
        key = self.key = signing_key(folder / "key", SEED)
        self.verifier = Remembering(trusting(folder / "trusted", key))
        names = [(f"vehicle-{i:02d}", "vehicle") for i in range(vehicles)] + [("cloud-0", "cloud")]
        self.settings = ManagerSettings(tuple(Agent(name, role, name) for name, role in names), CHARTS)
        capabilities = {"cloud": frozenset({"recording"})}
        self.cluster = MemoryCluster(
            [NodeState(name, name, role, capabilities.get(role, frozenset()), True) for name, role in names]
        )
        self.repository, self.catalogue = MemoryRepository(), MemoryRepository()
        self.repository.push({"policies/initial.yaml": "add: []\nremove: []\n"}, "seed")
        self.catalogue.push(catalogue_files((image,) if image else ()), "seed")
        self.forge = MemoryForge(self.repository)
        self.tasks = MemoryTasks()
        self.argocd = MemoryArgoCD()
        self.leadership = MemoryLeadership()
        self.seconds = 0.0
        self.manager = self.start()

    def start(self) -> ApplicationManager:
        """A new process: nothing is remembered."""

        def now_ns() -> int:
            return START_NS + int(self.seconds * 1e9)

        def monotonic() -> float:
            return self.seconds

        def at_once(call: Callable[[], None]) -> None:
            call()

        catalogue = AssuredCatalogue(self.catalogue, self.verifier)
        main = MainReader(self.repository)
        render = Jinja2Templates().render
        looked_up = VerifiedImages(self.images)
        ahead = ValidationAhead(Answering())
        given = (self.settings, self.tasks, self.cluster, catalogue, main, render, ahead.validate)
        planner = Planner(*given, images=looked_up, settled=ahead.settled)
        observer = PlanObserver(self.cluster, self.argocd, at_once, now_ns, monotonic)
        forge = (self.repository, self.forge, self.forge)
        ports = ManagerPorts(self.tasks, self.cluster, *forge, self.leadership, broken_links=self.broken_links)
        return ApplicationManager(ports, catalogue, main, planner, observer, now_ns, monotonic)

    def broken_links(self) -> BrokenLinks:
        return broken_links(self.links, self.cluster.pods)

    def go(self, steps: int = 4, seconds: float = 0.1, wake: str = TASKS) -> None:
        self.manager.wake(wake)
        for _ in range(steps):
            self.manager.step()
            self.seconds += seconds
            self.notify()

    def notify(self) -> None:
        """Wake the manager as gate and forge do for proposals: not for main when a person moved it."""
        states = [pull.state for pull in self.forge.pulls.values()]
        if states != self.notified:
            self.notified = states
            self.manager.wake(DEPLOYMENT)

    def fail(self) -> None:
        """One turn of the loop in which the world does not answer."""
        stopping = UntilPaused()
        bound = threading.Timer(WAIT_SECONDS_MAX, stopping.set)
        bound.start()
        self.manager.wake(TASKS)
        self.manager.run(stopping)
        bound.cancel()

    def settle(self) -> None:
        """Propose, merge, let Argo CD finish, observe."""
        self.go()
        self.cluster.settle(self.releases())
        self.go(wake=APPLICATIONS)

    def releases(self) -> dict[str, Release]:
        tree = read_tree(self.repository.files(self.repository.tip, ("releases", "sources")))
        assert tree.problems == ()
        return dict(tree.releases)

    def publish_again(self, chart: str, version: str, images: Sequence[str]) -> None:
        """The chart version as if it had been published with these images."""
        self.catalogue.push(chart_files(Signing(self.key), chart, version, images))

    def applications_signed(self) -> dict[str, str | None]:
        """Statements about all applications of the catalogue as they stand."""
        signed: dict[str, str | None] = {}
        for path, text in self.catalogue.trees[self.catalogue.tip].items():
            if path.startswith("applications/"):
                signed |= application_evidence(self.key, path.split("/")[1].removesuffix(".yaml"), text)
        return signed

    def ask(self, name: str = "meeting", vehicles: tuple[str, ...] = ("vehicle-00", "vehicle-01"), **spec: Any) -> str:
        event = {"rule": "lidar-proximity", "id": f"event-{name}", "trace": "a" * 32, "time": "2026-11-21T10:00:00Z"}
        document = {
            "requester": "cloud-0/event-detector",
            "event": event,
            "reason": f"{', '.join(vehicles)} within 400 m",
            "application": "pose-point-cloud-recording",
            "parameters": {"vehicles": list(vehicles)},
            **spec,
        }
        self.tasks.create("cloud-0", name, document)
        return f"cloud-0/{name}"

    def plans(self) -> list[dict[str, Any]]:
        return list(self.manager.records.as_json()["plans"])
