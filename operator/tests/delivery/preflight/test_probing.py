"""The probe's two rounds of pods on a cluster in memory: what they are told, and that nothing of it ever stays."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

from robotkube.delivery.preflight.core.findings import Unread
from robotkube.delivery.preflight.core.probing.answers import VARIABLE, ProbeAnswer, read_answer, read_questions
from robotkube.delivery.preflight.loops.probing import (
    ASK_SECONDS_MAX,
    CLOSE_SECONDS_MAX,
    START_SECONDS_MAX,
    ProbeClock,
    Probing,
)
from robotkube.errors import InputError, UnavailableError
from robotkube.registry.suites.core.pod_security import RULES, Pod
from tests.stages.delivery.preflight.probed_nodes import NODES, TARGET, answer

Object = dict[str, Any]
PULL = {"waiting": {"reason": "ImagePullBackOff", "message": "Back-off pulling image"}}


class Cluster:
    """A namespace whose pods run at once, and answer at once; `states` of pods by name say otherwise."""

    def __init__(self, **states: Any) -> None:
        self.states = {name.replace("_", "-"): state for name, state in states.items()}
        self.made: dict[str, Object] = {}
        self.present = False
        self.stays = False
        self.lacks = ()
        self.fault: BaseException | None = None
        self.event: list[Object] = []

    def lacking(self) -> Sequence[str]:
        return self.lacks

    def open(self) -> None:
        self.present = True

    def start(self, pod: Mapping[str, Any]) -> None:
        if self.fault:
            raise self.fault
        self.made[pod["metadata"]["name"]] = dict(pod)

    def pods(self) -> Mapping[str, Object]:
        return {name: {**pod, "status": self._status(name)} for name, pod in self.made.items()}

    def events(self) -> Sequence[Object]:
        return self.event

    def close(self) -> bool:
        self.present = self.present and self.stays
        return not self.present

    def _status(self, name: str) -> Object:
        state = self.states.get(name)
        if state is None:
            said = {"terminated": {"exitCode": 0, "message": answer().text}}
            state = {"running": {}} if name.startswith("serve") else said
        phase = "Running" if "running" in state else "Pending"
        return {"phase": phase, "podIP": f"10.0.0.{name[-1]}", "containerStatuses": [{"state": state}]}

    def questions(self, name: str) -> Any:
        [container] = self.made[name]["spec"]["containers"]
        return read_questions({one["name"]: one["value"] for one in container["env"]}[VARIABLE])


class Stage:
    """A probe on a cluster, with a clock that only sleeping moves."""

    def __init__(self, cluster: Cluster) -> None:
        self.cluster = cluster
        self.seconds = 0.0
        self.said = []
        self.is_shielded = False
        clock = ProbeClock(lambda: self.seconds, self.sleep)
        unasked: Mapping[str, str] = {}
        self.probing = Probing(cluster, TARGET, NODES, unasked, clock, self.shielded, self.said.append)

    def sleep(self, seconds: float) -> None:
        self.seconds += seconds

    @contextmanager
    def shielded(self) -> Iterator[None]:
        self.is_shielded = True
        yield


def test_every_node_answers_and_nothing_stays() -> None:
    stage = Stage(Cluster())
    probed = stage.probing.run()
    assert {name: node.answer for name, node in probed.nodes.items()} == dict.fromkeys(NODES, answer())
    assert (probed.left, stage.cluster.present, stage.is_shielded) == ("", False, True)
    assert [pod["spec"]["nodeName"] for pod in stage.cluster.made.values()] == [*NODES, *NODES]


def test_each_pod_asks_its_neighbour_and_all_ask_one_clock() -> None:
    stage = Stage(Cluster())
    probed = stage.probing.run()
    questions = [stage.cluster.questions(f"ask-{number}") for number in range(3)]
    assert [question.clock for question in questions] == ["10.0.0.0"] * 3
    assert [question.neighbour for question in questions] == ["10.0.0.1", "10.0.0.2", "10.0.0.0"]
    assert [probed.nodes[name].neighbour for name in NODES] == ["vehicle-00", "vehicle-01", "cloud-0"]


def test_the_pods_of_a_node_without_the_image_do_not_hold_up_the_others() -> None:
    stage = Stage(Cluster(serve_1=PULL))
    probed = stage.probing.run()
    assert probed.nodes["vehicle-00"].pulled is False
    assert probed.nodes["vehicle-00"].words == "ImagePullBackOff: Back-off pulling image"
    assert isinstance(probed.nodes["vehicle-00"].answer, Unread)
    assert "ask-1" not in stage.cluster.made
    assert stage.cluster.questions("ask-0").neighbour == "10.0.0.2"
    assert stage.seconds == 0


def test_a_pod_that_hangs_is_waited_for_no_longer_than_said_and_named_with_its_event() -> None:
    cluster = Cluster(serve_1={})
    old = {"type": "Normal", "lastTimestamp": "3", "reason": "Scheduled", "message": "assigned"}
    new = {"type": "Warning", "lastTimestamp": "1", "reason": "FailedMount", "message": "no volume"}
    cluster.event = [{**one, "involvedObject": {"name": "serve-1"}} for one in (new, old)]
    stage = Stage(cluster)
    probed = stage.probing.run()
    assert START_SECONDS_MAX <= stage.seconds < START_SECONDS_MAX + 1
    assert (probed.nodes["vehicle-00"].pulled, probed.nodes["vehicle-00"].words) == (None, "FailedMount: no volume")


def test_a_pod_that_never_answers_is_waited_for_no_longer_than_said() -> None:
    stage = Stage(Cluster(ask_2={"running": {}}))
    probed = stage.probing.run()
    assert ASK_SECONDS_MAX <= stage.seconds < ASK_SECONDS_MAX + 1
    assert probed.nodes["vehicle-01"].answer == Unread("its pod gave no answer: it did not end within 14 s")


def test_an_image_of_a_version_before_the_probe() -> None:
    ended = {"terminated": {"reason": "StartError", "message": 'exec: "robotkube-probe": not found', "exitCode": 128}}
    probed = Stage(Cluster(ask_2=ended)).probing.run()
    assert "ended without an answer that can be read: exec" in probed.nodes["vehicle-01"].answer.why  # type: ignore[union-attr]


def test_all_bounds_together_are_less_than_a_minute() -> None:
    assert START_SECONDS_MAX + ASK_SECONDS_MAX + CLOSE_SECONDS_MAX <= 57


@pytest.mark.parametrize("fault", [KeyboardInterrupt(), UnavailableError("away"), InputError("403 forbidden")])
def test_whatever_interrupts_it_nothing_stays(fault: BaseException) -> None:
    stage = Stage(Cluster())
    stage.cluster.fault = fault
    with pytest.raises(type(fault)):
        stage.probing.run()
    assert (stage.cluster.present, stage.is_shielded, stage.said) == (False, True, [])


def test_what_an_interrupted_probe_cannot_remove_is_said() -> None:
    stage = Stage(Cluster())
    stage.cluster.fault = KeyboardInterrupt()
    stage.cluster.stays = True
    with pytest.raises(KeyboardInterrupt):
        stage.probing.run()
    [sentence] = stage.said
    assert sentence.endswith("kubectl delete namespace robotkube-probe")


def test_what_cannot_be_removed_is_part_of_the_outcome() -> None:
    stage = Stage(Cluster())
    stage.cluster.stays = True
    assert stage.probing.run().left == "it is still there 16 s after its deletion was asked for"


def test_without_a_right_nothing_is_made() -> None:
    stage = Stage(Cluster())
    stage.cluster.lacks = ("delete namespaces in the cluster",)
    with pytest.raises(InputError, match="nothing was started: the account may not delete namespaces in the cluster"):
        stage.probing.run()
    assert stage.cluster.made == {}


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"names": 1}', "killed", json.dumps({"disks": {"pods": {}}})])
def test_what_has_not_the_form_of_an_answer_is_none(text: str) -> None:
    assert isinstance(read_answer(text), Unread)


def test_an_answer_with_many_words_fits_into_the_last_words_of_a_container() -> None:
    long = ProbeAnswer(names={f"{number}.example": "x" * 190 for number in range(30)})
    assert len(long.text.encode()) <= 4096
    assert isinstance(read_answer(long.text), ProbeAnswer)


def test_the_pods_are_restricted_and_end_by_themselves() -> None:
    stage = Stage(Cluster())
    stage.probing.run()
    for name, pod in stage.cluster.made.items():
        assert [problem for rule in RULES for problem in rule.inspect(Pod(name, {}, pod["spec"]))] == []
        assert pod["spec"]["activeDeadlineSeconds"] == 60
        assert pod["spec"]["automountServiceAccountToken"] is False
