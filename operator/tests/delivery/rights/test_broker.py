"""Rights on a real broker: what agents may say and hear, and that the process keeps the table to main."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from robotkube.delivery.rights.core.control import REQUESTS, RESPONSES
from robotkube.delivery.rights.loops import keeper as keeping
from tests.stages.attacks import shown
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.delivery.rights.main_of_links import POSE_00, POSE_01, bridge
from tests.stages.delivery.tasks.mqtt_connection import NOT_AUTHORISED, Connection
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

MQTT_00, MQTT_01 = f"mqtt{POSE_00}", f"mqtt{POSE_01}"
APPLIED_SECONDS_MAX = 1.0
Connect = Callable[..., Connection]


@pytest.fixture(scope="module")
def platform(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KeptRights]:
    made = KeptRights(tmp_path_factory.mktemp("rights") / "broker")
    yield made
    made.end()
    made.broker.stop()


@pytest.fixture
def stage(platform: KeptRights) -> Iterator[KeptRights]:
    platform.merge()
    platform.ready()
    yield platform
    for connection in platform.made:
        connection.close()
    platform.made.clear()


# -- what an agent may -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "topic",
    [
        *(MQTT_01, "mqtt/vehicles/vehicle_000/pose", "mqtt/agents/cloud_0/plan", "mqtt/other", "x"),
        *(f"robotkube/types/{MQTT_01}", f"mqtt_client/ros_msg_type/{MQTT_01}"),
        *("robotkube/tasks/vehicle-01", "robotkube/task_status/vehicle-00", "robotkube/holds/vehicle-01"),
        "robotkube/links/vehicle-01/mqtt-bridge",
        *(REQUESTS, RESPONSES, "$SYS/broker/uptime"),
    ],
)
def test_an_agent_writes_nothing_of_others(stage: KeptRights, topic: str) -> None:
    stage.merge(bridge("vehicle-00", POSE_01))
    vehicle = stage.connect("vehicle-00")
    assert vehicle.publish(topic) == NOT_AUTHORISED
    assert vehicle.publish(topic, b"kept", retain=True) == NOT_AUTHORISED


@pytest.mark.parametrize("name", ["vehicle-00", "roadside-0", "cloud-0"])
def test_every_agent_speaks_below_its_own_name(stage: KeptRights, name: str) -> None:
    own = f"mqtt/agents/{name.replace('-', '_')}/plan"
    agent = stage.connect(name)
    assert agent.subscribe(own) == 1
    agent.say(own)
    assert agent.topics(1) == [own]
    speaks = agent.publish(f"mqtt/vehicles/{name.replace('-', '_')}/x") != NOT_AUTHORISED
    assert speaks == (name != "cloud-0")


@pytest.mark.parametrize(
    "asked",
    [
        *(MQTT_01, "mqtt/vehicles/vehicle_01/#", "mqtt/vehicles/+/pose", "mqtt/vehicles/#", "mqtt/#", "#", "+/+/+/+"),
        *(f"$share/group/{MQTT_01}", "$share/group/#", f"robotkube/types/{MQTT_01}", "robotkube/tasks/#"),
        *(RESPONSES, "$CONTROL/#", "$SYS/#", "robotkube/task_status/vehicle-01"),
    ],
)
def test_without_a_link_nothing_is_heard(stage: KeptRights, asked: str) -> None:
    listener, other = stage.connect("vehicle-00"), stage.connect("vehicle-01")
    assert listener.subscribe(asked) == NOT_AUTHORISED
    listener.subscribe(MQTT_00)
    other.say(MQTT_01)
    listener.say(MQTT_00)
    assert listener.topics(1) == [MQTT_00]


def test_a_link_from_vehicle_to_vehicle_is_heard_and_nothing_besides(stage: KeptRights) -> None:
    assert stage.merge(bridge("vehicle-00", POSE_01)) < APPLIED_SECONDS_MAX
    listener, other = stage.connect("vehicle-00"), stage.connect("vehicle-01")
    assert listener.subscribe(MQTT_01) == 1
    for wider in ("mqtt/vehicles/+/pose", "mqtt/vehicles/vehicle_01/#", f"$share/group/{MQTT_01}"):
        assert listener.subscribe(wider) == NOT_AUTHORISED
    other.say("mqtt/vehicles/vehicle_01/speed")
    other.say(MQTT_01)
    assert listener.topics(1) == [MQTT_01]
    assert listener.publish(MQTT_01) == NOT_AUTHORISED


def test_a_link_of_any_agent(stage: KeptRights) -> None:
    stage.merge(bridge("cloud-0", "/vehicles/{agent}/pose"))
    cloud, vehicle = stage.connect("cloud-0"), stage.connect("vehicle-01")
    assert cloud.subscribe("mqtt/vehicles/+/pose") == 1
    assert cloud.subscribe("mqtt/vehicles/+/+") == NOT_AUTHORISED
    assert cloud.subscribe("mqtt/vehicles/#") == NOT_AUTHORISED
    vehicle.say("mqtt/vehicles/vehicle_01/speed")
    vehicle.say(MQTT_01)
    assert cloud.topics(1) == [MQTT_01]


def test_a_withdrawn_link_ends_for_who_listens(stage: KeptRights) -> None:
    stage.merge(bridge("vehicle-00", POSE_01))
    listener, other = stage.connect("vehicle-00"), stage.connect("vehicle-01")
    listener.subscribe(MQTT_01)
    listener.subscribe(MQTT_00)
    other.say(MQTT_01, b"before")
    listener.until(b"before")
    assert stage.merge() < APPLIED_SECONDS_MAX
    other.say(MQTT_01, b"after")
    listener.say(MQTT_00, b"own")
    listener.until(b"own")
    assert [payload for _, payload in listener.received] == [b"before", b"own"]
    assert listener.subscribe(MQTT_01) == NOT_AUTHORISED
    assert not listener.lost
    stage.merge(bridge("vehicle-00", POSE_01))
    other.say(MQTT_01, b"again")
    listener.until(b"again")  # by the subscription that stood all the while


def test_retained_messages_are_for_who_may_hear_them(stage: KeptRights) -> None:
    listener, other = stage.connect("vehicle-00"), stage.connect("vehicle-01")
    other.say(MQTT_01, b"kept", retain=True)
    assert listener.subscribe(MQTT_01) == NOT_AUTHORISED
    stage.merge(bridge("vehicle-00", POSE_01))
    assert listener.subscribe(MQTT_01) == 1
    listener.until(b"kept")
    other.say(MQTT_01, b"", retain=True)


def test_a_last_will_is_a_message_like_others(stage: KeptRights) -> None:
    observer = stage.connect("observer")
    observer.subscribe("mqtt/#")
    for topic in (MQTT_01, MQTT_00):
        stage.connect("vehicle-00", will=topic).drop()
    observer.until(b"last will")
    assert observer.received == [(MQTT_00, b"last will")]


def test_platform_accounts(stage: KeptRights) -> None:
    observer, manager, vehicle = (stage.connect(name) for name in ("observer", "manager", "vehicle-00"))
    assert observer.subscribe("mqtt/#") == observer.subscribe("mqtt/vehicles/+/lidar_center/pointcloud") == 1
    assert observer.publish(MQTT_00) == NOT_AUTHORISED
    assert manager.subscribe("mqtt/#") == NOT_AUTHORISED
    assert manager.subscribe("robotkube/tasks/vehicle-00") == manager.subscribe("robotkube/holds/vehicle-00") == 1
    assert manager.subscribe("robotkube/links/vehicle-00/+") == 1
    assert vehicle.subscribe("robotkube/task_status/vehicle-00") == 1
    vehicle.say("robotkube/tasks/vehicle-00")
    vehicle.say("robotkube/holds/vehicle-00")
    vehicle.say("robotkube/links/vehicle-00/mqtt-bridge")
    said = ["robotkube/tasks/vehicle-00", "robotkube/holds/vehicle-00", "robotkube/links/vehicle-00/mqtt-bridge"]
    assert manager.topics(3) == said
    manager.say("robotkube/task_status/vehicle-00")
    assert vehicle.topics(1) == ["robotkube/task_status/vehicle-00"]
    assert stage.connect("rights").publish(MQTT_00) == NOT_AUTHORISED


# -- the process -------------------------------------------------------------------------------------------------------


def test_no_message_of_others_is_lost_and_nobody_disconnected_while_rights_change(stage: KeptRights) -> None:
    link = bridge("vehicle-00", POSE_01)
    stage.merge(link)
    listener, other, changed = (stage.connect(name) for name in ("vehicle-00", "vehicle-01", "cloud-0"))
    listener.subscribe(MQTT_01)
    sent = 0
    for turn in range(10):
        topics = [f"/vehicles/vehicle_00/t{number}" for number in range(turn * 20)]
        tip = stage.main.put(link, bridge("cloud-0", *topics))
        stage.follower.wake(tip)
        while stage.keeper.applied != tip:
            other.say(MQTT_01, b"%d" % sent)
            sent += 1
    listener.until(b"%d" % (sent - 1))
    assert [payload for _, payload in listener.received] == [b"%d" % number for number in range(sent)]
    assert [one.lost for one in (listener, other, changed)] == [False] * 3


def test_the_table_is_the_same_after_a_restart_of_the_broker_and_of_the_process(stage: KeptRights) -> None:
    stage.merge(bridge("vehicle-00", POSE_01))
    stage.end()
    stage.broker.restart()
    assert stage.connect("vehicle-00").subscribe(MQTT_01) == 1  # by what the broker kept
    stage.begin()
    stage.ready()
    stage.broker.begin_anew()
    until(lambda: stage.keeper.reasons_not_ready(), "it is seen")
    restored = stage.keeper.restored
    stage.ready()
    assert stage.connect("vehicle-00").subscribe(MQTT_01) == 1
    assert stage.keeper.restored == restored  # a broker that begins anew was changed by nobody


def test_while_the_forge_is_away_the_last_table_stays(stage: KeptRights) -> None:
    stage.merge(bridge("vehicle-00", POSE_01))
    stage.main.away = True
    stage.follower.wake()
    until(lambda: stage.follower.problem, "a problem")
    assert stage.keeper.reasons_not_ready() == []
    stage.broker.begin_anew()
    until(lambda: stage.keeper.reasons_not_ready(), "it is seen")
    stage.ready()
    assert stage.connect("vehicle-00").subscribe(MQTT_01) == 1
    stage.end()
    stage.begin()
    until(lambda: stage.control.complaint is None, "a connection")
    until(lambda: stage.follower.problem, "a problem")
    assert "main was not read yet" in stage.keeper.reasons_not_ready()[0]
    assert stage.connect("vehicle-00").subscribe(MQTT_01) == 1
    stage.main.away = False
    stage.follower.wake()
    stage.ready()


def test_a_change_by_another_hand_is_put_right_and_told(stage: KeptRights, caplog: pytest.LogCaptureFixture) -> None:
    """While the process is away: what stands afterwards is main's, whoever changed it."""
    stage.merge(bridge("cloud-0", POSE_00))
    acls = [{"acltype": kind, "topic": "#", "allow": True} for kind in ("subscribePattern", "publishClientReceive")]
    with stage.other_hand() as hand:
        hand.ask([{"command": "modifyRole", "rolename": "vehicle-00", "acls": acls}])
        hand.ask([{"command": "createRole", "rolename": "all", "acls": acls}])
        hand.ask([{"command": "createClient", "username": "stranger", "password": "x", "roles": [{"rolename": "all"}]}])
        hand.ask([{"command": "addClientRole", "username": "cloud-0", "rolename": "all"}])
        hand.ask([{"command": "deleteRole", "rolename": "vehicle-01"}])
        hand.ask([{"command": "setDefaultACLAccess", "acls": [{"acltype": "publishClientSend", "allow": True}]}])
        assert stage.connect("vehicle-00").subscribe("mqtt/#") == 1
        assert Connection(stage.broker.port, "stranger", "x").refused is None
    for name in ("vehicle-00", "cloud-0"):
        assert stage.connect(name).subscribe("mqtt/#") == NOT_AUTHORISED
    other = stage.connect("vehicle-01")
    other.say(MQTT_01)
    assert other.publish(MQTT_00) == NOT_AUTHORISED
    assert Connection(stage.broker.port, "stranger", "x").refused == NOT_AUTHORISED
    logged = " ".join(record.getMessage() for record in caplog.records)
    for about in ("stranger", "all", "cloud-0", "vehicle-00", "vehicle-01", "defaults"):
        assert f"rights restored about={about} " in logged
    shown("elsewhere", logged, "rights-changed")
    assert stage.keeper.restored == 7


def test_a_change_that_is_made_meanwhile_is_put_right(
    stage: KeptRights, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    restored = stage.keeper.restored
    monkeypatch.setattr(keeping, "CHECK_SECONDS", 0.3)
    stage.keeper.wake()
    acls = [{"acltype": "publishClientSend", "topic": "mqtt/#", "allow": True}]
    stage.tamper({"command": "modifyRole", "rolename": "vehicle-00", "acls": acls})
    until(lambda: stage.keeper.restored == restored + 1, "it is put right")
    until(lambda: stage.connect("vehicle-00").publish(MQTT_01) == NOT_AUTHORISED, "the right is gone")
    assert "rights restored about=vehicle-00 was='besides publishClientSend mqtt/#" in caplog.text
