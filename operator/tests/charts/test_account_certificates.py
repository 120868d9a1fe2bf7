"""The broker of the chart with `tls.accounts: certificates`, on a real mosquitto: a certificate says which account it
is, and whoever has none, an expired or revoked one, or one of somebody else's authority, does not get in."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.rights.adapters.dynamic_security import DynamicSecurity
from robotkube.foundation.certificates.adapters.issuing import describe, issue, issue_account, new_authority
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from scenarios.runner.observing.broker import BrokerObserver
from tests.stages.delivery.rights.encrypted_broker import NAME, EncryptedBroker, Turned, running
from tests.stages.paths import CHARTS
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
SHORT_SECONDS = 3.0
CLOUD = "mqtt/vehicles/vehicle_00/lidar_center/pointcloud"
OWN, OTHER = "mqtt/vehicles/vehicle_00/pose", "mqtt/vehicles/vehicle_01/pose"


@pytest.fixture(scope="module")
def files(helm: Any) -> dict[str, str]:
    rendered = helm.template(CHARTS / "robotkube", PROFILE, tls={"accounts": "certificates"})
    return dict(rendered.one("ConfigMap", "broker")["data"])


@pytest.fixture
def broker(files: dict[str, str], tmp_path: Path) -> Iterator[EncryptedBroker]:
    with running(tmp_path / "broker", files) as broker:
        yield broker


@pytest.fixture
def turned() -> Iterator[Turned]:
    with contextlib.closing(Turned()) as made:
        yield made


def heard_by_observer(broker: EncryptedBroker, turned: Turned) -> Callable[[], list[bytes]]:
    """What the observer hears from now on."""
    observer, heard = turned.add(broker.proved("observer"), "observer")
    turned.until(lambda: observer.complaint is None, "the observer connected")
    observer.subscribe(["mqtt/#"])
    return lambda: heard.messages


def test_the_certificate_says_which_account_it_is(broker: EncryptedBroker, turned: Turned) -> None:
    """Also to one who sends another account's name and password with it."""
    heard = heard_by_observer(broker, turned)
    vehicle, _ = turned.add(broker.proved("vehicle-00"), "vehicle-00-telemetry")
    thief, refused = turned.add(broker.proved("vehicle-01", says="vehicle-00"), "vehicle-00-telemetry-too")
    turned.until(lambda: vehicle.complaint is None and thief.complaint is None, "connected")
    turned.until(lambda: vehicle.publish(OWN, b"own", False) is not None and b"own" in heard(), "its own is heard")
    thief.publish(OWN, b"stolen", False)
    thief.publish(OTHER, b"as itself", False)
    turned.until(lambda: b"as itself" in heard(), "the certificate's account")
    assert b"stolen" not in heard()
    assert refused.lost == 0


def test_a_password_alone_lets_nobody_in(broker: EncryptedBroker, turned: Turned) -> None:
    refused(turned, broker.account("vehicle-00"), "asking: the broker asks for a certificate of the account")


def refused(turned: Turned, account: BrokerAccount, words: str) -> None:
    """Who connects is refused, and told why."""
    channel, events = turned.add(account, "asking")
    turned.until(lambda: words in (channel.complaint or ""), words)
    assert not events.ups


def spoiled(broker: EncryptedBroker) -> dict[str, tuple[Pair, str]]:
    """Certificates that do not hold, each with what is said."""
    now = time.time()
    ours = broker.authority
    stranger = new_authority("ours", now)
    return {
        "expired": (issue_account(ours, "vehicle-00", now - 120, 60), "has expired"),
        "another authority": (issue_account(stranger, "vehicle-00", now, 60), "does not know the authority"),
        "of a server": (issue(ours, ["vehicle-00"], now, 60), "the broker does not take the account's certificate"),
        "not valid yet": (issue_account(ours, "vehicle-00", now + 3600, 60), "the broker does not take"),
    }


@pytest.mark.parametrize("name", ["expired", "another authority", "of a server", "not valid yet"])
def test_one_that_does_not_hold_lets_nobody_in(broker: EncryptedBroker, turned: Turned, name: str) -> None:
    pair, words = spoiled(broker)[name]
    refused(turned, broker.proved("vehicle-00", pair), words)


def test_a_revoked_one_is_refused_and_another_of_the_same_account_is_not(
    broker: EncryptedBroker, turned: Turned
) -> None:
    """The list is read again when it changes; connections that stand are the rights' to end."""
    lost = issue_account(broker.authority, "vehicle-00", time.time(), 3600)
    before, events = turned.add(broker.proved("vehicle-00", lost), "vehicle-00-telemetry")
    turned.until(lambda: before.complaint is None, "connected")
    broker.revoke(describe(lost, broker.authority).serial)

    def lets_in() -> bool:
        trying = Turned()
        channel, _ = trying.add(broker.proved("vehicle-00", lost), "again")
        trying.until(lambda: channel.complaint != "again: not connected to the broker yet", "an answer")
        trying.close()
        return channel.complaint is None

    until(lambda: not lets_in(), "the list read again")
    refused(turned, broker.proved("vehicle-00", lost), "is revoked")
    assert (before.complaint, events.lost) == (None, 0)
    after, _ = turned.add(broker.proved("vehicle-00"), "vehicle-00-bulk")
    turned.until(lambda: after.complaint is None, "the next certificate")


def test_an_account_that_is_shut_may_nothing_although_its_certificate_is_good(
    broker: EncryptedBroker, turned: Turned
) -> None:
    """What `rights` does at once, until the list is there: the connection ends, and the next one is deaf and dumb."""
    heard = heard_by_observer(broker, turned)
    vehicle, events = turned.add(broker.proved("vehicle-00"), "vehicle-00-telemetry")
    turned.until(lambda: vehicle.complaint is None, "connected")
    rights = DynamicSecurity(lambda: broker.proved("rights"))
    until(lambda: (rights.turn(), rights.complaint is None)[1], "the rights connected")
    shut = [{"command": "modifyRole", "rolename": "vehicle-00", "acls": []}]
    rights.ask([*shut, {"command": "disableClient", "username": "vehicle-00"}])
    turned.until(lambda: events.lost and vehicle.complaint is None, "ended, and connected again")
    rights.ask([{"command": "modifyClient", "username": "vehicle-00"}])  # as at each of its looks
    turned.until(lambda: events.lost == 2 and vehicle.complaint is None, "ended again")
    vehicle.publish(OWN, b"shut", False)
    other, _ = turned.add(broker.proved("vehicle-01"), "vehicle-01-telemetry")
    turned.until(lambda: other.complaint is None and other.publish(OTHER, b"after", False) is not None, "another one")
    turned.until(lambda: b"after" in heard(), "what comes later")
    assert b"shut" not in heard()
    rights.close()


def test_renewed_certificates_of_accounts_are_shown_to_the_next_connection(
    broker: EncryptedBroker, turned: Turned
) -> None:
    """Nothing ends with the first one: a connection that stands goes on after its certificate has expired."""
    heard = heard_by_observer(broker, turned)
    short = issue_account(broker.authority, "vehicle-00", time.time(), 3)
    account = broker.proved("vehicle-00", short)
    vehicle, events = turned.add(account, "vehicle-00-telemetry")
    turned.until(lambda: vehicle.complaint is None, "connected")
    end = describe(short, broker.authority).end
    turned.until(lambda: time.time() > end + 0.5, "the end of the first one")
    turned.until(lambda: vehicle.publish(OWN, b"after its end", False) is not None, "sent")
    turned.until(lambda: b"after its end" in heard(), "heard")
    assert events.lost == 0
    refused(turned, account, "has expired")
    renew(account, issue_account(broker.authority, "vehicle-00", time.time(), 3600))
    again, _ = turned.add(account, "vehicle-00-bulk")
    turned.until(lambda: again.complaint is None, "connected by the next one")


def renew(account: BrokerAccount, pair: Pair) -> None:
    assert account.certificate is not None
    (account.certificate.folder / "tls.crt").write_text(pair.certificate)
    (account.certificate.folder / "tls.key").write_text(pair.key)


def test_the_server_is_verified_as_before(broker: EncryptedBroker, turned: Turned) -> None:
    assert NAME in broker.proved("vehicle-00").tls.name  # type: ignore[union-attr]
    other = new_authority("ours", time.time())
    broker.renewed(3600, authority=other)
    assert "is of an authority that" in turned.complaint(broker.proved("vehicle-00"))


def test_the_observer_of_a_run_comes_back_with_the_certificate_of_then(broker: EncryptedBroker, turned: Turned) -> None:
    """Its first one has ended when the connection breaks: certificates may live shorter than a run."""
    began = time.time()
    accounts = [broker.proved("observer", issue_account(broker.authority, "observer", began, SHORT_SECONDS))]
    observer = BrokerObserver(lambda: accounts[-1])
    observer.start()
    until(lambda: time.time() > began + SHORT_SECONDS, "the end of the certificate")
    accounts.append(broker.proved("observer"))
    connection = observer._client.socket()
    assert isinstance(connection, socket.socket)
    connection.shutdown(socket.SHUT_RDWR)
    vehicle, _ = turned.add(broker.proved("vehicle-00"), "vehicle-00-bulk")
    turned.until(lambda: vehicle.complaint is None, "the vehicle connected")
    turned.until(lambda: vehicle.publish(CLOUD, b"cloud", False) is not None and observer._messages, "a cloud is seen")
    assert observer.stop().gaps == 1
