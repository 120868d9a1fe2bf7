"""Every operation of docs/reference/console-api.yaml, tried with what Schemathesis makes of that document, both what it
allows and what it does not: answers are as the document says, whoever asks and whatever is away."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
import schemathesis
from hypothesis import core, given
from hypothesis import strategies as st
from hypothesis.vendor import pretty
from schemathesis.core.result import Ok
from schemathesis.generation import hypothesis as generation
from schemathesis.specs.openapi import checks
from starlette.types import ASGIApp, Receive, Scope, Send

from robotkube.delivery.console.adapters.web import guarding, streams
from robotkube.delivery.console.adapters.web.application import Console, ConsoleSurroundings
from robotkube.delivery.console.adapters.web.openid_connect import OpenIdConnect
from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.core.rate_limits import RequestRate
from robotkube.errors import InputError, RefusalError, RobotKubeError, UnavailableError
from tests.delivery.console import documents
from tests.delivery.console.people import PlatformInMemory
from tests.delivery.console.provider import AccountProvider
from tests.delivery.console.requests import Client
from tests.delivery.console.test_asking import REQUEST, WRITERS
from tests.delivery.console.test_sign_in import SETTINGS, URL
from tests.delivery.console.test_web import CONTRACT, filled

# Schemathesis would change Hypothesis for all random tests of this process: they would not say which example fails.
generation.setup._is_patched = True  # type: ignore[attr-defined]

ALLOWED = schemathesis.GenerationMode.POSITIVE
FORBIDDEN = schemathesis.GenerationMode.NEGATIVE
Operation = schemathesis.APIOperation[Any, Any, Any, Any]
# The stream of events has no end: two of them are read, the heartbeat that it begins with, and what is told after it.
CONFIG = schemathesis.Config.from_dict({"max-stream-events": 2})
DOCUMENT = schemathesis.openapi.from_dict(CONTRACT, config=CONFIG)
OPERATIONS = [result.ok() for result in DOCUMENT.get_all_operations() if isinstance(result, Ok)]
BY_NAME = {operation.definition.raw["operationId"]: operation for operation in OPERATIONS}
WITH_INPUT = [operation for operation in OPERATIONS if operation.body or operation.query or operation.path_parameters]
AS_DOCUMENTED = [
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_headers_conformance,
    checks.response_schema_conformance,
    checks.negative_data_rejection,
    checks.unsupported_method,
]
FITTING: Mapping[str, Mapping[str, Any]] = {
    "changes": {"query": {"after": "e.1"}},
    "events": {"query": {"after": "e.1"}},
    "why": {"path_parameters": {"kind": "task", "id": documents.TASK}},
    "layout": {"path_parameters": {"agent": "cloud-0", "recording": "encounter-1"}},
    "submit": {"body": REQUEST},
    "withdraw": {"path_parameters": {"namespace": "cloud-0", "name": "meeting"}},
    "explain": {"body": REQUEST},
}
"""By operation: input that finds something, or makes something."""
FOR_ITS_FORM = (400, 415, 422)
NOTHING_OF_THIS_NAME = {"No such manager", "Nobody answers there", "Sign-in was not begun here"}
UNPRINTABLE = "reason: must be one line"
"""Why input that the document allows may be refused with one of these: it names what is not there, or has characters
for which JSON Schema has no pattern."""
SUCCESSES = {"login": 302, "logout": 204, "submit": 201, "withdraw": 204}
"""By operation: the status of an answer that is not 200."""


@dataclass(frozen=True)
class Circumstances:
    """Who asks: a `member` of a group that reads, of one that asks for tasks, too (`writer`), somebody who is not
    signed in (`nobody`), or anybody, where there is no sign-in (`everybody`). And what is not as it should be."""

    who: str = "writer"
    error: RobotKubeError | None = None
    names_are_taken: bool = False
    provider_is_away: bool = False


ADVERSE = [
    *(Circumstances(who) for who in ("member", "nobody", "everybody")),
    *(
        Circumstances(error=error)
        for error in (RefusalError("Forbidden", "no"), InputError("no"), UnavailableError("no"))
    ),
    Circumstances(names_are_taken=True),
    Circumstances("nobody", provider_is_away=True),
]


class Person:
    """Who asks, before a console where people sign in unless `who` is everybody; signed in already, if he ever is."""

    def __init__(self, who: str) -> None:
        self.provider = AccountProvider(preferred_username="anna", groups=["robotkube"])
        signing_in = None if who == "everybody" else SETTINGS
        writers = WRITERS if who == "writer" else ()
        self.people = People(signing_in, OpenIdConnect(SETTINGS, self.provider.client), writers)
        self.headers: dict[str, str] = {}
        self.client = Client(self.console(PlatformInMemory()), URL)
        if who in ("writer", "member"):
            assert self.sign_in().status_code == 303
            self.headers = {"X-CSRF-Token": self.client.get("/api/session").json()["csrf"]}

    def sign_in(self) -> httpx.Response:
        """Go to the provider and come back."""
        begun = self.client.get("/auth/login")
        return self.client.get("/auth/callback", params=self.provider.consent(begun.headers["location"]))

    def console(self, platform: PlatformInMemory) -> ASGIApp:
        """A console that knows him, and has answered nothing yet."""
        around = ConsoleSurroundings(["console.example"], SETTINGS.encrypted)
        return Console(filled(), self.people, platform.asking, around).app


class Tried:
    """The console of the circumstances, a new one for each request, so that none waits for another; one application
    for all of them, as Schemathesis keeps each that it has asked."""

    def __init__(self) -> None:
        self._people: dict[str, Person] = {}
        self._console: ASGIApp | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass requests on."""
        if scope["type"] == "http" and self._console is not None:
            await self._console(scope, receive, send)

    def ask(
        self, case: schemathesis.Case[Any], circumstances: Circumstances, headers: Mapping[str, str] | None = None
    ) -> schemathesis.Response:
        """The answer to a request."""
        person = self._people.pop(circumstances.who, None) or Person(circumstances.who)
        if not case.path.startswith("/auth/"):  # which changes sessions
            self._people[circumstances.who] = person
        platform = PlatformInMemory()
        platform.tasks["cloud-0/meeting"] = {}
        platform.error = circumstances.error
        platform.names_are_taken = circumstances.names_are_taken
        person.provider.away = circumstances.provider_is_away
        self._console = person.console(platform)
        given_headers = {**person.headers, **(headers or {})}
        return case.call(URL, app=self, cookies=dict(person.client.cookies), headers=given_headers)


TRIED = Tried()


@pytest.fixture(scope="module", autouse=True)
def _beating_at_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streams, "HEARTBEAT_SECONDS", 0.01)
        yield


def assert_as_documented(case: schemathesis.Case[Any], circumstances: Circumstances) -> None:
    answer = TRIED.ask(case, circumstances)
    case.validate_response(answer, checks=AS_DOCUMENTED)
    said = f"{circumstances}: {case.as_curl_command()}\n{answer.status_code} {answer.text}"
    if answer.status_code >= 500:
        assert answer.status_code == 503, said
        assert circumstances.error or circumstances.provider_is_away, said
    allowed = case.meta is not None and case.meta.generation.mode is ALLOWED
    if allowed and answer.status_code in FOR_ITS_FORM and not circumstances.error:
        problem = answer.json()
        assert problem["title"] in NOTHING_OF_THIS_NAME or UNPRINTABLE in problem["detail"], said


def words(value: Any) -> str:
    return str(getattr(value, "label", getattr(value, "value", value)))


@pytest.mark.parametrize(
    ("operation", "mode"),
    [*((operation, ALLOWED) for operation in OPERATIONS), *((operation, FORBIDDEN) for operation in WITH_INPUT)],
    ids=words,
)
@given(data=st.data(), circumstances=st.just(Circumstances()) | st.sampled_from(ADVERSE))
def test_answers_are_as_the_document_says(
    operation: Operation, mode: schemathesis.GenerationMode, data: st.DataObject, circumstances: Circumstances
) -> None:
    assert_as_documented(data.draw(operation.as_strategy(mode)), circumstances)


@pytest.mark.parametrize("operation", OPERATIONS, ids=words)
def test_answers_at_the_edges_of_what_the_document_allows(operation: Operation) -> None:
    """Input that just fits and input that just does not, in one way each, and methods that an address does not have."""
    config = DOCUMENT.config.generation_for(operation=operation)
    modes = [ALLOWED, FORBIDDEN]
    for case in DOCUMENT.iter_coverage_cases(operation, generation_modes=modes, generation_config=config):
        assert_as_documented(case, Circumstances())


@pytest.mark.parametrize("name", [name for name in BY_NAME if name != "callback"])
def test_what_each_operation_is_for_is_as_the_document_says(name: str) -> None:
    case = BY_NAME[name].Case(**FITTING.get(name, {}))
    answer = TRIED.ask(case, Circumstances())
    case.validate_response(answer, checks=AS_DOCUMENTED)
    assert answer.status_code == SUCCESSES.get(name, 200)


@pytest.mark.parametrize("circumstances", ADVERSE, ids=repr)
def test_what_each_operation_answers_where_it_cannot_is_as_the_document_says(circumstances: Circumstances) -> None:
    for name, operation in BY_NAME.items():
        case = operation.Case(**FITTING.get(name, {}))
        answer = TRIED.ask(case, circumstances)
        case.validate_response(answer, checks=AS_DOCUMENTED)


@pytest.mark.parametrize("path", CONTRACT["paths"])
def test_an_address_says_which_methods_it_has(path: str) -> None:
    documented = {method.upper() for method in CONTRACT["paths"][path]}
    answer = Person("everybody").client.request("PUT", re.sub(r"{\w+}", "a", path))
    assert (answer.status_code, answer.headers["content-type"]) == (405, "application/problem+json")
    assert set(answer.headers["allow"].split(", ")) - {"HEAD"} == documented


def test_the_document_is_read_whole() -> None:
    documented = [answers["operationId"] for path in CONTRACT["paths"].values() for answers in path.values()]
    assert list(BY_NAME) == documented


def test_other_random_tests_say_which_example_fails() -> None:
    OPERATIONS[0].as_strategy()
    assert core.RepresentationPrinter is pretty.RepresentationPrinter  # type: ignore[attr-defined]


def test_the_end_of_signing_in_is_as_the_document_says() -> None:
    answer = Person("nobody").sign_in()
    BY_NAME["callback"].Case().validate_response(answer, checks=AS_DOCUMENTED)
    assert answer.status_code == 303


@pytest.mark.parametrize("operation", OPERATIONS, ids=words)
def test_what_stands_before_each_operation_refuses_as_the_document_says(
    operation: Operation, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = operation.Case(path_parameters=dict.fromkeys(("kind", "id", "agent", "recording", "namespace", "name"), "a"))
    foreign = TRIED.ask(case, Circumstances(), {"Host": "evil.example"})
    case.validate_response(foreign, checks=AS_DOCUMENTED)
    for rate in ("REQUESTS", "SIGN_INS"):
        monkeypatch.setattr(guarding, rate, RequestRate(burst=0, per_second=1))
    hasty = TRIED.ask(case, Circumstances("everybody"))
    case.validate_response(hasty, checks=AS_DOCUMENTED)
    assert (foreign.status_code, hasty.status_code) == (421, 429)
