"""`robotkube task explain`, `release list` and `trace` on a manager in memory, asked as through the API server."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.cli.main import main
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.deployment.core.releases import application_name
from robotkube.delivery.manager.core.updates.states import WAITING, ReleaseUpdate
from robotkube.delivery.manager.core.updates.steps import Updates
from robotkube.delivery.manager.loops.explain import Explainer
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from tests.stages.delivery.manager.manager_in_memory import Stage

PROXY = "/api/v1/namespaces/robotkube/services/manager:8080/proxy"
TASKS = "/apis/robotkube.io/v1alpha1/taskdescriptions?limit=5000"
PODS = "/api/v1/pods?limit=5000&labelSelector=robotkube.io%2Fagent"
APPLICATIONS = "/apis/argoproj.io/v1alpha1/namespaces/argocd/applications?limit=5000"
SPEC = {"application": "pose-point-cloud-recording", "parameters": {"vehicles": ["vehicle-01", "vehicle-02"]}}
RECORDER = "cloud-0/recorder-vehicle-00-vehicle-01"


class Line:
    """The command line in front of the stage."""

    def __init__(self, stage: Stage, folder: Path, capture: pytest.CaptureFixture[str]) -> None:
        self.stage, self._capture = stage, capture
        self.key = stage.ask()
        stage.settle()
        [name] = [key.partition("/")[2] for key in stage.tasks.objects]
        task = "/apis/robotkube.io/v1alpha1/namespaces/cloud-0/taskdescriptions/" + name
        self.pages: dict[str, Any] = {
            f"{PROXY}/plans": stage.manager.records.as_json,
            f"{PROXY}/updates": stage.manager.statistics.updates_page,
            TASKS: lambda: {"items": list(stage.tasks.objects.values())},
            task: lambda: stage.tasks.objects[self.key],
            PODS: lambda: {"items": self._pods()},
            APPLICATIONS: lambda: {"items": self._applications()},
        }
        explainer = Explainer(stage.manager.what_if, stage.tasks)
        self.server = WebServer("127.0.0.1", 0, list, str, pages=self.pages, posts={f"{PROXY}/explain": explainer})
        self.server.start()
        cluster = {"name": "c", "cluster": {"server": f"http://127.0.0.1:{self.server.port}"}}
        context = {"name": "c", "context": {"cluster": "c", "user": "c"}}
        access = {"clusters": [cluster], "contexts": [context], "users": [{"name": "c", "user": {}}]}
        self.kubeconfig = folder / "kubeconfig"
        self.kubeconfig.write_text(yaml.safe_dump({"apiVersion": "v1", "current-context": "c", **access}))

    def _applications(self) -> list[Mapping[str, Any]]:
        applications = []
        for release in self.stage.releases().values():
            name = application_name(release.namespace, release.name)
            metadata = {"name": name, "annotations": {"robotkube.io/plan": release.plan}}
            source = {"repoURL": f"oci://x/{release.chart}", "helm": {"releaseName": release.name}}
            spec = {"destination": {"namespace": release.namespace}, "source": source}
            status = {"sync": {"status": "Synced"}, "health": {"status": "Healthy"}}
            applications.append({"metadata": metadata, "spec": spec, "status": status})
        return applications

    def _pods(self) -> list[Mapping[str, Any]]:
        labels = {"app.kubernetes.io/instance": RECORDER.partition("/")[2]}
        metadata = {"namespace": "cloud-0", "name": "recorder-0", "labels": labels}
        status = {"phase": "Running", "startTime": "2026-11-21T10:00:00Z"}
        return [{"metadata": metadata, "spec": {"nodeName": "cloud-0"}, "status": status}]

    def run(self, *words: str) -> tuple[int, str, str]:
        code = main([*words, "--kubeconfig", str(self.kubeconfig)])
        out, err = self._capture.readouterr()
        return code, out, err


@pytest.fixture
def line(stage: Stage, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Iterator[Line]:
    stage_line = Line(stage, tmp_path, capsys)
    yield stage_line
    stage_line.server.stop()


def test_explaining_a_task_that_is_there(line: Line) -> None:
    code, out, _ = line.run("task", "explain", line.key)
    assert code == 0
    assert "Accepted=True Accepted" in out
    assert f"recorder -> {RECORDER}" in out
    assert "+++" not in out


def test_what_would_go_is_listed_before_a_task_is_withdrawn(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Platform, "withdraw", lambda self, key, dry_run: None)
    code, out, err = line.run("task", "withdraw", line.key, "--dry-run")
    assert (code, err.splitlines()[0]) == (0, f"would withdraw: {line.key}")
    assert f"stops {RECORDER} (event-detector 0.2.3)" in out
    assert "changes vehicle-00/mqtt-bridge (mqtt-bridge 0.2.3)" in out
    code, out, _ = line.run("task", "withdraw", line.key, "--dry-run", "--output", "json")
    assert json.loads(out)["releases"] == [RECORDER]
    assert line.key in line.stage.tasks.objects


def test_why_it_was_taken_is_explained_when_it_runs(line: Line) -> None:
    assert "Accepted (generation 1): recorder -> " in line.run("task", "explain", line.key)[1]


def test_explaining_a_task_that_is_not_submitted(line: Line, tmp_path: Path) -> None:
    file = tmp_path / "task.yaml"
    file.write_text(yaml.safe_dump({"metadata": {"name": "next", "namespace": "cloud-0"}, "spec": SPEC}))
    code, out, _ = line.run("task", "explain", "-f", str(file), "--dry-run")
    assert code == 0
    assert "cloud-0/next is accepted" in out
    assert "+++ b/releases/cloud-0/recorder-vehicle-01-vehicle-02.yaml" in out
    assert "--- a/releases/vehicle-01/mqtt-bridge.yaml" in out
    code, out, _ = line.run("task", "explain", "-f", str(file), "--output", "json")
    assert json.loads(out)["outcome"] == "Accepted"


def test_explaining_a_refusal(line: Line) -> None:
    words = ("task", "explain", "--namespace", "cloud-0", "--application", "nothing")
    code, out, err = line.run(*words)
    assert code == 1
    assert "is refused, UnknownApplication" in out
    said = err.splitlines()[-1]  # what the manager in this process logs may stand before it
    assert said.startswith("robotkube: UnknownApplication: the catalogue has no application 'nothing'")


def test_explaining_needs_one_subject(line: Line) -> None:
    assert line.run("task", "explain", line.key, "--application", "x")[0] == 2
    assert line.run("task", "explain", "cloud-0")[0] == 2


def test_releases_with_their_demands_and_nodes(line: Line) -> None:
    code, out, _ = line.run("release", "list", "--output", "json")
    by_release = {row["release"]: row for row in json.loads(out)["releases"]}
    assert (code, by_release[RECORDER]["demands"], by_release[RECORDER]["nodes"]) == (0, [line.key], ["cloud-0"])
    assert line.key in by_release["vehicle-00/mqtt-bridge"]["demands"]
    assert by_release["cloud-0/event-detector"]["demands"] == []
    assert by_release[RECORDER]["update"] == ""


def test_releases_that_an_update_is_not_through_with(line: Line) -> None:
    state = ReleaseUpdate(WAITING, "event-detector 0.3.0 follows when it has succeeded for vehicle-00/event-detector")
    line.stage.manager.statistics.updates = Updates(states={RECORDER: state})
    [row] = [row for row in line.run("release", "list")[1].splitlines() if row.startswith(RECORDER)]
    assert "waiting: event-detector 0.3.0 follows" in row
    del line.pages[f"{PROXY}/updates"]
    assert "waiting" not in line.run("release", "list")[1]


@pytest.mark.parametrize("what", ["event-meeting", "a" * 32, "cloud-0/meeting", "plan"])
def test_tracing_from_event_to_pods(line: Line, what: str) -> None:
    [plan] = [plan for plan in line.stage.plans() if plan["tasks"]]
    code, out, _ = line.run("trace", plan["plan"] if what == "plan" else what, "--output", "json")
    assert code == 0
    rows = [(row["step"], row["name"]) for row in json.loads(out)["steps"]]
    expected = [("event", "event-meeting"), ("task", line.key), ("plan", plan["plan"]), ("commit", plan["commit"])]
    expected += [("Application", application_name(*RECORDER.split("/"))), ("pod", "cloud-0/recorder-0")]
    assert [row for row in rows if row in expected] == expected
    assert ("pull request", str(plan["pull_request"])) in rows


def test_tracing_to_the_recordings_of_a_task(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    """By their provenance: two namespaces may have a task of one name, and a recording has any."""
    known = [
        {"recording": name, "task": task, "started": None, "state": "ended", "agent": "cloud-0"}
        for name, task in (("cloud-0.meeting", line.key), ("meeting", "other/meeting"), ("meeting-1", None))
    ]
    monkeypatch.setattr("robotkube.cli.recordings.commands.list_all", lambda _: Table("recordings", (), known))
    code, out, _ = line.run("trace", line.key, "--recordings", "--output", "json")
    assert code == 0
    steps = json.loads(out)["steps"]
    assert [row["name"] for row in steps if row["step"] == "recording"] == ["cloud-0.meeting"]


def test_tracing_a_task_that_was_withdrawn(line: Line) -> None:
    line.stage.tasks.delete(line.key)
    line.stage.settle()
    code, out, _ = line.run("trace", "a" * 32)
    assert (code, "withdrawn" in out) == (0, True)


def test_tracing_nothing(line: Line) -> None:
    code, out, err = line.run("trace", "nothing")
    assert (code, out) == (1, "")
    assert "no task and no plan has to do with nothing" in err
