"""Links that a bridge does not carry: whose task is not Ready, in which words, and for how long."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from robotkube.delivery.manager.core.broken_links import broken_links, link_faults
from robotkube.delivery.manager.core.composition.inputs import Met
from robotkube.delivery.manager.core.observation import ContainerState, PodState
from robotkube.delivery.manager.loops.reconciler import APPLICATIONS
from robotkube.delivery.tasks.loops.link_reports import LinkReports
from robotkube.delivery.tasks.loops.mqtt_gateway import MqttTaskGateway
from robotkube.delivery.tasks.ports.mqtt_gateway import GatewayMessage
from robotkube.robots.bridge.core.link_reports import LinkFault, LinkReport
from robotkube.testing.clusters import MemoryTasks
from robotkube.testing.task_gateways import MemoryGatewayChannel, MemoryTaskWriter
from tests.stages.delivery.manager.manager_in_memory import START_NS, Stage

BRIDGE = "vehicle-00/mqtt-bridge"
POD = PodState("vehicle-00", "mqtt-bridge-0", BRIDGE, containers=(ContainerState("mqtt-bridge", started_ns=5),))
FAULT = LinkFault("out", "/x", "the broker refuses mqtt/x: not authorised")
REPORT = LinkReport(BRIDGE, "mqtt-bridge-0", 6, (FAULT,))


def message(stage: Stage, key: str) -> str:
    conditions = stage.tasks.objects[key]["status"]["conditions"]
    return str(next(condition["message"] for condition in conditions if condition["type"] == "Ready"))


def link_of(stage: Stage, key: str) -> LinkFault:
    """A topic that the task's links take from vehicle-00."""
    outcome = stage.manager.planner.outcomes[key]
    assert isinstance(outcome, Met)
    release, direction, topic = next(link for link in outcome.links if link[0] == BRIDGE)
    assert release in outcome.releases
    return LinkFault(direction, topic, FAULT.reason)


def test_a_task_whose_link_is_not_carried_is_not_ready_and_says_link_agent_and_cause(stage: Stage) -> None:
    key = stage.ask()
    stage.go()
    stage.cluster.settle(stage.releases())
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(key, "Ready") == ("True", "Observed")
    fault = link_of(stage, key)
    stage.links = [replace(REPORT, faults=(fault,))]
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(key, "Ready") == ("False", "LinkBroken")
    text = f"its bridge {BRIDGE} does not carry it: the broker refuses mqtt/x: not authorised"
    assert message(stage, key) == f"link {fault.topic} never leaves vehicle-00: {text}"
    assert [reason for reported, reason, _ in stage.tasks.reports if reported == key] == ["LinkBroken"]
    stage.manager = stage.start()
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(key, "Ready") == ("False", "LinkBroken")
    stage.links = []
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(key, "Ready") == ("True", "Observed")


def test_a_link_of_another_application_turns_nobody_unready(stage: Stage) -> None:
    key = stage.ask()
    stage.go()
    stage.cluster.settle(stage.releases())
    stage.links = [replace(REPORT, faults=(FAULT, replace(FAULT, direction="in")))]
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(key, "Ready") == ("True", "Observed")


@pytest.mark.parametrize(
    ("pods", "said"),
    [
        ([POD], True),
        ([replace(POD, containers=())], True),
        ([replace(POD, containers=(ContainerState("mqtt-bridge", started_ns=7),))], False),
        ([replace(POD, name="mqtt-bridge-1")], False),
        ([replace(POD, deleting=True)], False),
        ([], False),
    ],
)
def test_a_report_counts_while_the_process_that_sent_it_runs(pods: list[PodState], said: bool) -> None:
    broken = broken_links([REPORT], {BRIDGE: pods}.__getitem__)
    assert broken == ({(BRIDGE, "out", "/x"): FAULT.reason} if said else {})


def test_links_that_are_broken_have_a_sentence_each() -> None:
    broken = {(BRIDGE, "in", "/y"): "no type", (BRIDGE, "out", "/x"): "refused"}
    links = [(BRIDGE, "in", "/y"), (BRIDGE, "out", "/y"), ("cloud-0/mqtt-bridge", "in", "/y")]
    assert link_faults(links, broken) == [
        "link /y never reaches vehicle-00: its bridge vehicle-00/mqtt-bridge does not carry it: no type"
    ]


def test_reports_come_by_the_task_gateway(stage: Stage) -> None:
    woken: list[int] = []
    reports = LinkReports(lambda: woken.append(1))
    channel = MemoryGatewayChannel()
    tasks = MemoryTasks()
    clock = (lambda: START_NS, lambda: 0.0)
    writer = MemoryTaskWriter(tasks)
    operators = {"vehicle-00": "vehicle-00"}
    gateway = MqttTaskGateway(operators, channel, tasks, writer, stage.leadership, *clock, links=reports.receive)

    def say(payload: bytes, release: str = "mqtt-bridge", agent: str = "vehicle-00") -> None:
        channel.waiting.append(GatewayMessage(f"robotkube/links/{agent}/{release}", payload, len(payload)))
        gateway.turn(0.0)

    listed = [{"direction": FAULT.direction, "topic": FAULT.topic, "reason": FAULT.reason}]
    report = json.dumps({"pod": "mqtt-bridge-0", "started": "6", "notCarried": listed}).encode()
    say(report)
    say(report)
    say(report, agent="vehicle-09")
    say(report, release="A b")
    say(b"gibberish")
    assert list(reports()) == [REPORT]
    say(b"")
    assert (list(reports()), woken) == ([], [1, 1])
    assert len(channel.acknowledged) == 6
