"""A revoked agent at a real broker: its connections end, none begins, and nobody else notices."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pytest

from robotkube.delivery.rights.loops import keeper as keeping
from tests.stages.attacks import shown
from tests.stages.delivery.rights.agent_telemetry import AgentTelemetry
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.delivery.rights.main_of_links import POSE_00, POSE_01, bridge
from tests.stages.delivery.tasks.mqtt_connection import NOT_AUTHORISED
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

MQTT_00, MQTT_01 = f"mqtt{POSE_00}", f"mqtt{POSE_01}"
LINKS = (bridge("vehicle-00", POSE_01), bridge("vehicle-01", POSE_00))
STOLEN = {"vehicle-00": "its computer was stolen"}
ENDED_SECONDS_MAX = 5.0


@pytest.fixture(scope="module")
def platform(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KeptRights]:
    made = KeptRights(tmp_path_factory.mktemp("revocation") / "broker")
    yield made
    made.end()
    made.broker.stop()


@pytest.fixture
def stage(platform: KeptRights) -> Iterator[KeptRights]:
    platform.merge(*LINKS)
    platform.ready()
    yield platform
    for connection in platform.made:
        connection.close()
    platform.made.clear()


def test_what_it_has_ends_and_nothing_new_begins(stage: KeptRights, caplog: pytest.LogCaptureFixture) -> None:
    live = [stage.connect("vehicle-00", will=MQTT_00), stage.connect("vehicle-00", client_id="kept")]
    others = [stage.connect(name) for name in ("vehicle-01", "cloud-0", "manager", "observer")]
    assert others[0].subscribe(MQTT_00) == live[1].subscribe(MQTT_01) == 1
    begun = time.monotonic()
    stage.merge(*LINKS, revoked=STOLEN)
    until(lambda: all(one.lost for one in live), "its connections end")
    assert time.monotonic() - begun < ENDED_SECONDS_MAX
    refused = stage.connect("vehicle-00").refused
    assert refused == NOT_AUTHORISED
    shown("elsewhere", f"reason {refused:#x} of MQTT 5", "revoked-comes-back")
    others[0].say(MQTT_01, b"not for it")
    assert [one.lost for one in others] == [False] * len(others)
    assert others[0].received == []  # no last will either
    assert "account revoked agent=vehicle-00" in caplog.text
    assert "reason='its computer was stolen'" in caplog.text
    assert "rights restored" not in caplog.text
    assert stage.keeper.reasons_not_ready() == []


def test_who_is_restored_has_what_main_gives(stage: KeptRights, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    stage.merge(*LINKS, revoked=STOLEN)
    assert stage.connect("vehicle-00").refused == NOT_AUTHORISED
    stage.merge(*LINKS, revoked={})
    vehicle, other = stage.connect("vehicle-00"), stage.connect("vehicle-01")
    assert vehicle.subscribe(MQTT_01) == other.subscribe(MQTT_00) == 1
    vehicle.say(MQTT_00)
    other.say(MQTT_01)
    assert (vehicle.topics(1), other.topics(1)) == ([MQTT_01], [MQTT_00])
    assert "account restored agent=vehicle-00" in caplog.text
    assert "rights restored" not in caplog.text


def test_a_bridge_says_why_and_heals_by_itself(stage: KeptRights) -> None:
    bridge = AgentTelemetry(stage, "vehicle-00", MQTT_01)
    stage.merge(*LINKS, revoked=STOLEN)
    bridge.until(lambda: "`robotkube agent list`" in str(bridge.channel.complaint), "it is refused")
    assert str(bridge.channel.complaint).startswith("vehicle-00-telemetry: the broker refuses the connection: Not auth")
    stage.merge(*LINKS, revoked={})
    other = stage.connect("vehicle-01")
    bridge.until(lambda: (other.say(MQTT_01, b"again"), bridge.heard)[1], "it hears again")
    assert bridge.losses == 1
    bridge.channel.close()


def test_it_stays_out_when_broker_or_process_begin_anew(stage: KeptRights, caplog: pytest.LogCaptureFixture) -> None:
    stage.merge(*LINKS, revoked=STOLEN)
    stage.end()
    stage.broker.restart()
    assert stage.connect("vehicle-00").refused == NOT_AUTHORISED  # by what the broker kept
    stage.broker.stop()
    stage.broker.start()  # as the pod's init container does when the file is still there
    assert stage.connect("vehicle-00").refused == NOT_AUTHORISED
    stage.broker.begin_anew()  # another pod, which nobody has told yet
    assert stage.connect("vehicle-00").refused == NOT_AUTHORISED
    stage.begin()
    stage.ready()
    stage.broker.begin_anew()
    until(lambda: stage.keeper.reasons_not_ready(), "it is seen")
    stage.ready()
    assert stage.connect("vehicle-00").refused == NOT_AUTHORISED
    assert stage.connect("vehicle-01").refused is None
    assert "rights restored" not in caplog.text


def test_another_hand_lets_nobody_in(
    stage: KeptRights, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage.merge(*LINKS, revoked=STOLEN)
    monkeypatch.setattr(keeping, "CHECK_SECONDS", 0.3)
    stage.keeper.wake()
    stage.tamper({"command": "enableClient", "username": "vehicle-00"})
    until(lambda: "rights restored about=vehicle-00 was='an account that was open'" in caplog.text, "it is told")
    until(lambda: stage.connect("vehicle-00").refused == NOT_AUTHORISED, "it is shut again")


def test_what_a_revoked_agent_connects_once_more_is_ended_at_the_next_look(
    stage: KeptRights, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one can whose account a certificate proves, until the broker knows that it is revoked. That mosquitto ends it
    by this: charts/test_account_certificates.py."""
    monkeypatch.setattr(keeping, "CHECK_SECONDS", 3600.0)
    stage.merge(*LINKS, revoked=STOLEN)
    asked: list[list[str]] = []
    ask = stage.control.ask

    def noting(requests: Sequence[Mapping[str, Any]]) -> Any:
        asked.append([f"{request['command']} {request.get('username', '')}".strip() for request in requests])
        return ask(requests)

    monkeypatch.setattr(stage.control, "ask", noting)
    stage.keeper.wake()
    until(lambda: ["modifyClient vehicle-00"] in asked, "the next look")
    writes = stage.keeper.writes
    stage.keeper.wake()
    until(lambda: asked.count(["modifyClient vehicle-00"]) >= 2, "the one after it")
    assert stage.keeper.writes == writes
