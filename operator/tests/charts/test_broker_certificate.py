"""The broker's program as the chart renders it, on a real mosquitto: who is refused and in what words, and that a
renewed certificate is shown without a restart and without a lost message."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.tasks.adapters.paho_gateway import PahoGateway
from robotkube.errors import UnavailableError
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.certificates.adapters.verification import ServerVerification, client_context
from robotkube.registry.suites.adapters.broker_observer import PahoObserver
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import CLOSED
from tests.stages.delivery.rights.encrypted_broker import NAME, EncryptedBroker, Turned, running
from tests.stages.delivery.rights.rights_broker import password
from tests.stages.paths import CHARTS
from tests.stages.waiting import WAIT_SECONDS_MAX, until

pytestmark = pytest.mark.toolchain

PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
POSE = "mqtt/vehicles/vehicle_00/pose"
RENEWALS, MESSAGES = 4, 40


@pytest.fixture(scope="module")
def files(helm: Any) -> dict[str, str]:
    return dict(
        helm.template(CHARTS / "robotkube", PROFILE, tls={"accounts": "passwords"}).one("ConfigMap", "broker")["data"]
    )


@pytest.fixture
def broker(files: dict[str, str], tmp_path: Path) -> Iterator[EncryptedBroker]:
    with running(tmp_path / "broker", files) as broker:
        yield broker


@pytest.fixture
def turned() -> Iterator[Turned]:
    with contextlib.closing(Turned()) as made:
        yield made


def test_certificates_are_renewed_under_load_without_a_lost_message_or_connection(
    broker: EncryptedBroker, turned: Turned
) -> None:
    """A vehicle that sends poses and, now and then, 3 MB of clouds; each certificate lives for a minute."""
    vehicle, events = turned.add(broker.account("vehicle-00"), "vehicle-00-telemetry")
    observer, heard = turned.add(broker.account("observer"), "observer")
    turned.until(lambda: vehicle.complaint is None and observer.complaint is None, "connected")
    observer.subscribe(["mqtt/#"])
    turned.until(lambda: vehicle.publish(POSE, b"first", False) is not None and events.heard, "subscribed")
    heard.messages.clear()
    sent: list[bytes] = []

    def send() -> None:
        for _ in range(MESSAGES):
            payload = b"%d" % len(sent) if len(sent) % MESSAGES else bytes(3_000_000)
            if vehicle.publish(POSE, payload, False) is not None:
                sent.append(payload)
            turned.turn()

    for _ in range(RENEWALS):
        before = broker.shown()
        broker.show(60)
        end = time.monotonic() + WAIT_SECONDS_MAX
        while broker.shown() == before:
            assert time.monotonic() < end, "the certificate was not read again"
            send()
        send()
    turned.until(lambda: len(heard.messages) >= len(sent), "all of them")
    assert [message for message in heard.messages if message != b"first"] == sent
    assert (events.lost, heard.lost) == (0, 0)
    assert broker.process.poll() is None


def test_who_is_refused_is_told_what_and_what_to_do(broker: EncryptedBroker, turned: Turned) -> None:
    """Wrong name, another authority, expired, and a client that speaks in clear text."""
    at = f"no encrypted connection to the broker 127.0.0.1:{broker.port}: its certificate"
    assert f"{at} is not for the name forge; connect by one" in turned.complaint(broker.account("vehicle-00", "forge"))
    other = broker.folder / "other.crt"
    other.write_text(new_authority("ours", time.time()).certificate)
    said = turned.complaint(broker.account("vehicle-00", authorities=other))
    assert f"{at} is of an authority that {other} does not have; compare" in said
    plain = BrokerAccount("127.0.0.1", broker.port, "vehicle-00", password("vehicle-00"))
    assert turned.complaint(plain) == f"asking: {CLOSED}"
    broker.renewed(60, began=120)
    assert f"{at} has expired; have it renewed" in turned.complaint(broker.account("vehicle-00"))


def test_everybody_else_who_connects_verifies_it_as_well(broker: EncryptedBroker) -> None:
    """The task gateway and the observer of suites; bridges and detectors have the channel above."""
    refusal = "refuses the subscription of everything"  # to which it has no right here: after the handshake
    for name, said in ((NAME, refusal), ("x", "its certificate is not for the name x")):
        with pytest.raises(UnavailableError, match=f"broker 127.0.0.1:{broker.port}: {said}"):
            PahoObserver(broker.account("observer", name), "observing")
        assert [one.name for one in threading.enumerate() if "observing" in one.name] == []
    for name, complaint in ((NAME, ""), ("x", "no encrypted connection to the broker")):
        account = broker.account("manager", name)
        gateway = PahoGateway(account, "gateway")
        gateway.start(["robotkube/tasks/vehicle-00"])
        until(lambda g=gateway, c=complaint: g.complaint == c or (c and c in g.complaint), "an answer")
        gateway.close()


def test_a_client_that_verifies_nothing_it_was_not_told_connects_to_nobody(broker: EncryptedBroker) -> None:
    """Without the file of authorities there is no connection, rather than one in clear text."""
    (broker.folder / "none.crt").write_text("")
    with pytest.raises(Exception, match="no authority can be read there"):
        client_context(ServerVerification(broker.folder / "none.crt", NAME))
    assert "no authority can be read there" in Turned().complaint(
        broker.account("vehicle-00", authorities=broker.folder / "none.crt")
    )


def test_probes_leave_no_words_in_the_log(broker: EncryptedBroker) -> None:
    """A kubelet's TCP probe connects and goes."""
    for _ in range(5):
        socket.create_connection(("127.0.0.1", broker.port), 5).close()
    time.sleep(0.2)
    log = (broker.folder / "log").read_text()
    assert [line for line in log.splitlines() if "OpenSSL" in line or "Client" in line] == []


def test_the_container_ends_at_once_with_its_program(broker: EncryptedBroker, turned: Turned) -> None:
    """The program is mosquitto itself, so a kubelet's signal reaches it, and its end is the container's. Who answers a
    client has begun to take signals, too."""
    vehicle, _ = turned.add(broker.account("vehicle-00"), "vehicle-00-telemetry")
    turned.until(lambda: vehicle.complaint is None, "connected")
    assert Path(f"/proc/{broker.process.pid}/comm").read_text().strip() == "mosquitto"
    assert broker.children()
    assert broker.stop() == 0
