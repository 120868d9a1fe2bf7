"""Client ids: the same for the same name and password, known to nobody else, and in nothing that is said."""

from __future__ import annotations

import pytest

from robotkube.delivery.tasks.adapters.paho_gateway import PahoGateway
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from robotkube.robots.mqtt.core.client_ids import client_id, connection_name
from tests.stages.channel_events import KeptEvents

NAME = "vehicle-00-telemetry"


def account() -> BrokerAccount:
    return account_with("secret")


def account_with(password: str) -> BrokerAccount:
    return BrokerAccount("localhost", 1883, "vehicle-00", password)


def test_an_id_is_that_of_a_name_and_a_password() -> None:
    """Compared with `openssl dgst -sha256 -hmac`, since a session lives on when a process of another version starts."""
    assert client_id(NAME, "secret") == f"{NAME}-739ca288cc6d02ea7fa2fc2e25b539c8"
    others = {client_id(name, password) for name in (NAME, "vehicle-00-bulk") for password in ("secret", "Secret", "")}
    assert len(others) == 6


@pytest.mark.parametrize(
    ("identifier", "name"),
    [
        (client_id(NAME, "secret"), NAME),
        (client_id(client_id(NAME, "a"), "b"), client_id(NAME, "a")),
        (NAME, NAME),
        ("", ""),
        ("-" + "a" * 32, "-" + "a" * 32),
        (f"{NAME}-{'A' * 32}", f"{NAME}-{'A' * 32}"),
    ],
)
def test_the_name_is_what_stands_before_the_secret_part(identifier: str, name: str) -> None:
    assert connection_name(identifier) == name


def test_another_password_makes_another_session_at_the_next_attempt() -> None:
    channel = PahoChannel(account, NAME, 60, KeptEvents())
    for password in ("first", "second"):
        client = channel._new_client(account_with(password))
        assert client._client_id.decode() == client_id(NAME, password)


def test_what_is_said_of_a_connection_has_its_name_alone() -> None:
    channel = PahoChannel(account, NAME, 60, KeptEvents())
    gateway = PahoGateway(BrokerAccount("localhost", 1883, "manager", "secret"), "manager-task-door")
    assert gateway._client._client_id.decode() == client_id("manager-task-door", "secret")
    assert channel.complaint == f"{NAME}: not connected to the broker yet"
    assert gateway.complaint == "manager-task-door: not connected to the broker yet"
