"""`robotkube wait` on a real API server without controllers: the test says what workloads and pods are."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import pytest

from robotkube.cli.live import component_lines
from robotkube.cli.live.rollouts import DEPLOYMENT, JOB, STATEFUL_SET
from robotkube.cli.main import main
from robotkube.cli.platform import GATE_SELECTOR
from tests.stages.kubernetes.api_calls import Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.kubernetes.component_pods import STATES, pod, workload
from tests.stages.programs import free_port
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

PLATFORM, GATE, ARGOCD = "waited", "waited-gate", "waited-argocd"
PLACES = {
    DEPLOYMENT: "/apis/apps/v1/namespaces/{}/deployments",
    STATEFUL_SET: "/apis/apps/v1/namespaces/{}/statefulsets",
    JOB: "/apis/batch/v1/namespaces/{}/jobs",
    "Pod": "/api/v1/namespaces/{}/pods",
}
VERSIONS = {DEPLOYMENT: "apps/v1", STATEFUL_SET: "apps/v1", JOB: "batch/v1"}
TIME = "2026-11-27T10:00:00Z"
DONE = {
    "startTime": TIME,
    "completionTime": TIME,
    "succeeded": 1,
    "conditions": [{"type": kind, "status": "True"} for kind in ("SuccessCriteriaMet", "Complete")],
}
WAITS = {"waiting": {"reason": "ImagePullBackOff", "message": "no such image"}}


@dataclass
class Installation:
    """What is installed in three namespaces, and the command that waits for it."""

    api: Api
    server: ApiServerProcess
    capture: pytest.CaptureFixture[str]
    out: str = ""
    err: str = ""
    made: list[str] = field(default_factory=list)

    def add(self, name: str, kind: str = DEPLOYMENT, namespace: str = PLATFORM, part: str = "robotkube") -> None:
        """A workload, of which nothing is there yet."""
        item = workload(name, kind=kind, namespace=namespace, part=part)
        labels = {"app": name}
        container = {"name": "one", "image": "example.com/one:1"}
        template: dict[str, Any] = {"metadata": {"labels": labels}, "spec": {"containers": [container]}}
        spec: dict[str, Any] = {"replicas": 1, "selector": {"matchLabels": labels}, "template": template}
        if kind == JOB:
            template["spec"]["restartPolicy"] = "Never"
            spec = {"template": template}
        document = {"apiVersion": VERSIONS[kind], "kind": kind, "metadata": item["metadata"], "spec": spec}
        self._post(PLACES[kind].format(namespace), name, document)

    def add_pod(self, name: str, namespace: str, **status: Any) -> None:
        """A pod that is not ready."""
        item = pod(name, namespace=namespace, **status)
        document = {**item, "apiVersion": "v1", "spec": {"containers": [{"name": "one", "image": "one:1"}]}}
        self._post(PLACES["Pod"].format(namespace), name, document)
        self.api.merge(f"{PLACES['Pod'].format(namespace)}/{name}/status", {"status": item["status"]})

    def warn(self, name: str, namespace: str, message: str) -> None:
        """A warning about an object."""
        about = {"kind": "Pod", "namespace": namespace, "name": name}
        metadata = {"namespace": namespace, "name": f"{name}.1"}
        event = {"metadata": metadata, "involvedObject": about, "type": "Warning", "reason": "Failed"}
        self._post(f"/api/v1/namespaces/{namespace}/events", metadata["name"], {**event, "message": message})

    def finish(self, name: str, kind: str = DEPLOYMENT, namespace: str = PLATFORM) -> None:
        """A workload becomes what it shall be."""
        status = DONE if kind == JOB else STATES[kind][True]
        self.api.merge(f"{PLACES[kind].format(namespace)}/{name}/status", {"status": status})

    def wait(self, *words: str) -> int:
        """The exit code of the command, once it has ended."""
        spaces = ("--platform-namespace", PLATFORM, "--argocd-namespace", ARGOCD)
        return main(["wait", "--kubeconfig", str(self.server.kubeconfig), *spaces, *words])

    def read(self) -> tuple[list[str], str]:
        """The lines of stdout, and stderr, so far."""
        out, err = self.capture.readouterr()
        self.out, self.err = self.out + out, self.err + err
        return self.out.splitlines(), self.err

    def said(self, text: str) -> None:
        """Return when stdout has that."""
        until(lambda: any(text in line for line in self.read()[0]), text, state=lambda: (self.out, self.err))

    def _post(self, path: str, name: str, document: Mapping[str, Any]) -> None:
        self.api.post(path, document)
        self.made.append(f"{path}/{name}")


@pytest.fixture
def installation(api: Api, api_server: ApiServerProcess, capsys: pytest.CaptureFixture[str]) -> Iterator[Installation]:
    """With namespaces in which nothing is."""
    present = {item["metadata"]["name"] for item in api.get("/api/v1/namespaces")["items"]}
    of_gate = dict(label.split("=") for label in GATE_SELECTOR.split(","))
    for name in {PLATFORM, GATE, ARGOCD} - present:
        metadata = {"name": name, "labels": of_gate if name == GATE else {}}
        api.post("/api/v1/namespaces", {"apiVersion": "v1", "kind": "Namespace", "metadata": metadata})
    made = Installation(api, api_server, capsys)
    yield made
    for path in made.made:
        api.delete(path)


@pytest.fixture
def pool() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor() as made:
        yield made


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """What hangs is said soon."""
    monkeypatch.setattr(component_lines, "SILENT_SECONDS_MAX", 0.2)
    monkeypatch.setattr(component_lines, "POLL_SECONDS", 0.05)


@pytest.mark.usefixtures("impatient")
def test_each_component_has_a_line_until_all_are_ready(installation: Installation, pool: ThreadPoolExecutor) -> None:
    installation.add("argocd-server", namespace=ARGOCD, part="argocd")
    installation.finish("argocd-server", namespace=ARGOCD)
    steps = (
        ("gate", DEPLOYMENT, GATE),
        ("forge", STATEFUL_SET, PLATFORM),
        ("bootstrap", JOB, PLATFORM),
        ("manager", DEPLOYMENT, PLATFORM),
    )
    for name, kind, namespace in steps:
        installation.add(name, kind, namespace)
    ended = pool.submit(installation.wait)
    installation.said("manager is not ready")
    for name, kind, namespace in steps:
        assert not ended.done()
        installation.finish(name, kind, namespace)
        installation.said(f"{name}: {'done' if kind == JOB else 'ready'} after ")
    assert ended.result(30) == 0
    lines, err = installation.read()
    assert [line.partition(" after ")[0] for line in lines if "not ready" not in line] == [
        "gate: ready",
        "forge: ready",
        "bootstrap: done",
        "manager: ready",
    ]
    assert err == f"robotkube: ready: all 5 components in {PLATFORM}, {GATE}, {ARGOCD}\n"


GATE_HANGS = (
    "gate is not ready: pod gate-0: container one waits: ImagePullBackOff: no such image; "
    "event Failed: Failed to pull image"
)
SERVER_HANGS = (
    "argocd-server is not ready: Deployment argocd-server: 0 of 1 pods are ready; event Failed: exceeded quota"
)


def hang(installation: Installation) -> None:
    """The gate's image is not there, and Argo CD gets no pod."""
    installation.add("argocd-server", namespace=ARGOCD, part="argocd")
    installation.add("gate", namespace=GATE)
    containers = [{"name": "one", "image": "one:1", "imageID": "", "ready": False, "restartCount": 0, "state": WAITS}]
    installation.add_pod("gate-0", GATE, phase="Pending", containerStatuses=containers)
    installation.warn("gate-0", GATE, "Failed to pull image")
    installation.warn("argocd-server", ARGOCD, "exceeded quota")


def test_what_hangs_at_the_end_is_named_with_its_warnings(installation: Installation) -> None:
    hang(installation)
    assert installation.wait("--seconds", "0.2") == 1
    assert installation.read() == (
        [SERVER_HANGS, GATE_HANGS],
        "robotkube: NotReady: after 0.2 s not ready: argocd-server, gate\n",
    )


@pytest.mark.usefixtures("impatient")
def test_what_hangs_is_said_meanwhile(installation: Installation, pool: ThreadPoolExecutor) -> None:
    hang(installation)
    ended = pool.submit(installation.wait)
    installation.said(SERVER_HANGS)
    installation.said(GATE_HANGS)
    assert not ended.done()
    installation.finish("argocd-server", namespace=ARGOCD)
    installation.finish("gate", namespace=GATE)
    assert ended.result(30) == 0


def test_programs_read_a_document_for_each_line(installation: Installation) -> None:
    installation.add("argocd-server", namespace=ARGOCD, part="argocd")
    installation.finish("argocd-server", namespace=ARGOCD)
    installation.add("forge", STATEFUL_SET)
    assert installation.wait("--seconds", "0.2", "-o", "json") == 1
    (line,), _ = installation.read()
    document = json.loads(line)
    assert document.pop("seconds") >= 0
    assert document == {
        "component": "forge",
        "state": "not ready",
        "reasons": ["StatefulSet forge: 0 of 1 pods are ready"],
    }


def test_where_nothing_is_installed_it_says_what_to_do(installation: Installation) -> None:
    assert installation.wait() == 2
    installation.add("gate", namespace=GATE)
    assert installation.wait() == 2
    lines, err = installation.read()
    assert lines == []
    assert err == (
        f"robotkube: nothing of the platform is installed in namespace {PLATFORM}: install charts/robotkube by helm, "
        "or name another --platform-namespace\n"
        f"robotkube: no Argo CD is installed in namespace {ARGOCD}: install it, or name another --argocd-namespace\n"
    )


def test_seconds_have_bounds(installation: Installation) -> None:
    assert installation.wait("--seconds", "0") == 2
    assert installation.read()[1] == "robotkube: --seconds 0: give seconds above 0, at most 86400\n"


def test_an_api_server_that_does_not_answer_is_told(installation: Installation, tmp_path: Any) -> None:
    file = tmp_path / "kubeconfig"
    text = installation.server.kubeconfig.read_text()
    file.write_text(text.replace(f":{installation.server.port}", f":{free_port()}"))
    assert main(["wait", "--kubeconfig", str(file), "--seconds", "5"]) == 3
    assert installation.read()[1].startswith("robotkube: API server: GET /api/v1/namespaces")
