"""Sessions at a real broker: who has another agent's account, and guesses ids, gets none of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from robotkube.robots.mqtt.core.client_ids import client_id
from tests.stages.attacks import shown
from tests.stages.delivery.rights.agent_telemetry import AgentTelemetry, connection_of
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.delivery.rights.main_of_links import POSE_01, bridge
from tests.stages.delivery.rights.rights_broker import RightsBroker, password
from tests.stages.delivery.tasks.mqtt_connection import Connection
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

OWNER, THIEF = "vehicle-00", "cloud-0"
NAME = connection_of(OWNER)
MQTT_01 = f"mqtt{POSE_01}"
GUESSES = (NAME, client_id(NAME, password(THIEF)), client_id(NAME, OWNER), f"{NAME}-{'0' * 32}")
"""What a thief can make of the names that everybody knows, and of what he has."""


@pytest.fixture(scope="module")
def platform(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KeptRights]:
    made = KeptRights(tmp_path_factory.mktemp("sessions") / "broker")
    made.ready()
    made.merge(bridge(OWNER, POSE_01))
    yield made
    made.end()
    made.broker.stop()


@pytest.fixture
def stage(platform: KeptRights) -> Iterator[KeptRights]:
    yield platform
    for connection in platform.made:
        connection.close()
    platform.made.clear()


def heard_by(stage: KeptRights, bridge: AgentTelemetry, payload: bytes) -> None:
    """Say it until the bridge hears: its subscription may still be on its way."""
    other = stage.connect("vehicle-01")
    bridge.until(lambda: (other.say(MQTT_01, payload), payload in bridge.heard)[1], "what another one says")


def test_a_broker_binds_no_client_id_to_its_account(stage: KeptRights) -> None:
    """Why ids have a secret part. Somebody else's connection under the same id ends the owner's, and what waits in the
    session of an owner who is away is gone: the thief may not hear it, so the broker throws it away."""
    owner, other = stage.connect(OWNER, client_id="guessable"), stage.connect("vehicle-01")
    assert owner.subscribe(MQTT_01) == 1
    assert stage.connect(THIEF, client_id="guessable").session_kept
    until(lambda: owner.lost, "the owner's connection ends")
    assert stage.connect(OWNER, client_id="guessable").subscribe(MQTT_01) == 1
    stage.made[-1].drop()
    other.say(MQTT_01, b"for the owner")
    stage.connect(THIEF, client_id="guessable").drop()
    back = stage.connect(OWNER, client_id="guessable")
    assert back.session_kept
    other.say(MQTT_01, b"later")
    back.until(b"later")
    assert [payload for _, payload in back.received] == [b"later"]


def test_who_guesses_the_id_of_a_bridge_gets_no_session_of_it(stage: KeptRights) -> None:
    bridge = AgentTelemetry(stage, OWNER, MQTT_01)
    heard_by(stage, bridge, b"before")
    thieves = [stage.connect(THIEF, client_id=guess) for guess in GUESSES]
    for thief in thieves:
        shown("elsewhere", f"session present {int(thief.session_kept)}", "session-taken-over")
    heard_by(stage, bridge, b"after")
    assert (bridge.losses, bridge.sessions) == (0, [False])
    bridge.channel.close()
    stage.connect("vehicle-01").say(MQTT_01, b"while it was away")
    thieves += [stage.connect(THIEF, client_id=guess) for guess in GUESSES]
    again = AgentTelemetry(stage, OWNER, MQTT_01)
    again.until(lambda: b"while it was away" in again.heard, "what waited in its session")
    assert again.sessions == [True]
    assert [thief.received for thief in thieves] == [[]] * len(thieves)
    again.channel.close()


def test_the_brokers_log_names_no_id(tmp_path: Path) -> None:
    """What it would say with `log_type notice` of a queue that is full, which anybody can bring about who is heard."""
    broker = RightsBroker(tmp_path / "broker")
    settings = broker.folder / "mosquitto.conf"
    settings.write_text(settings.read_text().replace("max_queued_messages 50000", "max_queued_messages 1"))
    broker.start(opened=True)
    topic = "mqtt/agents/vehicle_00/plan"
    secret = client_id("plan", password(OWNER))
    owner = Connection(broker.port, OWNER, password(OWNER), client_id=secret)
    assert owner.subscribe(topic) == 1
    owner.drop()
    other = Connection(broker.port, OWNER, password(OWNER))
    for number in range(40):  # 20 are on their way, one waits
        other.say(topic, b"%d" % number)
    back = Connection(broker.port, OWNER, password(OWNER), client_id=secret)
    other.say(topic, b"last")
    back.until(b"last")
    assert len(back.received) < 41
    for connection in (other, back):
        connection.close()
    broker.stop()
    assert secret not in broker.log.read_text()
