"""Two processes behind one Service: what reaches the one that waits is answered by the one that leads."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import httpx
import pytest

from robotkube.delivery.manager.adapters.leader_proxy import LeaderRequests
from robotkube.foundation.kubernetes.adapters.lease import identity_of
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery, sign
from robotkube.testing.leadership import MemoryLeadership
from tests.stages import http_calls
from tests.stages.programs import free_port

SECRET = b"shared"


class Process:
    def __init__(self, name: str) -> None:
        self.leadership = MemoryLeadership(None)
        self.heard = list[WebhookDelivery]()
        self.requests = LeaderRequests(self.leadership)

        def answer(body: bytes) -> tuple[int, Mapping[str, Any]]:
            return 404, {"by": name, "asked": json.loads(body)}

        pages, posts = {"/plans": lambda: {"by": name}}, {"/explain": answer}
        self.server = WebServer(
            *("127.0.0.1", 0, list, str, SECRET, self.heard.append, pages), posts=posts, forward=self.requests
        )
        self.server.start()
        self.address = f"127.0.0.1:{self.server.port}"

    def deliver(self, secret: bytes = SECRET) -> httpx.Response:
        body = json.dumps({"after": "x"}).encode()
        headers = {"X-Gitea-Event": "push", "X-Gitea-Signature": sign(body, secret)}
        return http_calls.post(f"http://{self.address}/webhook", content=body, headers=headers)

    def stop(self) -> None:
        self.server.stop()
        self.requests.close()


@pytest.fixture
def leader() -> Iterator[Process]:
    process = Process("leader")
    process.leadership.number = 1
    yield process
    process.stop()


@pytest.fixture
def waiting(leader: Process) -> Iterator[Process]:
    process = Process("waiting")
    process.leadership.other = leader.address
    yield process
    process.stop()


def test_pages_and_questions_are_answered_by_the_leader(leader: Process, waiting: Process) -> None:
    for process in (leader, waiting):
        assert http_calls.get(f"http://{process.address}/plans").json() == {"by": "leader"}
        answer = http_calls.post(f"http://{process.address}/explain", json={"task": "a/b"})
        assert (answer.status_code, answer.json()) == (404, {"by": "leader", "asked": {"task": "a/b"}})
        assert answer.headers["content-type"] == "application/json"
        assert http_calls.get(f"http://{process.address}/else").status_code == 404


def test_a_delivery_is_heard_by_the_leader_once(leader: Process, waiting: Process) -> None:
    assert waiting.deliver().status_code == 204
    assert (leader.heard, waiting.heard) == ([WebhookDelivery("push", {"after": "x"})], [])
    assert waiting.deliver(b"wrong").status_code == 401
    assert len(leader.heard) == 1


def test_without_a_leader_the_sender_is_refused(waiting: Process) -> None:
    waiting.leadership.other = None
    answers = [http_calls.get(f"http://{waiting.address}/plans"), waiting.deliver()]
    assert [answer.status_code for answer in answers] == [503, 503]
    assert "no process of this manager leads" in answers[0].text
    waiting.leadership.other = f"127.0.0.1:{free_port()}"
    answer = http_calls.get(f"http://{waiting.address}/plans")
    assert (answer.status_code, waiting.leadership.other in answer.text) == (503, True)


def test_two_that_take_each_other_for_the_leader_do_not_ask_for_ever(leader: Process, waiting: Process) -> None:
    leader.leadership.number = None
    leader.leadership.other = waiting.address
    assert http_calls.get(f"http://{waiting.address}/plans").status_code == 503


@pytest.mark.parametrize("name", ["x-robotkube-forwarded", "x-robotkube-handed-on"])
def test_what_was_forwarded_is_not_forwarded_again(leader: Process, waiting: Process, name: str) -> None:
    """The second name is that of a process of the version before, during an upgrade."""
    assert http_calls.get(f"http://{waiting.address}/plans", headers={name: "1"}).status_code == 503
    assert http_calls.get(f"http://{leader.address}/plans", headers={name: "1"}).status_code == 200


def test_headers_that_are_no_ascii_are_forwarded(waiting: Process) -> None:
    answer = http_calls.post(
        f"http://{waiting.address}/explain", content=b"{}", headers={"Content-Type": b"application/json; \xfc"}
    )
    assert (answer.status_code, answer.json()) == (404, {"by": "leader", "asked": {}})


def test_health_and_metrics_are_a_process_s_own(waiting: Process) -> None:
    waiting.leadership.other = None
    for path in ("/livez", "/readyz", "/metrics"):
        assert http_calls.get(f"http://{waiting.address}{path}").status_code == 200


@pytest.mark.parametrize(
    ("host", "identity"), [("10.0.0.7", "manager-x_10.0.0.7:8080"), ("fd00::7", "manager-x_[fd00::7]:8080")]
)
def test_an_identity_names_pod_and_address(host: str, identity: str) -> None:
    assert identity_of("manager-x", host, 8080) == identity
