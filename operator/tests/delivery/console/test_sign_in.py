"""Signing in at a provider in this process: who may read, and what does not make a session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from robotkube.delivery.console.adapters.web.application import Console, ConsoleSurroundings
from robotkube.delivery.console.adapters.web.openid_connect import OpenIdConnect
from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.core.sessions import SESSION_SECONDS, SESSIONS_MAX, Sessions
from robotkube.delivery.console.core.signing_in import (
    LEEWAY_SECONDS,
    Person,
    SignIn,
    place_to_return,
    read_id_token,
    read_provider,
)
from robotkube.delivery.console.loops.model import ReadModel
from tests.delivery.console.people import PlatformInMemory
from tests.delivery.console.provider import CLIENT, ISSUER, NOW, AccountProvider, json_web_token
from tests.delivery.console.requests import Client

URL, SECRET = "https://console.example", "for tests"
SCOPES = ("openid", "groups", "read:user")
SETTINGS = SignIn(ISSUER, CLIENT, "", URL, frozenset(["robotkube"]), "preferred_username", "groups", SCOPES)
PAGES = "https://git.example"
BY_THE_FORGE = replace(SETTINGS, client_id="", pages=PAGES, by_id_token=True)


class Browser:
    """A browser in front of a console whose people come from `provider`, and whose client's id from `file`, if any."""

    def __init__(self, provider: AccountProvider, settings: SignIn = SETTINGS, file: Path | None = None) -> None:
        self.provider = provider
        people = People(settings, OpenIdConnect(settings, provider.client, file, lambda: float(NOW)))
        around = ConsoleSurroundings(["console.example"], settings.encrypted)
        self.console = Console(ReadModel("e", lambda: 7), people, PlatformInMemory().asking, around)
        self.client = Client(self.console.app, settings.url)

    def begin(self, back: str = "/") -> dict[str, str]:
        """Go to the provider and agree; what it sends back."""
        answer = self.client.get("/auth/login", params={"back": back})
        assert answer.status_code == 302
        return self.provider.consent(answer.headers["location"])

    def sign_in(self, back: str = "/") -> Any:
        """The whole way."""
        return self.client.get("/auth/callback", params=self.begin(back))

    @property
    def session(self) -> dict[str, Any]:
        document: dict[str, Any] = self.client.get("/api/session").json()
        return document


@pytest.fixture
def browser() -> Browser:
    return Browser(AccountProvider(preferred_username="anna", groups=["robotkube", "robotkube:Owners"]))


def test_without_a_session_nothing_is_read_and_it_is_said_where_to_sign_in(browser: Browser) -> None:
    for path in ("snapshot", "changes?after=e.0", "events?after=e.0", "why/task/a/b", "tasks", "agents", "catalogue"):
        answer = browser.client.get(f"/api/{path}")
        assert (answer.status_code, answer.json()["sign_in"]) == (401, "/auth/login"), path
        assert answer.headers["content-type"] == "application/problem+json"
    assert browser.session["may_read"] is False


def test_a_member_of_a_listed_group_reads(browser: Browser) -> None:
    answer = browser.sign_in(back="/why/task/a")
    assert (answer.status_code, answer.headers["location"]) == (303, "/why/task/a")
    assert browser.client.get("/api/snapshot").status_code == 200
    session = browser.session
    assert (session["user"], session["may_read"], session["may_write"]) == ("anna", True, False)


def test_a_token_may_do_what_was_asked_for_and_no_more(browser: Browser) -> None:
    """Gitea gives a token without scopes of its own every right of the person."""
    asked = parse_qs(urlsplit(browser.client.get("/auth/login").headers["location"]).query)
    assert asked["scope"] == [" ".join(SCOPES)]


def test_the_cookie_is_for_the_browser_alone_and_for_tls(browser: Browser) -> None:
    answer = browser.sign_in()
    [cookie] = [value for value in answer.headers.get_list("set-cookie") if value.startswith("__Host-console=")]
    assert {"HttpOnly", "Secure", "SameSite=lax", "Path=/"} <= set(cookie.split("; "))


def test_another_group_does_not_read_and_is_told_what_to_do() -> None:
    browser = Browser(AccountProvider(preferred_username="ben", groups=["others"]))
    browser.sign_in()
    answer = browser.client.get("/api/snapshot")
    assert answer.status_code == 403
    assert "console.signIn.groups" in answer.json()["detail"]
    assert browser.session["user"] == "ben"


@pytest.mark.parametrize("groups", ["robotkube", None, {"robotkube": True}, [["robotkube"]]])
def test_groups_of_another_form_are_none(groups: Any) -> None:
    browser = Browser(AccountProvider(preferred_username="ben", groups=groups))
    browser.sign_in()
    assert browser.client.get("/api/snapshot").status_code == 403


def test_a_sign_in_that_this_browser_did_not_begin_makes_no_session(browser: Browser) -> None:
    """Else somebody could sign another person in with his own account (login CSRF)."""
    brought = browser.begin()
    browser.client.cookies.clear()
    assert browser.client.get("/auth/callback", params=brought).status_code == 400
    assert browser.session["user"] is None


def test_a_state_of_another_sign_in_makes_no_session(browser: Browser) -> None:
    first = browser.begin()
    browser.begin()
    assert browser.client.get("/auth/callback", params=first).status_code == 400


def test_a_code_counts_once(browser: Browser) -> None:
    brought = browser.begin()
    assert browser.client.get("/auth/callback", params=brought).status_code == 303
    assert browser.client.get("/auth/callback", params=brought).status_code == 400


def test_a_code_that_was_stolen_is_of_no_use_without_its_verifier(browser: Browser) -> None:
    stolen = browser.begin()["code"]
    other = Browser(browser.provider)
    state = other.begin()["state"]
    assert other.client.get("/auth/callback", params={"code": stolen, "state": state}).status_code == 403


def test_a_client_with_a_secret_shows_it() -> None:
    provider = AccountProvider(preferred_username="anna", groups=["robotkube"])
    provider.secret = SECRET
    assert Browser(provider).sign_in().status_code == 403
    settings = SignIn(ISSUER, CLIENT, SECRET, URL, frozenset(["robotkube"]), "preferred_username", "groups", SCOPES)
    assert Browser(provider, settings).sign_in().status_code == 303


def test_who_says_no_at_the_provider_is_not_signed_in(browser: Browser) -> None:
    state = browser.begin()["state"]
    answer = browser.client.get("/auth/callback", params={"error": "access_denied", "state": state})
    assert (answer.status_code, answer.json()["detail"]) == (403, "The provider says: access_denied")


def test_a_provider_that_is_away_is_said_and_asked_again(browser: Browser) -> None:
    browser.provider.away = True
    answer = browser.client.get("/auth/login")
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "10")
    browser.provider.away = False
    assert browser.sign_in().status_code == 303


def test_signing_out_needs_the_word_of_the_session(browser: Browser) -> None:
    browser.sign_in()
    assert browser.client.post("/auth/logout").status_code == 403
    assert browser.client.post("/auth/logout", headers={"X-CSRF-Token": "x"}).status_code == 403
    assert browser.session["user"] == "anna"
    word = browser.session["csrf"]
    assert browser.client.post("/auth/logout", headers={"X-CSRF-Token": word}).status_code == 204
    assert browser.client.get("/api/snapshot").status_code == 401


def test_signing_in_is_asked_for_at_most_so_often(browser: Browser) -> None:
    answers = [browser.client.get("/auth/login").status_code for _ in range(25)]
    assert answers[:20] == [302] * 20
    assert answers[-1] == 429


@pytest.fixture
def client_id_file(tmp_path: Path) -> Path:
    """Brought by a kubelet."""
    file = tmp_path / "client_id"
    file.write_text(f"{CLIENT}\n")
    return file


@pytest.fixture
def forge() -> AccountProvider:
    """A provider that browsers reach elsewhere than the console does."""
    provider = AccountProvider(preferred_username="anna", groups=["robotkube"])
    provider.pages = PAGES
    return provider


def test_who_somebody_is_stands_in_the_id_token_and_no_other_token_is_used(
    forge: AccountProvider, client_id_file: Path
) -> None:
    browser = Browser(forge, BY_THE_FORGE, client_id_file)
    assert browser.sign_in().status_code == 303
    assert (browser.session["user"], browser.session["groups"], browser.session["may_read"]) == (
        "anna",
        ["robotkube"],
        True,
    )
    assert forge.userinfo_asked == 0


@pytest.mark.parametrize(
    ("claims", "reason"),
    [
        ({"iss": PAGES}, f"is of the issuer '{PAGES}' instead of {ISSUER}"),
        ({"aud": ["another"]}, f"is for ['another'] instead of the client {CLIENT} alone"),
        ({"aud": [CLIENT, "another"]}, f"is for ['{CLIENT}', 'another'] instead"),
        ({"exp": NOW - LEEWAY_SECONDS}, f"ended at {NOW - LEEWAY_SECONDS}, and it is {NOW}"),
        ({"exp": None}, "ended at None"),
        ({"exp": float("nan")}, "ended at nan"),
        ({"preferred_username": ""}, "has no claim preferred_username"),
    ],
)
def test_an_id_token_of_another_purpose_makes_no_session(
    forge: AccountProvider,
    client_id_file: Path,
    claims: dict[str, Any],
    reason: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    forge.id_token = claims
    browser = Browser(forge, BY_THE_FORGE, client_id_file)
    assert browser.sign_in().status_code == 403
    assert browser.session["user"] is None
    assert f"the ID token {reason}" in caplog.text


@pytest.mark.parametrize("text", ["", "a.b.c", "a.b", "e30", "e30.W10.x", "e30.eyJhIjox.x", "e30.e30", "e30.é.x"])
def test_what_is_no_token_is_said(text: str) -> None:
    with pytest.raises(ValueError, match="is no JSON Web Token"):
        read_id_token(text, ISSUER, CLIENT, NOW)


def test_a_token_for_this_client_alone_is_taken_in_either_form() -> None:
    claims = {"iss": f"{ISSUER}/", "aud": CLIENT, "exp": NOW, "groups": ["ä"]}
    assert read_id_token(json_web_token(claims), ISSUER, CLIENT, NOW) == claims


def test_before_the_client_is_registered_it_is_said_and_then_it_goes(
    forge: AccountProvider, client_id_file: Path
) -> None:
    client_id_file.write_text("")
    browser = Browser(forge, BY_THE_FORGE, client_id_file)
    for missing in (False, True):
        client_id_file.unlink() if missing else None
        answer = browser.client.get("/auth/login")
        assert (answer.status_code, answer.headers["retry-after"]) == (503, "10")
        assert f"{client_id_file} has no client id yet. The Job bootstrap registers" in answer.json()["detail"]
    client_id_file.write_text(CLIENT)
    assert browser.sign_in().status_code == 303


def test_a_provider_whose_pages_nobody_can_tell_is_refused() -> None:
    endpoints = {f"{name}_endpoint": f"https://elsewhere.example/{name}" for name in ("authorization", "token")}
    document = {"issuer": ISSUER, **endpoints, "userinfo_endpoint": f"{ISSUER}/userinfo"}
    assert read_provider(document, ISSUER).authorization == "https://elsewhere.example/authorization"
    with pytest.raises(ValueError, match=f"not below {ISSUER}: nobody knows how browsers reach it at {PAGES}"):
        read_provider(document, ISSUER, PAGES)
    beside = {**document, "authorization_endpoint": f"{ISSUER}.elsewhere.example/authorize"}
    with pytest.raises(ValueError, match="not below"):
        read_provider(beside, ISSUER, PAGES)


@pytest.mark.parametrize("path", ["//evil.example", "https://evil.example", "/\\evil.example", "/a\nb", "", "/" * 1001])
def test_nobody_is_sent_to_another_host_afterwards(path: str) -> None:
    assert place_to_return(path) == "/"


@pytest.mark.parametrize(
    ("document", "problem"),
    [
        ({"issuer": "https://other.example"}, "names the issuer"),
        ({"issuer": ISSUER, "token_endpoint": "file:///x"}, "has no authorization_endpoint, token_endpoint"),
    ],
)
def test_a_provider_that_says_nothing_that_helps(document: dict[str, str], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        read_provider(document, ISSUER)


def test_sessions_end_and_of_too_many_the_oldest_goes() -> None:
    now = 0.0
    words = iter(map(str, range(10**6)))
    sessions = Sessions(lambda: now, lambda: next(words))
    first = sessions.open(Person("anna"))
    now = SESSION_SECONDS - 1
    assert sessions.get(first) is not None
    now = SESSION_SECONDS
    assert sessions.get(first) is None
    second = sessions.open(Person("anna"))
    for _ in range(SESSIONS_MAX):
        sessions.open(Person("ben"))
    assert sessions.get(second) is None
