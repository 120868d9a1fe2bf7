"""The parts of a run that need no cluster: asking for players, CPU accounting, readiness, bounded
waits."""

from __future__ import annotations

import json
import shlex
import struct
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from ci.cluster.embedded.disk_volumes import end_of
from ci.errors import SetUpError
from scenarios import definition
from scenarios.runner import __main__, running, waiting
from scenarios.runner.observing import broker, collecting, cpu, pods
from scenarios.runner.platform import deployment, inspection
from scenarios.runner.platform.access import Endpoint
from scenarios.runner.playing import cables, policy, readiness
from tests.stages.paths import SCENARIOS

FOLDER = SCENARIOS / "pose-point-cloud-db-recording"
UID = "0f9d3a52-8c1e-4b7e-9a57-2f1b6c0d4e11"


class FolderVolumes:
    """Volumes below a folder: `<namespace>/<claim>`; those of the namespace `away` cannot be reached."""

    def __init__(self, top: Path) -> None:
        self.top = top

    def use(self, volume_claims: Sequence[tuple[str, str]]) -> None:
        if any(namespace == "away" for namespace, _ in volume_claims):
            raise SetUpError("away")

    def place(self, volume_claim: tuple[str, str], folder: Path) -> bool:
        raise NotImplementedError

    def make(self, volume_claim: tuple[str, str], folder: str) -> None:
        raise NotImplementedError

    def fetch(self, volume_claim: tuple[str, str], path: str) -> Path:
        return self.top.joinpath(*volume_claim, path)

    def end_of(self, volume_claim: tuple[str, str], path: str, length: int) -> bytes:
        return end_of(self.top.joinpath(*volume_claim, path), length)


@pytest.fixture
def scenario() -> definition.Scenario:
    return definition.load(FOLDER, variant="small")


# policy ---------------------------------------------------------------------------------------------------------------


def test_the_person_asks_for_players_and_the_scenario_s_distances(scenario: definition.Scenario) -> None:
    text = policy.changed("add: []\nremove: []\n", scenario)
    assert text
    assert yaml.safe_load(text) == {
        "add": [
            {"application": "bag-player", "forRole": "vehicle"},
            {
                "application": "proximity-operator",
                "agents": ["cloud-0"],
                "parameters": {
                    "agents": ["vehicle-00", "vehicle-01"],
                    "application": "pose-point-cloud-recording",
                    "start_distance_m": 400,
                    "stop_distance_m": 500,
                },
            },
        ],
        "remove": [],
    }
    assert policy.changed(text, scenario) is None


def test_what_others_asked_for_is_kept(scenario: definition.Scenario) -> None:
    others = {
        "add": [{"application": "video", "agents": ["cloud-0"]}],
        "remove": [{"application": "a", "agents": ["b"]}],
    }
    text = policy.changed(yaml.safe_dump(others), scenario)
    assert text
    document = yaml.safe_load(text)
    assert document["add"][0] == others["add"][0]
    assert document["remove"] == others["remove"]
    assert len(document["add"]) == 3


def test_other_distances_are_another_change(scenario: definition.Scenario) -> None:
    text = policy.changed("", scenario)
    assert text
    other = definition.load(FOLDER, ["start_distance_m=300"], "small")
    changed = policy.changed(text, other)
    assert changed
    assert len(yaml.safe_load(changed)["add"]) == 2


def test_the_catalogue_offers_what_the_person_asks_for(scenario: definition.Scenario) -> None:
    """Names and parameters are those of registry/applications."""
    for addition in policy.wanted(scenario):
        file = FOLDER.parents[1] / "registry" / "applications" / f"{addition['application']}.yaml"
        parameters = yaml.safe_load(file.read_text())["spec"]["parameters"]["properties"]
        assert set(addition.get("parameters", {})) <= set(parameters)


# readiness ------------------------------------------------------------------------------------------------------------


def application(plan: str = "p1", sync: str = "Synced", health: str = "Healthy") -> dict[str, Any]:
    status = {"sync": {"status": sync}, "health": {"status": health}}
    return {"metadata": {"annotations": {"robotkube.io/plan": plan}}, "status": status}


PLAN = {
    "plan": "p1",
    "subject": "deploy: one",
    "cause": "task",
    **{key: [] for key in ("tasks", "events", "changed", "created", "removed")},
}


@pytest.mark.parametrize(
    ("times", "missing"),
    [
        ({}, []),  # the manager began after it was on main
        ({"started": 1, "merged": 2}, ["plan p1 is not observed"]),
        ({"started": 1, "merged": 2, "observed": 3}, []),
        ({"started": 1, "error": "not observed within 900 s"}, []),
    ],
)
def test_a_run_waits_for_the_plans_that_the_manager_waits_for(times: dict[str, Any], missing: list[str]) -> None:
    access = SimpleNamespace(service_json=lambda *_: {"plans": [{**PLAN, **times}]})
    waiting = readiness.Readiness(access, None, None)  # type: ignore[arg-type]
    assert list(waiting._plans()) == missing


@pytest.mark.parametrize(
    ("found", "problem"),
    [
        (application(), ""),
        (None, "Argo CD has no Application for it yet"),
        (application(plan="p0"), "Argo CD does not know plan p1 yet"),
        (application(sync="OutOfSync"), "OutOfSync, Healthy"),
        (application(health="Progressing"), "Synced, Progressing"),
        ({"metadata": {"annotations": {"robotkube.io/plan": "p1"}}}, "not compared, health not known"),
    ],
)
def test_a_release_is_ready_when_argo_cd_runs_its_plan(found: Any, problem: str) -> None:
    releases = {"cloud-0/event-detector": {"metadata": {"annotations": {"robotkube.io/plan": "p1"}}}}
    applications = {} if found is None else {"cloud-0-event-detector": found}
    expected = [f"cloud-0/event-detector: {problem}"] if problem else []
    assert list(readiness.not_observed(releases, applications)) == expected


def test_digests_of_releases_do_not_depend_on_the_plan() -> None:
    first = {"a/b": {"metadata": {"annotations": {"robotkube.io/plan": "p1"}}, "spec": {"values": {"x": 1}}}}
    second = {"a/b": {"metadata": {"annotations": {"robotkube.io/plan": "p2"}}, "spec": {"values": {"x": 1}}}}
    third = {"a/b": {"metadata": {}, "spec": {"values": {"x": 2}}}}
    assert deployment.specification_digests(first) == deployment.specification_digests(second)
    assert deployment.specification_digests(first) != deployment.specification_digests(third)


# CPU ------------------------------------------------------------------------------------------------------------------


def group(root: Path, path: str, seconds: float) -> Path:
    folder = root / path
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cpuacct.usage").write_text(f"{int(seconds * 1e9)}\n")
    return folder


def test_cpu_is_summed_by_component_also_of_pods_that_came_and_went(tmp_path: Path) -> None:
    group(tmp_path, "daemons/etcd", 10)
    group(tmp_path, "daemons/vehicle-00.kubelet", 5)
    group(tmp_path, "daemons/vehicle-01.kubelet", 5)
    sampler = cpu.CpuSampler(tmp_path)
    sampler.start()
    group(tmp_path, "daemons/etcd", 11)
    group(tmp_path, "daemons/vehicle-00.kubelet", 6)
    group(tmp_path, "daemons/vehicle-01.kubelet", 7)
    gone = group(tmp_path, f"cloud-0/kubepods/burstable/pod{UID}", 2)
    sampler.sample()
    (gone / "cpuacct.usage").unlink()
    gone.rmdir()
    marks = {
        "app.kubernetes.io/name": "event-detector",
        "app.kubernetes.io/instance": "recorder-vehicle-00-vehicle-01",
        "robotkube.io/agent": "cloud-0",
    }
    spent = sampler.stop({UID: ("cloud-0", "recorder-x", marks)})
    spent.pop("scenario (observer, watch)", None)
    assert spent == {"etcd": 1.0, "kubelet": 3.0, "recorder (cloud)": 2.0}


def test_cores_are_known_between_the_samples_also_of_pods_that_came_and_went(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = iter((0, 2, 4))
    clock = SimpleNamespace(time_ns=lambda: next(ticks) * 10**9)
    monkeypatch.setattr(cpu, "time", clock)  # not everybody's: other threads look at the time, too
    group(tmp_path, "daemons/vehicle-00.kubelet", 5)
    group(tmp_path, "daemons/vehicle-01.kubelet", 5)
    sampler = cpu.CpuSampler(tmp_path)
    sampler.sample()
    group(tmp_path, "daemons/vehicle-00.kubelet", 6)
    group(tmp_path, "daemons/vehicle-01.kubelet", 7)
    gone = group(tmp_path, f"cloud-0/kubepods/burstable/pod{UID}", 1)
    sampler.sample()
    (gone / "cpuacct.usage").unlink()
    gone.rmdir()
    group(tmp_path, "daemons/vehicle-01.kubelet", 8)
    sampler.sample()
    used = sampler.cores({UID: ("robotkube", "forge-0", {"app.kubernetes.io/name": "forge"})})
    assert used.times == (0, 2 * 10**9, 4 * 10**9)
    assert used.components == {"kubelet": (1.5, 0.5), "forge": (0.5, 0.0)}


def test_a_long_run_keeps_every_second_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cpu, "SAMPLES_MAX", 4)
    seconds = iter(range(100))
    monkeypatch.setattr(cpu, "time", SimpleNamespace(time_ns=lambda: next(seconds)))
    sampler = cpu.CpuSampler(tmp_path)
    for _ in range(7):
        sampler.sample()
    assert sampler.cores({}).times == (0, 4, 6)


def spending(root: Path, core_seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """While somebody sleeps, the cluster below `root` spends that much."""
    spent = 0.0

    def sleep(_seconds: float) -> None:
        nonlocal spent
        spent += core_seconds
        group(root, "", spent)

    group(root, "", spent)
    ticks = iter(range(0, 1000, 2))
    clock = SimpleNamespace(sleep=sleep, monotonic=lambda: float(next(ticks)))
    monkeypatch.setattr(cpu, "time", clock)  # not everybody's: other threads look at the time, too


def test_the_cores_that_a_cluster_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spending(tmp_path, 3.0, monkeypatch)
    assert cpu.CpuSampler(tmp_path).cores_used() == 1.5
    assert cpu.CpuSampler(tmp_path / "nobody").cores_used() is None


def settled(cores: list[float | None]) -> SimpleNamespace:
    """A run that measured a cluster which uses these numbers of cores, one after the other."""
    going = SimpleNamespace(
        sampler=SimpleNamespace(cores_used=lambda: cores.pop(0)), set_up_seconds={}, warnings=[], warn=None
    )
    going.warn = going.warnings.append
    running.settle(going)
    return going


def test_a_run_begins_when_the_cluster_is_at_rest() -> None:
    cores: list[float | None] = [1.9, 1.4, 1.0, 0.2]
    going = settled(cores)
    assert cores == [0.2]
    assert going.warnings == []
    assert list(going.set_up_seconds) == ["cluster at rest"]
    assert settled([None]).warnings == []  # nobody counts: nothing to wait for


def test_a_cluster_that_finds_no_rest_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "REST_SECONDS_MAX", -1.0)
    (warning,) = settled([1.7]).warnings
    assert "the cluster to be at rest" in warning
    assert warning.endswith("it takes 1.70 cores")


def test_both_versions_of_control_groups_are_read(tmp_path: Path) -> None:
    assert cpu.usage_seconds(group(tmp_path, "one", 1.5)) == 1.5
    (tmp_path / "cpu.stat").write_text("usage_usec 2500000\nuser_usec 1\n")
    assert cpu.usage_seconds(tmp_path) == 2.5
    assert cpu.usage_seconds(tmp_path / "gone") is None


@pytest.mark.parametrize(
    ("folder", "marks", "namespace", "expected"),
    [
        (f"pod{UID}", {"app.kubernetes.io/name": "forge"}, "robotkube", "forge"),
        (f"pod{UID}", {"app.kubernetes.io/name": "argocd-repo-server"}, "argocd", "argocd-repo-server"),
        (
            f"kubepods-burstable-pod{UID.replace('-', '_')}.slice",
            {"app.kubernetes.io/name": "mqtt-bridge", "robotkube.io/agent": "vehicle-07"},
            "vehicle-07",
            "mqtt-bridge (vehicle)",
        ),
        (f"pod{UID}", {}, "", "pods not seen by name"),
        ("kube-apiserver", {}, "", "kube-apiserver"),
        ("vehicle-00.containerd", {}, "", "containerd"),
    ],
)
def test_groups_have_the_names_of_their_components(
    folder: str, marks: dict[str, str], namespace: str, expected: str
) -> None:
    assert cpu.component(Path("/x") / folder, {UID: (namespace, "name", marks)}) == expected


# observing ------------------------------------------------------------------------------------------------------------


def test_the_messages_of_a_batch_are_counted() -> None:
    batch = struct.pack("<4sQQI", b"RKF1", 1, 2, 3) + b"..."
    assert broker.message_count(batch) == 3
    assert broker.message_count(b"something else that is long enough") == 1
    assert broker.message_count(b"") == 1


def pod(phase: str, ready: bool = False, uid: str = UID, namespace: str = "cloud-0") -> SimpleNamespace:
    conditions = [SimpleNamespace(type="Ready", status="True" if ready else "False")]
    metadata = SimpleNamespace(namespace=namespace, name="recorder-1", uid=uid, labels={"a": "b"})
    return SimpleNamespace(metadata=metadata, status=SimpleNamespace(phase=phase, conditions=conditions))


def test_a_pod_s_life_is_noted_from_the_watch() -> None:
    watch = pods.PodWatch(None, ["cloud-0"], lambda _: None)  # type: ignore[arg-type]
    for kind, seen in (
        ("ADDED", pod("Pending")),
        ("MODIFIED", pod("Running")),
        ("MODIFIED", pod("Running", ready=True)),
        ("DELETED", pod("Running")),
    ):
        watch._note(kind, seen)
    watch._note("ADDED", pod("Running", uid="other", namespace="robotkube"))
    [life] = watch.pods()
    moments = [life.created, life.running, life.ready, life.deleted]
    assert moments == sorted(moment for moment in moments if moment)
    assert set(watch.labels) == {UID, "other"}


# waits, ledgers, command line -----------------------------------------------------------------------------------------


def test_a_wait_that_is_over_says_for_what_and_shows_the_state() -> None:
    with pytest.raises(waiting.RunError, match=r"waited 0 s for Godot, in vain\nhe is not here"):
        waiting.wait_for("Godot", 0.01, lambda: False, lambda: "he is not here", poll_seconds=0.01)


def test_a_look_that_fails_is_repeated_and_its_last_failure_named() -> None:
    answers = iter(["busy", "busy", ""])

    def poll() -> bool:
        problem = next(answers, "gone")
        if problem:
            raise waiting.RunError(problem)
        return True

    assert waiting.wait_for("it", 10, poll, str, poll_seconds=0.0) >= 0
    with pytest.raises(waiting.RunError, match=r"in vain\nthe last poll failed: gone\nstate"):
        waiting.wait_for("it", 0.0, poll, lambda: "state", poll_seconds=0.01)


def test_a_ledger_has_ended_with_its_last_line(tmp_path: Path) -> None:
    name = collecting.ledger_file("run-1", "/vehicles/vehicle_00/pose")
    assert name == "ledger/run-1/__vehicles__vehicle_00__pose.jsonl"
    volumes = FolderVolumes(tmp_path)
    file = tmp_path / "vehicle-00" / "bags" / name
    assert not collecting.ledger_ended(volumes, "vehicle-00", name)
    file.parent.mkdir(parents=True)
    lines = [json.dumps({"sequence": n, "stamp": n, "sha256": "0" * 64}) for n in range(100)]
    file.write_text("\n".join(lines) + "\n")
    assert not collecting.ledger_ended(volumes, "vehicle-00", name)
    file.write_text("\n".join([*lines, json.dumps({"end": True, "count": 100})]) + "\n")
    assert collecting.ledger_ended(volumes, "vehicle-00", name)


def test_ledgers_that_are_missing_are_named(scenario: definition.Scenario, tmp_path: Path) -> None:
    said: list[str] = []
    reading = collecting.Collecting(said.append)
    assert collecting.ledgers(scenario, FolderVolumes(tmp_path), "run-1", reading) == {}
    assert reading.missing == {"ledgers"}
    assert len(said) == 6
    assert all(text.startswith("ledger of /vehicles/") for text in said)


def test_segments_of_volumes_that_are_away_are_not_found(tmp_path: Path) -> None:
    find = collecting.segment_finder({"machine-4": "cloud-0", "machine-5": "away"}, FolderVolumes(tmp_path))
    assert find("machine-4/recordings", "a/1.mcap") == tmp_path / "cloud-0" / "recordings" / "a" / "1.mcap"
    assert find("machine-9/recordings", "a/1.mcap") is None
    assert find("machine-5/recordings", "a/1.mcap") is None


def test_what_a_kind_of_cluster_cannot_give_is_said_and_reported() -> None:
    said: list[str] = []
    provider = SimpleNamespace(kind="other", lacks=("nodes have no outages",))
    assert running.lacking(provider, said.append) == ["a cluster of kind other: nodes have no outages"]  # type: ignore[arg-type]
    assert said == ["warning: a cluster of kind other: nodes have no outages"]


def test_where_nobody_counts_there_is_no_figure_and_the_run_begins_at_once() -> None:
    sampler = cpu.CpuSampler(None)
    sampler.start()
    assert sampler.cores_used() is None
    assert set(sampler.stop({})) <= {"scenario (observer, watch)"}
    assert sampler.cores({}).components == {}


def test_cables_that_are_others_are_left_as_they_are() -> None:
    untouched = cables.UntouchedCables()
    plain = cables.Cables(definition.load(FOLDER), untouched, print)
    plain.check()
    plain.begin()
    assert plain.finish() == ()
    with pytest.raises(SetUpError, match="the cables of vehicle-00"):
        cables.Cables(definition.load(FOLDER, variant="mobile-network"), untouched, print).check()


def test_the_commands_to_look_around_are_whole(scenario: definition.Scenario) -> None:
    commands = list(inspection.commands(scenario, Path("kubeconfig"), Endpoint("10.96.0.9", 3000)))
    assert all(shlex.split(command) for _, command in commands)
    text = "\n".join(inspection.lines(scenario, Path("kubeconfig"), Endpoint("10.96.0.9", 3000)))
    assert "open plan N --forge` opens a pull request's page" in text
    assert "{person}" not in text
    by_tls = dict(inspection.commands(scenario, Path("kubeconfig"), Endpoint("10.96.0.9", 3000, encrypted=True)))
    [clone] = [command for command in by_tls.values() if "git" in command and "clone" in command]
    assert all(part in clone for part in ("GIT_SSL_CAINFO=robotkube-ca.crt git clone", "@10.96.0.9:3000/", '"https://'))
    assert r"jsonpath='{.data.ca\.crt}' > robotkube-ca.crt" in by_tls["who signed the forge's certificate"]
    assert "port-forward" not in text
    forwarded = inspection.lines(scenario, Path("kubeconfig"), Endpoint("localhost", 3000), "kubectl port-forward it")
    assert "  kubectl port-forward it" in forwarded


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "vehicles"], "must have the form key=value"),
        (["--set", "wheels=3"], "has no parameter 'wheels'"),
        (["--variant", "huge"], "there is no variant 'huge'"),
    ],
)
def test_a_bad_command_ends_before_anything_is_started(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert __main__.main(["run", str(FOLDER), *arguments]) == 1
    assert message in capsys.readouterr().err
