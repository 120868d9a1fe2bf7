"""What a real broker lets pass between the scopes of two managers: what both consent to, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from robotkube.delivery.deployment.core.policies.links import path_of
from robotkube.delivery.rights.core.accounts import ManagerAccount
from tests.stages.attacks import shown
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.delivery.rights.main_of_links import POSE_00, POSE_01, bridge
from tests.stages.delivery.rights.rights_broker import ACCOUNTS
from tests.stages.delivery.tasks.mqtt_connection import ANSWER_SECONDS_MAX, NOT_AUTHORISED

pytestmark = pytest.mark.processes

MANAGERS = (ManagerAccount("south", ("vehicle-00", "roadside-0")), ManagerAccount("north", ("vehicle-01", "cloud-0")))
CONSENTS = {
    path_of("south"): "sends: [{to: north, topics: ['/vehicles/{agent}/pose']}]\n",
    path_of("north"): f"receives: [{{from: south, topics: [{POSE_00}]}}]\n",
}
OWN, FOREIGN = f"mqtt{POSE_01}", f"mqtt{POSE_00}"
OTHER_FOREIGN = "mqtt/vehicles/roadside_0/pose"


@pytest.fixture
def rights(tmp_path: Path) -> Iterator[KeptRights]:
    made = KeptRights(tmp_path / "broker", accounts=replace(ACCOUNTS, managers=MANAGERS))
    made.ready()
    yield made
    made.end()
    made.broker.stop()


def test_any_agent_is_who_may_be_heard(rights: KeptRights) -> None:
    """The listener subscribes once, and notices nothing of consents but what he hears."""
    listening = bridge("cloud-0", "/vehicles/{agent}/pose")
    rights.merge(listening)
    listener = rights.connect("cloud-0")
    assert listener.subscribe("mqtt/vehicles/+/pose") == 1
    own, foreign, other = (rights.connect(name) for name in ("vehicle-01", "vehicle-00", "roadside-0"))

    def said(word: bytes) -> set[str]:
        """All say this, who is always heard last; what the listener hears of it."""
        before = len(listener.received)
        for connection, topic in ((foreign, FOREIGN), (other, OTHER_FOREIGN), (own, OWN)):
            connection.say(topic, word)
        with listener.arrived:
            listener.arrived.wait_for(lambda: (OWN, word) in listener.received, ANSWER_SECONDS_MAX)
        return {topic for topic, _ in listener.received[before:]}

    assert said(b"without") == {OWN}
    rights.merge(listening, policies=CONSENTS)
    assert said(b"by consent") == {OWN, FOREIGN}
    rights.merge(listening, policies={path_of("south"): CONSENTS[path_of("south")]})
    assert said(b"withdrawn") == {OWN}
    assert not listener.lost


def test_a_link_that_only_one_scope_wants_is_no_right(rights: KeptRights) -> None:
    listener = rights.connect("cloud-0")
    for scope in ("south", "north"):
        rights.merge(bridge("cloud-0", POSE_00), policies={path_of(scope): CONSENTS[path_of(scope)]})
        refused = listener.subscribe(FOREIGN)
        assert refused == NOT_AUTHORISED
        shown("elsewhere", f"the subscription: reason {refused:#x} of MQTT 5", "heard-over-a-border")
    rights.merge(bridge("cloud-0", POSE_00), policies=CONSENTS)
    assert listener.subscribe(FOREIGN) == 1
