"""Asking for tasks through the console: what would happen, submitting and withdrawing as the person who signed in, and
who is refused, and in which words."""

from __future__ import annotations

from typing import Any

import httpx
import pytest
import yaml
from jsonschema import Draft202012Validator

from robotkube.delivery.console.adapters.web.application import Console, ConsoleSurroundings
from robotkube.delivery.console.adapters.web.asking import BODY_BYTES_MAX, QUESTIONS, WRITES
from robotkube.delivery.console.adapters.web.openid_connect import OpenIdConnect
from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.core.asking import Writers, group_for, read_request, writable
from robotkube.delivery.console.core.signing_in import Person
from robotkube.delivery.console.loops.model import ReadModel
from robotkube.errors import DocumentError, InputError, RefusalError, UnavailableError
from tests.delivery.console.people import EXPLANATION, MANAGER, PlatformInMemory
from tests.delivery.console.provider import AccountProvider
from tests.delivery.console.requests import Client
from tests.delivery.console.test_sign_in import SETTINGS, URL
from tests.stages.paths import DOCS

WRITERS = (
    Writers("robotkube:operators", frozenset(["cloud-0", "vehicle-00"])),
    Writers("robotkube", frozenset(["cloud-0"])),
    Writers("others", frozenset(["vehicle-01"])),
)
REQUEST = {"namespace": "cloud-0", "application": "recording", "parameters": {"vehicles": ["vehicle-00"]}}
SCHEMAS = yaml.safe_load((DOCS / "reference" / "console-api.yaml").read_text())["components"]


class Somebody:
    """Somebody who signed in at a console with writers; `asks` sends what the page sends."""

    def __init__(self, *groups: str, writers: tuple[Writers, ...] = WRITERS) -> None:
        provider = AccountProvider(preferred_username="anna", groups=["robotkube", *groups])
        self.platform = PlatformInMemory()
        people = People(SETTINGS, OpenIdConnect(SETTINGS, provider.client), writers)
        around = ConsoleSurroundings(["console.example"], SETTINGS.encrypted)
        self.client = Client(Console(ReadModel("e", lambda: 7), people, self.platform.asking, around).app, URL)
        begun = self.client.get("/auth/login")
        self.client.get("/auth/callback", params=provider.consent(begun.headers["location"]))
        self.session = self.client.get("/api/session").json()
        self.headers = {"X-CSRF-Token": self.session["csrf"]}

    def asks(self, path: str, document: Any = REQUEST, **headers: str) -> httpx.Response:
        return self.client.post(path, json=document, headers={**self.headers, **headers})

    def withdraws(self, key: str, **headers: str) -> httpx.Response:
        return self.client.request("DELETE", f"/api/tasks/{key}", headers={**self.headers, **headers})


class Stranger:
    """Somebody without a session, before a console where everybody reads."""

    def __init__(self) -> None:
        self.platform = PlatformInMemory()
        people = People(None, writers=WRITERS)
        around = ConsoleSurroundings(["testserver"])
        self.client = Client(Console(ReadModel("e", lambda: 7), people, self.platform.asking, around).app)


def refusal(answer: httpx.Response) -> tuple[int, str]:
    assert answer.headers["content-type"] == "application/problem+json"
    return answer.status_code, answer.json()["detail"]


def test_what_would_happen_is_what_the_manager_says_and_changes_nothing() -> None:
    anna = Somebody()
    answer = anna.asks("/api/explain", {**REQUEST, "priority": 7, "reason": "to see"})
    assert answer.json() == EXPLANATION
    schema = {"$ref": "#/components/schemas/Explanation", "components": SCHEMAS}
    Draft202012Validator(schema).validate(answer.json())
    [(url, question)] = anna.platform.questions
    assert url == f"{MANAGER}/explain"
    assert question["metadata"] == {"namespace": "cloud-0", "name": "recording-preview"}
    spec = {**question["spec"], "event": None}
    asked = {"application": "recording", "parameters": REQUEST["parameters"], "priority": 7, "reason": "to see"}
    assert spec == {"requester": "anna", "event": None, **asked}
    assert anna.platform.written == []


@pytest.mark.parametrize(
    ("question", "asked"),
    [
        ({**REQUEST, "namespace": "cloud-0"}, MANAGER),
        ({**REQUEST, "namespace": "vehicle-01"}, "http://south:8080"),
        ({"withdraw": "vehicle-00/meeting"}, MANAGER),
        ({"withdraw": "cloud-1/meeting"}, "http://south:8080"),
        (
            {"withdraw": "cloud-0/meeting", "manager": "south"},
            "http://south:8080",
        ),  # by name: that one, whatever it has
    ],
)
def test_the_manager_is_asked_whose_namespace_it_is(question: dict[str, Any], asked: str) -> None:
    anna = Somebody()
    assert anna.asks("/api/explain", question).status_code == 200
    [(url, _)] = anna.platform.questions
    assert url == f"{asked}/explain"


def test_a_task_is_submitted_as_the_person_with_one_listed_group_and_withdrawn_again() -> None:
    anna = Somebody("robotkube:operators")
    assert (anna.session["may_write"], anna.session["namespaces"]) == (True, ["cloud-0", "vehicle-00"])
    assert anna.session["why_not"] == ""
    answer = anna.asks("/api/tasks")
    key = answer.json()["task"]
    assert (answer.status_code, key.rpartition("-")[0]) == (201, "cloud-0/recording")
    task = anna.platform.tasks[key]
    assert (task["spec"]["requester"], task["spec"]["event"]["id"]) == ("anna", key.partition("/")[2])
    assert anna.withdraws(key).status_code == 204
    assert anna.platform.tasks == {}
    assert anna.platform.written == [("anna", "robotkube:console:robotkube")] * 2


def test_a_page_of_somebody_else_writes_nothing() -> None:
    anna = Somebody()
    for path in ("/api/tasks", "/api/explain"):
        assert refusal(anna.client.post(path, json=REQUEST))[0] == 403
        assert refusal(anna.asks(path, **{"X-CSRF-Token": "guessed"}))[0] == 403
    assert refusal(anna.client.request("DELETE", "/api/tasks/cloud-0/meeting"))[0] == 403
    form = anna.client.post("/api/tasks", data={"namespace": "cloud-0"}, headers=anna.headers)
    assert refusal(form) == (415, "Send the request as application/json.")
    assert (anna.platform.written, anna.platform.questions) == ([], [])


def test_without_a_session_nothing_is_written_or_asked() -> None:
    anna = Somebody()
    anna.client.cookies.clear()
    assert refusal(anna.asks("/api/tasks"))[0] == 401
    assert refusal(anna.asks("/api/explain"))[0] == 401
    assert refusal(anna.withdraws("cloud-0/meeting"))[0] == 401


def test_where_nobody_signs_in_questions_are_answered_and_nothing_is_written() -> None:
    stranger = Stranger()
    assert stranger.client.post("/api/explain", json=REQUEST).json() == EXPLANATION
    status, words = refusal(stranger.client.post("/api/tasks", json=REQUEST))
    assert (status, words.partition(",")[0]) == (403, "Nobody signs in here")
    assert refusal(stranger.client.request("DELETE", "/api/tasks/cloud-0/a"))[0] == 403
    session = stranger.client.get("/api/session").json()
    assert (session["may_write"], session["why_not"]) == (False, words)
    assert refusal(stranger.client.post("/api/explain", content="{}", headers={"Content-Type": "text/plain"}))[0] == 415
    assert stranger.platform.written == []


def test_without_a_group_that_may_write_one_reads_alone() -> None:
    anna = Somebody(writers=WRITERS[:1])
    assert (anna.session["may_read"], anna.session["may_write"], anna.session["namespaces"]) == (True, False, [])
    status, words = refusal(anna.asks("/api/tasks"))
    assert (status, words) == (403, anna.session["why_not"])
    assert "console.signIn.writers" in words
    assert refusal(Somebody(writers=()).asks("/api/tasks"))[0] == 403


def test_a_group_writes_in_its_own_namespaces_alone() -> None:
    anna = Somebody()
    status, words = refusal(anna.asks("/api/tasks", {**REQUEST, "namespace": "vehicle-01"}))
    assert (status, words.partition(".")[0]) == (403, "Your groups may ask for tasks in cloud-0, not in vehicle-01")
    assert refusal(anna.withdraws("vehicle-00/meeting"))[0] == 403
    assert anna.platform.written == []


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"namespace": "../robotkube"}, "namespace: '../robotkube' must match"),
        ({"namespace": None}, "namespace: missing"),
        ({"application": "a b"}, "application: 'a b' must match"),
        ({"parameters": []}, "parameters: must be a mapping"),
        ({"priority": 1001}, "priority: must be a whole number from 0 to 1000"),
        ({"priority": True}, "priority: must be a whole number from 0 to 1000"),
        ({"priority": 0.5}, "priority: must be a whole number from 0 to 1000"),
        ({"priority": None}, "priority: must be a whole number from 0 to 1000"),
        ({"reason": "two\nlines"}, "reason: must be one line of at most 200 characters"),
        ({"requester": "somebody else"}, "requester: unknown key"),
        ({"manager": "http://evil.example"}, "manager: 'http://evil.example' must match"),
        ({"manager": None}, "manager: missing"),
    ],
)
def test_a_request_of_another_form_is_refused_with_its_key(changed: dict[str, Any], problem: str) -> None:
    with pytest.raises(DocumentError, match=problem):
        read_request({**REQUEST, **changed})


def test_a_whole_number_may_be_written_as_json_has_it() -> None:
    assert read_request({**REQUEST, "priority": 7.0}).document("a", "anna", "now")["spec"]["priority"] == 7


def test_requests_that_cannot_be_read_are_refused() -> None:
    anna = Somebody()
    assert refusal(anna.asks("/api/tasks", [1]))[0] == 422
    assert refusal(anna.asks("/api/explain", {"withdraw": "x"}))[0] == 422
    assert refusal(anna.asks("/api/explain", {"withdraw": ["a/b"]}))[0] == 422
    for manager in (None, "", ["manager"]):
        assert refusal(anna.asks("/api/explain", {"withdraw": "cloud-0/meeting", "manager": manager})) == (
            422, "Give the name of a manager in `manager`, or leave it out.",
        )  # fmt: skip
    assert refusal(anna.asks("/api/explain", {**REQUEST, "manager": "north"})) == (
        422, "Name one of manager, south in `manager`, or none.",
    )  # fmt: skip
    assert refusal(anna.asks("/api/explain", {"withdraw": "edge-0/meeting"})) == (
        422, "No manager answers tasks in edge-0; there are: manager, south.",
    )  # fmt: skip
    assert anna.platform.questions == []
    kind = {**anna.headers, "Content-Type": "application/json"}
    assert refusal(anna.client.post("/api/tasks", content="{", headers=kind))[0] == 400
    large = anna.client.post("/api/tasks", content=b" " * (BODY_BYTES_MAX + 1), headers=kind)
    assert refusal(large) == (413, f"A request has at most {BODY_BYTES_MAX} bytes.")
    assert anna.platform.written == []


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (RefusalError("Forbidden", "the API server says no"), 403),
        (InputError("the API server says no"), 422),
        (UnavailableError("the API server says no"), 503),
    ],
)
def test_what_platform_says_is_said_in_its_words(error: Any, status: int) -> None:
    anna = Somebody()
    anna.platform.error = error
    for answer in (anna.asks("/api/tasks"), anna.asks("/api/explain"), anna.withdraws("cloud-0/meeting")):
        assert refusal(answer) == (status, "the API server says no")
        assert ("retry-after" in answer.headers) == (status == 503)


def test_a_name_that_is_taken_and_a_task_that_is_gone_are_said() -> None:
    anna = Somebody()
    anna.platform.names_are_taken = True
    assert refusal(anna.asks("/api/tasks"))[0] == 409
    assert refusal(anna.withdraws("cloud-0/meeting")) == (404, "There is no task cloud-0/meeting (any more).")
    assert refusal(anna.withdraws("cloud-0/No.Name!"))[0] == 404


def test_one_person_writes_and_asks_at_most_so_often() -> None:
    anna = Somebody()
    answers = [anna.asks("/api/tasks").status_code for _ in range(int(WRITES.burst) + 1)]
    assert answers == [201] * int(WRITES.burst) + [429]
    answers = [anna.asks("/api/explain").status_code for _ in range(int(QUESTIONS.burst) + 1)]
    assert answers == [200] * int(QUESTIONS.burst) + [429]


def test_groups_are_named_so_that_none_is_of_the_cluster() -> None:
    anna = Person("anna", ("system:masters", "robotkube"))
    listed = [Writers("system:masters", frozenset(["cloud-0"])), Writers("robotkube", frozenset(["vehicle-00"]))]
    assert group_for(anna, listed, "cloud-0") == "robotkube:console:system:masters"
    assert group_for(anna, listed, "vehicle-01") == ""
    assert group_for(Person("ben", ("others",)), listed, "cloud-0") == ""
    assert writable(anna, listed) == ("cloud-0", "vehicle-00")
