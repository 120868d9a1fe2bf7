"""Test namespaces and suite runs in memory: one whose course a test decides, one with a simple kubelet, an Executor."""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.evidence.core.statements import Artefact, Check, SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.core.requests import SuiteRequest
from robotkube.registry.suites.ports.suites import Object, PodEnd, PodRun, Render, Subject, SuiteAccount

CHART = "greeter"
DIGEST = sha256(b"greeter")
ENTRY: Mapping[str, Any] = {
    "kind": "ChartVersion",
    "metadata": {"name": CHART},
    "spec": {
        "version": "0.2.0",
        "suites": {
            "sets": [
                {"name": "one", "values": {"placement": {"agent": "{{ agent }}"}, "word": "hello"}},
                {"name": "two", "values": {"placement": {"agent": "{{ agent }}"}, "word": "good day"}},
            ]
        },
    },
}


def deployment(name: str = CHART, **pod: Any) -> dict[str, Any]:
    """A Deployment of one container."""
    spec = {
        "containers": [{"name": "main", "image": "i@sha256:0"}],
        "terminationGracePeriodSeconds": 3,
        "nodeSelector": {"robotkube.io/agent": "cloud-0"},
        **pod,
    }
    labels = {"app": name}
    template = {"metadata": {"labels": labels}, "spec": spec}
    return {
        "apiVersion": "apps/v1",
        "kind": "Deployment",
        "metadata": {"name": name},
        "spec": {"replicas": 1, "selector": {"matchLabels": labels}, "template": template},
    }


def make_subject(
    render: Render | None = None,
    entry: Mapping[str, Any] = ENTRY,
    version: str = "0.2.0",
    images: Mapping[str, str] | None = None,
    replaced: Subject | None = None,
) -> Subject:
    """A chart under test that renders one Deployment."""
    artefact = Artefact(CHART, version, DIGEST, "linux/amd64")
    chosen = render or (lambda values, release: [deployment(release)])
    return Subject(artefact, entry, {"Chart.yaml": b""}, b"tgz", images or {}, chosen, replaced)


def make_request(suite: str = "install", seconds: int = 30, attempt: str = "a1", **rule: Any) -> SuiteRequest:
    """A request for one suite on that chart."""
    artefact = Artefact(CHART, "0.2.0", DIGEST, "linux/amd64")
    suite_rule = SuiteRule(suite, "1", seconds, **rule)
    return SuiteRequest(artefact, f"staging/{CHART}", sha256(b"policy"), suite_rule, ENTRY, attempt=attempt)


@dataclass
class MemoryTestNamespace:
    """A test namespace in memory whose course a test decides. `readiness` answers wait_ready in order (then: ready),
    `runs` run_pod, `ends` delete, `pods_seen` pods; `log` is what each pod logged."""

    namespace: str = "robotkube-suite-0"
    agent: str = "cloud-0"
    domain_id: int = 90
    seconds_left: float = 100.0
    readiness: list[str] = field(default_factory=list)
    runs: list[PodRun] = field(default_factory=list)
    ends: list[Sequence[PodEnd]] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
    calls: list[tuple[str, Any]] = field(default_factory=list)
    objects: dict[tuple[str, str], Object] = field(default_factory=dict)
    on_apply: Callable[[Sequence[Object]], None] | None = None
    pods_seen: list[Sequence[Object]] = field(default_factory=list)
    log: str = ""

    def provide(self, config_maps: Mapping[str, Mapping[str, str]]) -> None:
        """Note the ConfigMaps."""
        self.calls += [("provide", name) for name in config_maps]

    def apply(self, objects: Sequence[Object]) -> None:
        """Keep the objects."""
        if self.on_apply:
            self.on_apply(objects)
        self.calls.append(("apply", [item["metadata"]["name"] for item in objects]))
        self.objects |= {(item["kind"], item["metadata"]["name"]): item for item in objects}

    def delete(self, objects: Sequence[Object], seconds: float) -> Sequence[PodEnd]:
        """Remove objects; the next of `ends`."""
        self.calls.append(("delete", [item["metadata"]["name"] for item in objects]))
        for item in objects:
            self.objects.pop((item["kind"], item["metadata"]["name"]), None)
        return self.ends.pop(0) if self.ends else []

    def wait_ready(self, kind: str, name: str, seconds: float) -> str:
        """The next of `readiness`."""
        return self.readiness.pop(0) if self.readiness else ""

    def pods(self) -> Sequence[Object]:
        """The next of `pods_seen`, else one per Deployment."""
        if self.pods_seen:
            return self.pods_seen.pop(0)
        deployments = [item for (kind, _), item in self.objects.items() if kind == "Deployment"]
        return [{**item["spec"]["template"], "kind": "Pod"} for item in deployments]

    def logs(self, pod: str) -> str:
        """The log."""
        return self.log

    def run_pod(
        self,
        name: str,
        image: str,
        command: Sequence[str],
        files: Mapping[str, bytes],
        seconds: float,
        volume_claim: bool = False,
        accounts: bool = False,
    ) -> PodRun:
        """The next of `runs`, else one that ended well and said nothing."""
        self.calls.append(("run_pod", {"name": name, "image": image, "command": command, "files": files}))
        return self.runs.pop(0) if self.runs else PodRun("", 0)

    def start_broker(self) -> SuiteAccount:
        """Note the call; an account of a broker."""
        self.calls.append(("start_broker", None))
        return SuiteAccount("suite", "password", "10.0.0.1", 1883)

    def start_database(self) -> SuiteAccount:
        """Note the call; an account of a database."""
        self.calls.append(("start_database", None))
        return SuiteAccount("suite", "password", "10.0.0.2", 27017, "recordings_suite")

    def broker_log(self) -> str:
        """An empty log."""
        return ""

    def leftovers(self) -> list[str]:
        """The leftovers that a test decides, and what was not deleted."""
        return sorted([*self.left, *(f"{kind} {name}" for kind, name in self.objects)])


@dataclass
class MemoryNamespaceObjects:
    """The objects of a test namespace in memory: applying a Deployment makes a pod. `start(pod)` gives a new pod's
    status, `finish(pod)` that of a deleted one, or None when it stays; `refuse(object)` may raise."""

    start: Callable[[Object], Mapping[str, Any]] = lambda pod: RUNNING
    finish: Callable[[Object], Mapping[str, Any] | None] = lambda pod: ENDED
    refuse: Callable[[Object], None] = lambda item: None
    objects: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)
    secrets: dict[str, Mapping[str, str]] = field(default_factory=dict)
    said: list[dict[str, Any]] = field(default_factory=list)
    texts: dict[str, str] = field(default_factory=dict)
    pending: list[tuple[str, Object]] = field(default_factory=list)
    created: list[str] = field(default_factory=list)

    def list(self, kind: str) -> tuple[Sequence[Object], str]:
        """Copies of the objects of a kind, and a resourceVersion."""
        return [copy.deepcopy(item) for (key, _), item in sorted(self.objects.items()) if key == kind], "1"

    def get(self, kind: str, name: str) -> Object | None:
        """A copy of an object, or None."""
        return copy.deepcopy(self.objects.get((kind, name)))

    def create(self, kind: str, body: Object) -> None:
        """Create an object; refused when it is there."""
        name = body["metadata"]["name"]
        if (kind, name) in self.objects or (kind == "Secret" and name in self.secrets):
            raise UnavailableError(f"{kind} {name} is there")
        self.created.append(f"{kind} {name}")
        if kind == "Secret":
            self.secrets[name] = body["stringData"]
            return
        item = copy.deepcopy(dict(body))
        if kind == "Pod":
            item["status"] = copy.deepcopy(dict(self.start(item)))
        self.objects[kind, name] = item

    def apply(self, body: Object) -> None:
        """Make or replace an object; a Deployment gets a new pod."""
        self.refuse(body)
        kind = body["kind"]
        name = body["metadata"]["name"]
        self.objects[kind, name] = copy.deepcopy(dict(body))
        if kind == "Deployment":
            self._roll(body, name)

    def _roll(self, body: Object, name: str) -> None:
        template = body["spec"]["template"]
        pod = {"kind": "Pod", "metadata": {"name": f"{name}-1", "labels": template["metadata"]["labels"]}}
        self.objects.pop(("Pod", f"{name}-1"), None)
        self.create("Pod", {**pod, "spec": template["spec"]})
        ready = self.objects["Pod", f"{name}-1"]["status"] == RUNNING
        counts = {"replicas": 1, "updatedReplicas": 1, "availableReplicas": int(ready)}
        self.objects["Deployment", name] |= {"status": counts}

    def delete(self, kind: str, name: str, grace_seconds: int | None = None) -> None:
        """Delete an object with its pod, unless that stays."""
        if kind == "Secret":
            self.secrets.pop(name, None)
        elif kind == "Pod":
            self._end(name)
        else:
            self.objects.pop((kind, name), None)
            if kind == "Deployment":
                self._end(f"{name}-1")

    def _end(self, name: str) -> None:
        item = self.objects.get(("Pod", name))
        status = self.finish(item) if item else None
        if item and status is not None:
            item["status"] = status
            item["metadata"]["deletionTimestamp"] = "2026-11-21T10:00:03Z"
            item["metadata"]["deletionGracePeriodSeconds"] = 3
            self.pending.append(("DELETED", self.objects.pop(("Pod", name))))

    def log(self, pod: str, container: str, bytes_max: int, lines_max: int = 0, previous: bool = False) -> str:
        """The log that a test decides, of `pod`, `pod container` or `pod container before`."""
        keys = [f"{pod} {container} before"] if previous else [f"{pod} {container}", pod]
        return next((self.texts[key] for key in keys if key in self.texts), "")

    def events(self, kind: str, name: str) -> Sequence[Object]:
        """The events that a test decides."""
        return self.said

    def changes(self, kind: str, version: str, seconds: float) -> Iterator[tuple[str, Object]]:
        """The watch events since the last call."""
        pending = self.pending
        self.pending = []
        yield from pending


RUNNING: Mapping[str, Any] = {
    "phase": "Running",
    "podIP": "10.0.0.9",
    "conditions": [{"type": "Ready", "status": "True"}],
    "containerStatuses": [{"name": "main", "ready": True, "state": {"running": {}}}],
}
ENDED: Mapping[str, Any] = {
    "phase": "Succeeded",
    "containerStatuses": [
        {"name": "main", "state": {"terminated": {"exitCode": 0, "finishedAt": "2026-11-21T10:00:01Z"}}}
    ],
}


@dataclass
class MemoryNamespaceKeeper:
    """A test namespace to be emptied, in memory; raises the next of `troubles`."""

    name: str = "robotkube-suite-0"
    troubles: list[Exception] = field(default_factory=list)
    emptied: int = 0

    def empty(self, seconds: float) -> None:
        """Count the call."""
        if self.troubles:
            raise self.troubles.pop(0)
        self.emptied += 1


@dataclass
class MemoryExecutor:
    """An executor of suites that waits for `go`, then gives `result(request)`."""

    result: Callable[[SuiteRequest], SuiteResult] = lambda request: passed(request)
    go: threading.Event = field(default_factory=threading.Event)
    executed: list[tuple[str, str]] = field(default_factory=list)

    def execute(self, request: SuiteRequest, namespace: str) -> SuiteResult:
        """The result that a test decides."""
        self.executed.append((request.rule.name, namespace))
        if not self.go.wait(10):
            raise UnavailableError("the test did not let it go on")
        return self.result(request)

    def stop(self) -> None:
        """End all waiting."""
        self.go.set()


def passed(request: SuiteRequest) -> SuiteResult:
    """A result with one check that passed."""
    return SuiteResult(request.rule.name, request.rule.version, "passed", (Check("one", True),), 0.1)


def failed(request: SuiteRequest) -> SuiteResult:
    """A result with one check that failed."""
    check = Check("one", False, "found", "fix")
    return SuiteResult(request.rule.name, request.rule.version, "failed", (check,), 0.1)
