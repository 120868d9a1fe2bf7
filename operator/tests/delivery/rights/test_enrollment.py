"""Enrollment at a real broker: a reserved account is shut until main enrolls it, and again when it does no more."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import pytest

from robotkube.delivery.deployment.core.policies.agents import PATH, write_enrolled
from robotkube.delivery.rights.core.accounts import AgentAccount
from tests.stages.attacks import shown
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.delivery.rights.main_of_links import POSE_00, bridge
from tests.stages.delivery.rights.rights_broker import ACCOUNTS
from tests.stages.delivery.tasks.mqtt_connection import NOT_AUTHORISED
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

NEW = "vehicle-16"
RESERVED = replace(
    ACCOUNTS, agents=(*ACCOUNTS.agents, AgentAccount(NEW, "", NEW), AgentAccount("edge-9", "", "edge-9"))
)
ENROLLED = {PATH: write_enrolled({NEW: "vehicle"})}
POSE_16 = "/vehicles/vehicle_16/pose"
MQTT_00, MQTT_16 = f"mqtt{POSE_00}", f"mqtt{POSE_16}"
LINKS = (bridge(NEW, POSE_00), bridge("vehicle-00", POSE_16))
ENDED_SECONDS_MAX = 5.0


@pytest.fixture(scope="module")
def platform(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KeptRights]:
    made = KeptRights(tmp_path_factory.mktemp("enrollment") / "broker", accounts=RESERVED)
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


def test_accounts_of_agents_are_shut_until_main_lets_them_in(stage: KeptRights) -> None:
    stage.end()
    stage.broker.begin_anew()  # nobody keeps its rights yet
    assert [stage.connect(name).refused for name in (NEW, "vehicle-00")] == [NOT_AUTHORISED] * 2
    assert stage.connect("manager").refused is None
    stage.begin()
    stage.ready()
    assert [stage.connect(name).refused for name in (NEW, "vehicle-00")] == [NOT_AUTHORISED, None]


def test_enrolled_it_takes_part(stage: KeptRights, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    refused = stage.connect(NEW).refused
    assert refused == NOT_AUTHORISED
    shown("elsewhere", f"reason {refused:#x} of MQTT 5", "not-enrolled")
    stage.merge(*LINKS, policies=ENROLLED)
    vehicle, other = stage.connect(NEW), stage.connect("vehicle-00")
    assert vehicle.subscribe(MQTT_00) == other.subscribe(MQTT_16) == 1
    vehicle.say(MQTT_16)
    other.say(MQTT_00)
    assert (vehicle.topics(1), other.topics(1)) == ([MQTT_00], [MQTT_16])
    assert f"agent enrolled agent={NEW} role=vehicle" in caplog.text
    assert stage.connect("edge-9").refused == NOT_AUTHORISED
    assert "rights restored" not in caplog.text


def test_withdrawn_what_it_has_ends(stage: KeptRights, caplog: pytest.LogCaptureFixture) -> None:
    stage.merge(*LINKS, policies=ENROLLED)
    live, other = stage.connect(NEW, will=MQTT_16), stage.connect("vehicle-00")
    assert other.subscribe(MQTT_16) == 1
    begun = time.monotonic()
    stage.merge(*LINKS, policies={PATH: "agents: []\n"})
    until(lambda: live.lost, "its connection ends")
    assert time.monotonic() - begun < ENDED_SECONDS_MAX
    assert stage.connect(NEW).refused == NOT_AUTHORISED
    assert not other.lost
    assert other.received == []
    assert f"agent withdrawn agent={NEW}" in caplog.text
    assert "rights restored" not in caplog.text


def test_enrolled_and_revoked_it_is_shut(stage: KeptRights) -> None:
    stage.merge(*LINKS, policies=ENROLLED, revoked={NEW: "its computer was stolen"})
    assert stage.connect(NEW).refused == NOT_AUTHORISED
    stage.merge(*LINKS, policies=ENROLLED, revoked={})
    assert stage.connect(NEW).refused is None


def test_a_container_that_starts_again_keeps_who_is_enrolled(stage: KeptRights) -> None:
    stage.merge(*LINKS, policies=ENROLLED)
    stage.end()
    stage.broker.stop()
    stage.broker.start()  # as the pod's init container does when the file is still there
    vehicle = stage.connect(NEW)
    assert vehicle.refused is None
    assert vehicle.subscribe(MQTT_00) == 1
    stage.begin()
    stage.ready()
