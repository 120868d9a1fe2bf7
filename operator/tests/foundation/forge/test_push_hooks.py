"""Telling a manager that main moved, over real sockets."""

from collections.abc import Iterator

import pytest

from robotkube.delivery.manager.__main__ import changed_by
from robotkube.delivery.manager.loops.reconciler import CATALOGUE, DEPLOYMENT
from robotkube.foundation.forge.adapters.push_hooks import PushRelay
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery

SECRET = b"shared"
BEFORE, AFTER = "1" * 40, "2" * 40


@pytest.fixture
def deliveries() -> list[WebhookDelivery]:
    return []


@pytest.fixture
def url(deliveries: list[WebhookDelivery]) -> Iterator[str]:
    server = WebServer("127.0.0.1", 0, lambda: [], lambda: "", SECRET, deliveries.append)
    server.start()
    yield f"http://127.0.0.1:{server.port}/webhook"
    server.stop()


def relay(url: str, secret: bytes = SECRET) -> bool:
    relayed = PushRelay(url, secret, "robotkube/deployment")
    try:
        return relayed.hook(BEFORE, AFTER)
    finally:
        relayed.disconnect()


def test_a_manager_reads_it_as_the_forges_own_word(url: str, deliveries: list[WebhookDelivery]) -> None:
    assert relay(url)
    assert [changed_by(delivery, "robotkube/catalogue") for delivery in deliveries] == [(DEPLOYMENT, AFTER)]


def test_a_manager_that_shares_another_secret_does_not_take_it(url: str, deliveries: list[WebhookDelivery]) -> None:
    assert not relay(url, b"another")
    assert deliveries == []


def test_a_manager_that_is_away_holds_nothing_up(url: str) -> None:
    assert not relay("http://127.0.0.1:9/webhook")


@pytest.mark.parametrize(
    ("event", "payload", "heard"),
    [
        ("push", {"ref": "refs/heads/main", "after": AFTER}, (DEPLOYMENT, AFTER)),
        ("push", {"ref": "refs/heads/main", "after": 7}, (DEPLOYMENT, "")),
        ("push", {"ref": "refs/heads/other", "after": AFTER}, None),
        ("pull_request", {"action": "closed"}, (DEPLOYMENT, "")),
        ("pull_request", {"action": "closed", "pull_request": {"merged": False}}, (DEPLOYMENT, "")),
        ("pull_request", {"action": "closed", "pull_request": {"merged": True}}, None),
        ("pull_request", {"action": "opened"}, None),
        (
            "push",
            {"ref": "refs/heads/main", "after": AFTER, "repository": {"full_name": "robotkube/catalogue"}},
            (CATALOGUE, AFTER),
        ),
    ],
)
def test_what_changes_something(event: str, payload: dict[str, object], heard: tuple[str, str] | None) -> None:
    assert changed_by(WebhookDelivery(event, payload), "robotkube/catalogue") == heard
