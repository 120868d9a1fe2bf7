"""The remover's turns: what is named goes once, what comes again waits, and each Inspection says what became of it."""

from __future__ import annotations

import threading
from itertools import pairwise
from typing import Any

import pytest

from robotkube.delivery.removal.core.targets import RemovalPolicy
from robotkube.delivery.removal.loops.remover import POLL_SECONDS, SILENCE_SECONDS_MAX, Remover
from robotkube.delivery.removal.loops.removing import ROLL_OUT_SECONDS
from robotkube.delivery.removal.loops.returns import PAUSE_SECONDS_MAX, PAUSE_SECONDS_MIN
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage
from tests.delivery.removal.cluster_in_memory import ClusterInMemory
from tests.delivery.removal.examples import NOW_NS, UID, deployment, inspection, pod, stranger

POLICY = RemovalPolicy(frozenset({"vehicle-00"}))
SIDECAR = "/spec/template/spec/containers/1"


class Stage:
    """A remover on a cluster in memory, and its clock."""

    def __init__(self, policy: RemovalPolicy = POLICY) -> None:
        self.cluster = ClusterInMemory()
        self.seconds = 1000.0
        self.remover = Remover(
            self.cluster, policy, lambda: self.seconds, lambda: NOW_NS + int((self.seconds - 1000) * 1e9), lambda: 0.5
        )

    def turn(self, after: float = POLL_SECONDS) -> None:
        self.seconds += after
        self.remover.turn()

    def name(self, *strangers: dict[str, Any], name: str = "kubelet.one", looks_at: str = "kubelet") -> None:
        """An inspector names these now."""
        self.cluster.put(inspection(*strangers, name=name, looks_at=looks_at, at_ns=int(self.now_ns)))

    @property
    def now_ns(self) -> float:
        return NOW_NS + (self.seconds - 1000) * 1e9


@pytest.fixture
def stage() -> Stage:
    return Stage()


def changed(*excess: str, generation: int = 3) -> dict[str, Any]:
    return stranger(
        "Deployment", "detector", reason="NotOfTheChart", generation=generation, excess=list(excess or [SIDECAR])
    )


def test_a_foreign_pod_goes_and_the_inspection_says_so(stage: Stage) -> None:
    stage.cluster.pods = {"foreign": pod(), "own": pod("own", "uid-2", owner="detector")}
    stage.name(stranger())
    stage.turn()
    assert stage.cluster.deleted == [("foreign", UID, 1)]
    assert set(stage.cluster.pods) == {"own"}
    assert stage.cluster.condition()[:2] == ("False", "Removing")
    assert stage.cluster.events == [
        ("kubelet.one", "Removed", "Pod vehicle-00/foreign was deleted: it is not what main says", False)
    ]
    stage.turn()
    assert stage.cluster.condition() == ("False", "Removing", "Pod vehicle-00/foreign is gone")
    stage.name()
    stage.turn()
    assert stage.cluster.condition() == ("True", "NothingNamed", "no stranger is named")
    assert len(stage.cluster.deleted) == 1


def test_another_pod_of_the_same_name_is_left_alone(stage: Stage) -> None:
    stage.cluster.pods = {"foreign": pod(uid="uid-2")}
    stage.name(stranger())
    stage.turn()
    assert stage.cluster.deleted == []


def test_a_pod_that_ends_already_is_not_deleted_again(stage: Stage) -> None:
    stage.cluster.pods = {"foreign": pod(deletionTimestamp="2026-11-25T12:00:00Z")}
    stage.name(stranger())
    stage.turn()
    assert stage.cluster.deleted == []
    assert stage.cluster.condition()[2] == "Pod vehicle-00/foreign is ending"


def test_a_pod_that_two_inspections_name_goes_once(stage: Stage) -> None:
    stage.cluster.pods = {"foreign": pod()}
    stage.name(stranger(), stranger("Container", container="side"))
    stage.name(stranger(), name="releases", looks_at="releases")
    stage.turn()
    assert stage.cluster.deleted == [("foreign", UID, 1)]
    assert stage.cluster.condition()[1] == stage.cluster.condition("releases")[1] == "Removing"


def test_a_pod_that_changes_meanwhile_is_tried_again(stage: Stage) -> None:
    stage.cluster.pods = {"foreign": pod()}
    stage.name(stranger())
    stage.cluster.meddling = True
    stage.turn()
    assert stage.cluster.condition()[2].endswith("changed at this very moment; tried again")
    stage.cluster.meddling = False
    stage.turn()
    assert stage.cluster.deleted == [("foreign", UID, 1)]


def test_a_deployment_loses_what_its_chart_does_not_render(stage: Stage) -> None:
    stage.cluster.deployments = {"detector": deployment()}
    stage.name(changed(), changed("/metadata/annotations/note"), name="releases", looks_at="releases")
    stage.turn()
    assert stage.cluster.patched == [("detector", [SIDECAR, "/metadata/annotations/note"])]
    assert stage.cluster.condition("releases")[:2] == ("False", "Restoring")
    assert [event[1:] for event in stage.cluster.events] == [
        (
            "Restored",
            f"Deployment vehicle-00/detector was restored: /metadata/annotations/note, {SIDECAR} taken away",
            False,
        )
    ]
    stage.turn()
    stage.turn(PAUSE_SECONDS_MAX)
    assert len(stage.cluster.patched) == 1  # it is named as it was: nobody looked since


def test_a_deployment_that_was_changed_since_waits_for_the_next_look(stage: Stage) -> None:
    stage.cluster.deployments = {"detector": deployment()}
    stage.name(changed(generation=2), name="releases", looks_at="releases")
    stage.turn()
    assert stage.cluster.patched == []
    assert stage.cluster.condition("releases")[2] == (
        "Deployment vehicle-00/detector: it was changed since it was looked at; the next look says what has to go"
    )


def test_first_the_workload_then_its_pods(stage: Stage) -> None:
    """A pod that is deleted before is made again as it was; one that is there afterwards goes when the roll-out had its
    time."""
    stage.cluster.deployments = {"detector": deployment()}
    stage.cluster.pods = {"detector-abc12-x": pod("detector-abc12-x", "uid-2", owner="detector")}
    beside = stranger("Container", "detector-abc12-x", container="side", uid="uid-2", reason="ForeignContainer")
    stage.name(beside)
    stage.name(changed(), name="releases", looks_at="releases")
    stage.turn()
    assert (len(stage.cluster.patched), stage.cluster.deleted) == (1, [])
    assert stage.cluster.condition()[2] == (
        "Pod vehicle-00/detector-abc12-x goes when Deployment vehicle-00/detector is restored"
    )
    stage.name(name="releases", looks_at="releases")
    stage.turn()
    assert stage.cluster.deleted == []
    stage.turn(ROLL_OUT_SECONDS)
    assert stage.cluster.deleted == [("detector-abc12-x", "uid-2", 10)]


def test_what_comes_again_does_not_make_a_hot_loop(stage: Stage) -> None:
    """Somebody makes the pod anew at once, for an hour."""
    stage.cluster.makers = {"foreign"}
    stage.cluster.pods = {"foreign": pod()}
    times = []
    for _ in range(1200):
        stage.name(stranger(uid=stage.cluster.pods["foreign"]["metadata"]["uid"]))
        before = len(stage.cluster.deleted)
        stage.turn(3.0)
        if len(stage.cluster.deleted) > before:
            times.append(stage.seconds)
    pauses = [later - earlier for earlier, later in pairwise(times)]
    assert len(times) < 40
    assert min(pauses) >= PAUSE_SECONDS_MIN
    assert max(pauses) <= PAUSE_SECONDS_MAX + 3
    assert stage.cluster.condition()[1] == "ComesAgain"
    assert f"was removed {len(times)} times and comes again" in stage.cluster.condition()[2]
    assert stage.cluster.conditions_written <= 2 * len(times) + 2
    assert [event[1] for event in stage.cluster.events if event[3]] == ["ComesAgain"] * (len(times) - 1)
    assert "robotkube_removal_coming_again 1.0" in MetricsPage(stage.remover.metrics).text()


def test_a_deployment_that_is_changed_again_and_again_is_restored_with_pauses(stage: Stage) -> None:
    stage.cluster.deployments = {"detector": deployment()}
    for _ in range(200):
        now = stage.cluster.deployments["detector"]["metadata"]["generation"]
        stage.name(changed(generation=now), name="releases", looks_at="releases")
        stage.turn()
    assert 3 <= len(stage.cluster.patched) < 12
    assert stage.cluster.condition("releases")[1] == "ComesAgain"


def test_what_cannot_be_removed_is_said_once(stage: Stage) -> None:
    stage.name(stranger("StaticPod", "static-one"))
    stage.name(stranger("Container", "beside", container="x"), name="machine.one", looks_at="machine")
    stage.cluster.pods = {"static-one": pod("static-one"), "beside": pod("beside")}
    for _ in range(20):
        stage.turn()
    assert stage.cluster.deleted == []
    assert stage.cluster.condition()[:2] == stage.cluster.condition("machine.one")[:2] == ("False", "CannotBeRemoved")
    assert [event[:2] for event in stage.cluster.events] == [
        ("kubelet.one", "CannotBeRemoved"),
        ("machine.one", "CannotBeRemoved"),
    ]
    assert stage.cluster.conditions_written == 2


def test_the_mirror_of_a_static_pod_is_not_deleted(stage: Stage) -> None:
    """Its kubelet would make it again, and the static pod would not have noticed."""
    stage.cluster.pods = {"foreign": pod(annotations={"kubernetes.io/config.mirror": "x"})}
    stage.name(stranger())
    stage.turn()
    assert stage.cluster.deleted == []
    assert stage.cluster.condition()[1] == "CannotBeRemoved"


def test_a_refusal_is_said_and_tried_again_after_a_pause(stage: Stage) -> None:
    stage.cluster.pods = {"foreign": pod()}
    stage.cluster.refusing = 'pods "foreign" is forbidden'
    stage.name(stranger())
    stage.turn()
    stage.turn()
    said = ("False", "Refused", 'Pod vehicle-00/foreign was not touched: pods "foreign" is forbidden')
    assert stage.cluster.condition() == said
    assert [event[1] for event in stage.cluster.events] == ["Refused"]
    stage.cluster.refusing = ""
    stage.turn(PAUSE_SECONDS_MAX - 200)
    assert len(stage.cluster.deleted) == 1


def test_what_may_not_be_read_is_said_and_stops_nothing_else(stage: Stage) -> None:
    stage.cluster.pods = {"foreign": pod(), "hidden": pod("hidden", "uid-2")}
    stage.cluster.hidden = {"hidden"}
    stage.name(stranger(), stranger(name="hidden", uid="uid-2"))
    stage.turn()
    assert stage.cluster.deleted == [("foreign", UID, 1)]
    assert stage.cluster.condition()[1] == "Refused"


def test_too_many_at_once_wait() -> None:
    """An inspector that is wrong does not empty a fleet."""
    stage = Stage(RemovalPolicy(POLICY.agents, per_minute=3))
    names = [f"pod-{number}" for number in range(8)]
    stage.cluster.pods = {name: pod(name, name) for name in names}
    stage.name(*(stranger(name=name, uid=name) for name in names))
    stage.turn()
    assert len(stage.cluster.deleted) == 3
    assert stage.cluster.condition()[1] == "TooMany"
    assert "raise remover.perMinute" in stage.cluster.condition()[2]
    stage.turn()
    assert len(stage.cluster.deleted) == 3
    stage.turn(60)
    assert len(stage.cluster.deleted) == 6


def test_nothing_is_removed_on_the_word_of_an_old_look(stage: Stage) -> None:
    stage.cluster.pods = {"foreign": pod()}
    stage.name(stranger())
    stage.turn(151)
    assert stage.cluster.deleted == []
    assert stage.cluster.condition()[:2] == ("Unknown", "NotSeen")
    stage.cluster.put(inspection(stranger(), seen="False", at_ns=int(stage.now_ns)))
    stage.turn()
    assert stage.cluster.deleted == []


def test_an_api_server_that_is_away_ends_nothing(stage: Stage) -> None:
    stage.cluster.away = True
    stopping = threading.Event()
    thread = threading.Thread(target=stage.remover.run, args=(stopping,))
    thread.start()
    stopping.set()
    thread.join(10)
    assert not thread.is_alive()


def test_it_is_ready_while_it_reads(stage: Stage) -> None:
    assert stage.remover.reasons_not_ready() == ["the Inspections were not read yet"]
    stage.turn()
    assert stage.remover.reasons_not_ready() == []
    stage.seconds += SILENCE_SECONDS_MAX + 1
    assert stage.remover.reasons_not_ready() == ["the Inspections were read last 61 s ago"]


def test_metrics_have_bounded_labels(stage: Stage) -> None:
    stage.cluster.pods = {"foreign": pod()}
    stage.name(stranger(), stranger("StaticPod", "static-one"))
    stage.turn()
    page = MetricsPage(stage.remover.metrics).text()
    assert 'robotkube_removals_total{act="delete",result="done"} 1.0' in page
    assert 'robotkube_removal_inspections{reason="CannotBeRemoved"} 1.0' in page
    assert "robotkube_removal_turn_failures_total 0.0" in page
