"""The inspector's loop: looks, confirmations and what is reported."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from robotkube.delivery.inspection.adapters.kubernetes_workloads import OTHER_KINDS
from robotkube.delivery.inspection.core.permitted import ReleaseShape
from robotkube.delivery.inspection.core.strangers import Look, Stranger
from robotkube.delivery.inspection.loops import looks
from robotkube.delivery.inspection.loops.inspector import Inspector
from robotkube.delivery.inspection.loops.looks import NodeLooks, ReleaseLooks
from robotkube.delivery.inspection.loops.reporting import Reporter
from robotkube.delivery.inspection.ports import NodeReading
from robotkube.foundation.runtime.settings_file import split_message
from tests.stages.attacks import shown
from tests.stages.delivery.inspection.inspected_node import (
    CHART,
    FOREIGN_IMAGE,
    RENDERED,
    deployment,
    permitted,
    pod_object,
    pods,
    running,
)
from tests.stages.delivery.inspection.inspections_in_memory import (
    Clock,
    InspectionsInMemory,
    NodesInMemory,
    SourceInMemory,
    WorkloadsInMemory,
)

STEP_SECONDS = 0.5
NAMED_SECONDS = 15
CLEAN = {"Seen": "True", "Clean": "True"}
STRANGE = {"Seen": "True", "Clean": "False"}
UNSEEN = {"Seen": "False", "Clean": "Unknown"}


class Stage:
    """An inspector in memory, with one node `a` on which all is as it should be."""

    def __init__(self, **readings: NodeReading | None) -> None:
        self.clock = Clock()
        self.nodes = NodesInMemory({"a": reading(pod_object()), **readings})
        self.workloads = WorkloadsInMemory(("Deployment", deployment()))
        self.source = SourceInMemory(permitted())
        self.inspections = InspectionsInMemory()
        self.made: list[Inspector] = []
        self.start()

    def start(self) -> None:
        """Start the process, anew: it has forgotten everything."""
        self.reporter = Reporter(self.inspections, self.clock.ns)
        both = (NodeLooks(self.clock), ReleaseLooks(self.workloads))
        self.inspector = Inspector(self.nodes, both, self.source, self.reporter, self.clock, lambda: 1.0)
        self.made.append(self.inspector)

    def run(self, seconds: float) -> None:
        """Let time pass."""
        end = self.clock.now + seconds
        while self.clock.now < end:
            self.inspector.step()
            self.clock.now += STEP_SECONDS

    def conditions(self, name: str = "kubelet.a") -> dict[str, str]:
        return self.inspections.conditions(name)


def reading(*objects: dict[str, Any], runs: Any = ()) -> NodeReading:
    return NodeReading(pods(*objects), running(*runs))


@pytest.fixture
def stage() -> Iterator[Stage]:
    stage = Stage()
    yield stage
    for inspector in stage.made:
        inspector.stop()


STRANGER = pod_object(uid="u2", name="stranger", image=FOREIGN_IMAGE, owner=("", ""))


def test_nothing_is_strange(stage: Stage) -> None:
    stage.run(30)
    assert stage.conditions() == CLEAN
    assert stage.conditions("releases") == CLEAN
    assert stage.inspections.events == []
    assert stage.inspector.reasons_not_ready() == []


def test_a_forge_that_is_not_there_at_the_start_is_asked_again_soon_and_then_ever_more_seldom(stage: Stage) -> None:
    """After 2, 4, 8, 16 and every 30 s; as soon as it answers, the inspector is ready."""
    stage.source.away = True
    stage.run(3)
    assert stage.source.refreshed == 2
    assert stage.inspector.reasons_not_ready() == ["the forge does not answer"]
    stage.run(60)
    assert stage.source.refreshed == 6
    stage.source.away = False
    stage.run(30)
    assert stage.inspector.reasons_not_ready() == []


def test_a_stranger_is_named_in_time_and_gone_again(stage: Stage) -> None:
    stage.run(31.5)
    stage.nodes.readings["a"] = reading(pod_object(), STRANGER)
    stage.run(NAMED_SECONDS)
    assert stage.conditions() == STRANGE
    status = stage.inspections.statuses["kubelet.a"]
    assert [one["reason"] for one in status["strangers"]] == ["ForeignImage", "NoRelease"]
    assert status["strangersTotal"] == 2
    assert [reason for _, reason, _ in stage.inspections.events] == ["ForeignImage", "NoRelease"]
    assert "Container vehicle-00/stranger/detector (ForeignImage)" in status["conditions"][1]["message"]
    stage.nodes.readings["a"] = reading(pod_object())
    stage.run(NAMED_SECONDS)
    assert stage.conditions() == CLEAN
    assert [reason for _, reason, _ in stage.inspections.events[2:]] == ["StrangerGone", "StrangerGone"]


def test_the_log_tells_reason_and_message_apart(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    stage.nodes.readings["a"] = reading(pod_object(), STRANGER)
    stage.run(NAMED_SECONDS)
    lines = [split_message(record.getMessage()) for record in caplog.records]
    fields = [fields for event, fields in lines if event == "stranger appeared" and fields["container"] != "-"]
    assert [field["reason"] for field in fields] == ["ForeignImage"]
    assert FOREIGN_IMAGE in fields[0]["message"]


def test_a_sidecar_is_named_in_time(stage: Stage) -> None:
    stage.run(31.5)
    changed = deployment()
    changed["metadata"]["resourceVersion"] = "8"
    changed["spec"]["template"]["spec"]["containers"].append({"name": "miner", "image": FOREIGN_IMAGE})
    stage.workloads.workloads[:] = [("Deployment", changed)]
    stage.run(NAMED_SECONDS)
    assert stage.conditions("releases") == STRANGE
    stage.workloads.workloads[:] = [("Deployment", deployment())]
    stage.run(NAMED_SECONDS)
    assert stage.conditions("releases") == CLEAN


@pytest.mark.parametrize("kind", OTHER_KINDS)
def test_another_kind_of_workload_is_named_in_time(stage: Stage, kind: str) -> None:
    """Also one that starts no pod: no node shows it."""
    stage.run(31.5)
    metadata = {"metadata": {"name": "miner", "namespace": "vehicle-00", "uid": "u9", "resourceVersion": "1"}}
    stage.workloads.workloads.append((kind, metadata))
    stage.run(NAMED_SECONDS)
    (one,) = stage.inspections.statuses["releases"]["strangers"]
    assert (one["kind"], one["name"], one["reason"]) == (kind, "miner", "NoRelease")
    stage.workloads.workloads.pop()
    stage.run(NAMED_SECONDS)
    assert stage.conditions("releases") == CLEAN


def test_a_look_at_many_agents_is_bounded(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """With more lists than one look may take, kinds are read in turn, and each is named all the same."""
    agents = len(stage.source.permitted().domain.agents)
    monkeypatch.setattr(looks, "OTHERS_MAX", 2 * agents)
    metadata = {"metadata": {"name": "miner", "namespace": "vehicle-00", "uid": "u9", "resourceVersion": "1"}}
    stage.workloads.workloads += [(kind, metadata) for kind in OTHER_KINDS]
    stage.inspector.step()
    assert stage.workloads.asked == (2 + 2) * agents
    stage.run(60)
    assert {one["kind"] for one in stage.inspections.statuses["releases"]["strangers"]} == set(OTHER_KINDS)


def _settings(**data: str) -> dict[str, Any]:
    metadata = {"name": "detector", "namespace": "vehicle-00", "uid": "9", "resourceVersion": str(len(data))}
    return {"metadata": metadata, "data": data}


def _with_settings(stage: Stage, *earlier: dict[str, Any], **data: str) -> None:
    """The detector's release renders a ConfigMap as well; `data` is what the cluster has."""
    now = {"detector": RENDERED, "ConfigMap/detector": {"data": {"config.yaml": "a: 1"}}}
    shape = ReleaseShape("detector", CHART, now, [{"ConfigMap/detector": one} for one in earlier])
    stage.source.now = permitted(releases={"vehicle-00": [shape]})
    stage.workloads.workloads.append(("ConfigMap", _settings(**data)))
    others = {"name": "kube-root-ca.crt", "namespace": "vehicle-00", "uid": "8"}
    stage.workloads.workloads.append(("ConfigMap", {"metadata": others, "data": {"ca.crt": "x"}}))
    stage.run(NAMED_SECONDS)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"config.yaml": "a: 2"}, "data.config.yaml says something else"),
        ({"config.yaml": "a: 1", "more": ""}, "data.more is there, which the chart does not have"),
        ({}, "data.config.yaml is missing"),
    ],
)
def test_settings_that_main_does_not_have_are_named_in_time(stage: Stage, data: dict[str, str], words: str) -> None:
    stage.run(31.5)
    _with_settings(stage, **data)
    (one,) = stage.inspections.statuses["releases"]["strangers"]
    assert (one["kind"], one["name"], one["reason"]) == ("ConfigMap", "detector", "NotOfTheChart")
    assert f"ConfigMap vehicle-00/detector is not what the chart of release detector renders: {words}" in one["message"]
    shown("nodes", one["message"], "settings-past-main")


def test_settings_as_main_has_or_had_them_are_none(stage: Stage) -> None:
    _with_settings(stage, **{"config.yaml": "a: 1"})
    assert stage.conditions("releases") == CLEAN
    stage.workloads.workloads.clear()
    _with_settings(stage, {"data": {"config.yaml": "a: 0"}}, **{"config.yaml": "a: 0"})
    assert stage.conditions("releases") == CLEAN


def test_what_a_publication_explains_is_never_named(stage: Stage) -> None:
    """Pods of a release may stand before the inspector has followed main and catalogue."""
    stage.run(31.5)
    stage.source.now = permitted(releases={})
    stage.source.next = permitted()
    stage.run(NAMED_SECONDS)
    assert stage.conditions() == CLEAN
    assert stage.inspections.events == []


def test_what_is_strange_once_is_not_named(stage: Stage) -> None:
    stage.run(31.5)
    stage.nodes.readings["a"] = reading(pod_object(), runs=[("u9", "starting", {"detector": "x"})])
    before = len(stage.nodes.asked)
    while len(stage.nodes.asked) == before:
        stage.run(STEP_SECONDS)
    stage.nodes.readings["a"] = reading(pod_object())
    stage.run(30)
    assert stage.inspections.events == []


def test_a_pod_that_came_and_ended_between_two_looks_is_none(stage: Stage) -> None:
    """The kubelet tells what ran 2 s ago, and forgot the pod at once: two looks see it."""
    stage.run(31.5)
    stage.nodes.readings["a"] = reading(pod_object(), runs=[("u9", "probe", {"probe": "x"})])
    before = len(stage.nodes.asked)
    while len(stage.nodes.asked) < before + 2:
        stage.run(STEP_SECONDS)
    stage.nodes.readings["a"] = reading(pod_object())
    stage.run(30)
    assert stage.inspections.events == []


def test_a_pod_that_its_kubelet_never_knew_is_named_in_time(stage: Stage) -> None:
    """Within 15 s, of which the kubelet's list may take 2."""
    stage.run(31.5)
    stage.nodes.readings["a"] = reading(pod_object(), runs=[("u9", "hidden", {"miner": "x"})])
    stage.run(NAMED_SECONDS - 2)
    assert [reason for _, reason, _ in stage.inspections.events] == ["ForeignPod"]


def test_a_kubelet_that_does_not_answer_is_said_and_delays_nobody(stage: Stage) -> None:
    stage.nodes.readings["b"] = None
    stage.run(60)
    assert stage.conditions("kubelet.b") == UNSEEN
    assert "timed out" in stage.inspections.statuses["kubelet.b"]["conditions"][0]["message"]
    assert stage.conditions() == CLEAN
    assert stage.nodes.asked.count("b") == 3  # after 8 s again, then every 30 s


def test_a_kubelet_that_lists_nonsense_ends_nothing(stage: Stage) -> None:
    nonsense = pod_object(uid="u4", spec={"initContainers": [{"name": "x", "image": "y", "securityContext": "z"}]})
    stage.nodes.readings["b"] = reading(nonsense)
    stage.run(30)
    assert stage.conditions("kubelet.b") == UNSEEN
    assert stage.conditions() == CLEAN


def test_strangers_stay_named_while_the_kubelet_is_silent(stage: Stage) -> None:
    stage.nodes.readings["a"] = reading(pod_object(), STRANGER)
    stage.run(NAMED_SECONDS)
    stage.nodes.readings["a"] = None
    stage.run(30)
    assert stage.conditions() == UNSEEN
    assert stage.inspections.statuses["kubelet.a"]["strangersTotal"] == 2
    assert len(stage.inspections.events) == 2


def test_a_kubelet_that_starts_is_not_believed_yet(stage: Stage) -> None:
    """It knows its static pods, and of the API server's nothing yet, while all containers run on."""
    stage.run(31.5)
    stage.start()
    stage.nodes.readings["a"] = reading(runs=[("u1", "detector-5d9c7b-x", {"detector": "x"})])
    stage.run(30)
    assert stage.conditions() == UNSEEN
    assert "it is starting" in stage.inspections.statuses["kubelet.a"]["conditions"][0]["message"]
    stage.nodes.readings["a"] = reading(pod_object(), runs=[("u1", "detector-5d9c7b-x", {"detector": "x"})])
    stage.run(30)
    assert stage.conditions() == CLEAN
    assert stage.inspections.events == []


def test_a_pod_that_its_kubelet_forgot_first_is_none(stage: Stage) -> None:
    stage.run(31.5)
    runs = [("u1", "detector-5d9c7b-x", {"detector": "x"}), ("u2", "next", {"detector": "x"})]
    stage.nodes.readings["a"] = reading(pod_object(uid="u2", name="next"), runs=runs)
    stage.run(60)
    assert stage.inspections.events == []


def test_a_restart_repeats_nothing(stage: Stage) -> None:
    stage.nodes.readings["a"] = reading(pod_object(), STRANGER)
    stage.run(NAMED_SECONDS)
    since = [one["since"] for one in stage.inspections.statuses["kubelet.a"]["strangers"]]
    stage.start()
    stage.run(30)
    assert len(stage.inspections.events) == 2
    assert [one["since"] for one in stage.inspections.statuses["kubelet.a"]["strangers"]] == since


def test_before_anything_was_read_nothing_is_claimed(stage: Stage) -> None:
    stage.source.now = None
    stage.nodes.readings["a"] = reading(STRANGER)
    stage.run(30)
    assert stage.conditions() == UNSEEN
    assert stage.conditions("releases") == UNSEEN


def test_what_could_not_be_written_is_written_by_the_next_look(stage: Stage) -> None:
    stage.run(31.5)
    stage.inspections.away = True
    stage.nodes.readings["a"] = reading(pod_object(), STRANGER)
    stage.run(NAMED_SECONDS)
    assert "no answer" in stage.inspector.reasons_not_ready()[0]
    stage.inspections.away = False
    stage.run(NAMED_SECONDS)
    assert stage.conditions() == STRANGE
    assert len(stage.inspections.events) == 2


def test_a_node_that_is_gone_leaves_no_inspection(stage: Stage) -> None:
    stage.nodes.readings["b"] = reading(pod_object(uid="u3"))
    stage.run(31.5)
    assert "kubelet.b" in stage.inspections.names()
    del stage.nodes.readings["b"]
    stage.run(40)
    assert stage.inspections.names() == ("kubelet.a", "releases")


def test_an_unchanged_status_is_written_within_twenty_seconds(stage: Stage) -> None:
    stage.run(30)
    before = stage.inspections.writes
    stage.run(240)
    assert stage.inspections.writes - before == 15 + 12  # of the node's looks and of the releases' every second one


def _forged(status: Mapping[str, Any]) -> dict[str, Any]:
    """The status as somebody would like to have it: nothing is strange."""
    if not status.get("strangers"):
        return dict(status)
    clean = [{**one, "status": "True", "message": "no strangers"} for one in status["conditions"]]
    return {**status, "strangers": [], "strangersTotal": 0, "conditions": clean}


def _counted(stage: Stage, name: str) -> Mapping[tuple[str, ...], float]:
    (values,) = [metric.values for metric in stage.reporter.metrics() if metric.name == f"robotkube_inspection_{name}"]
    return values


def _with_a_stranger(stage: Stage) -> None:
    stage.nodes.readings["a"] = reading(pod_object(), STRANGER)
    stage.run(NAMED_SECONDS)
    assert stage.conditions() == STRANGE


def test_a_stranger_that_somebody_made_unnamed_is_named_again(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    _with_a_stranger(stage)
    stage.inspections.statuses["kubelet.a"] = _forged(stage.inspections.statuses["kubelet.a"])
    stage.run(4)
    assert stage.conditions() == STRANGE
    assert _counted(stage, "restored_total") == {(): 1.0}
    (line,) = [record.getMessage() for record in caplog.records if "restored" in record.getMessage()]
    assert line == "inspection restored name=kubelet.a was=changed"
    shown("nodes", line, "inspection-forged")


def test_an_inspection_that_somebody_deleted_is_back(stage: Stage) -> None:
    _with_a_stranger(stage)
    stage.inspections.remove("kubelet.a")
    stage.run(4)
    assert stage.conditions() == STRANGE
    assert len(stage.inspections.events) == 2


def test_admission_that_changes_what_is_written_is_said(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    stage.run(31.5)
    stage.inspections.changes = _forged
    stage.nodes.readings["a"] = reading(pod_object(), STRANGER)
    stage.run(60)
    (problem,) = stage.inspector.reasons_not_ready()
    assert "the API server has something else than what was written, so do not believe it" in problem
    shown("nodes", problem, "inspection-changed-by-policy")
    assert _counted(stage, "write_failures_total")[("Changed",)] >= 5
    hindered = [record for record in caplog.records if "inspection hindered" in record.getMessage()]
    assert len(hindered) == 1
    assert list(_counted(stage, "strangers").values()) == [1.0, 1.0]
    stage.inspections.changes = lambda status: status
    stage.run(NAMED_SECONDS)
    assert stage.conditions() == STRANGE
    assert stage.inspector.reasons_not_ready() == []


def test_admission_that_refuses_what_is_written_is_said(stage: Stage) -> None:
    stage.run(31.5)
    stage.inspections.refuses = True
    stage.nodes.readings["a"] = reading(pod_object(), STRANGER)
    stage.run(NAMED_SECONDS)
    assert "a policy denied the request" in stage.inspector.reasons_not_ready()[0]
    assert _counted(stage, "write_failures_total")[("Refused",)] >= 1


def test_metrics(stage: Stage) -> None:
    stage.nodes.readings["b"] = None
    stage.nodes.readings["a"] = reading(pod_object(), STRANGER)
    stage.run(31.5)
    series = {metric.name: metric.values for metric in stage.reporter.metrics()}
    assert series["robotkube_inspection_strangers"] == {
        ("kubelet", "a", "ForeignImage"): 1.0,
        ("kubelet", "a", "NoRelease"): 1.0,
    }
    assert series["robotkube_inspection_unseen"][("kubelet", "b")] == 1.0
    assert series["robotkube_inspection_look_age_seconds"][("kubelet", "a")] < 11
    assert ("kubelet", "b") not in series["robotkube_inspection_look_age_seconds"]


def test_what_the_machines_own_process_reports_is_in_the_metrics(stage: Stage) -> None:
    """It serves none itself."""
    beside = Stranger("Container", "", "default/miner", "BesideTheKubelet", "container default/miner: why")
    others = Reporter(stage.inspections, stage.clock.ns)
    others.report(Look("machine", (beside,), "a"))
    others.report(Look("machine", node="b", problem="dark"))
    stage.run(15)
    series = {metric.name: metric.values for metric in stage.reporter.metrics()}
    assert series["robotkube_inspection_strangers"] == {("machine", "a", "BesideTheKubelet"): 1.0}
    assert series["robotkube_inspection_look_age_seconds"][("machine", "a")] == pytest.approx(15, abs=1)
    unseen = series["robotkube_inspection_unseen"]
    assert (unseen[("machine", "a")], unseen[("machine", "b")]) == (0.0, 1.0)
    stage.inspections.remove("machine.a")
    stage.run(11)
    assert not {metric.name: metric.values for metric in stage.reporter.metrics()}["robotkube_inspection_strangers"]
