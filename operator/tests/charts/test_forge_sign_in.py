"""Signing in at the console by the chart's own forge: the rendered settings of forge, bootstrap and console, a real
Gitea with TLS, and the pages that a browser goes through. `localhost` stands for the name of the forge's Service,
127.0.0.1 for the address at which people see it."""

from __future__ import annotations

import asyncio
import base64
import json
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest

from ci import console
from ci.folders import PROJECT
from robotkube.delivery.console import settings as console_settings
from robotkube.delivery.console.adapters.web.application import Console, ConsoleSurroundings
from robotkube.delivery.console.adapters.web.openid_connect import OpenIdConnect, authorization_url
from robotkube.delivery.console.adapters.web.page_files import read_files
from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.adapters.web.server import AsgiServer
from robotkube.delivery.console.core.signing_in import SignIn
from robotkube.delivery.console.loops.model import ReadModel
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters import certificate_authorities
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.setup import bootstrap
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap
from tests.delivery.console.people import PlatformInMemory
from tests.delivery.console.requests import Client
from tests.stages.forge.encrypted_forge import PLATFORM, EncryptedForge
from tests.stages.programs import free_port
from tests.stages.settings_mounted import mounted
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

EMBEDDED = (PLATFORM / "values-embedded.yaml", Path(__file__).parent / "profiles" / "embedded.yaml")
SERVICE = "forge.robotkube.svc.cluster.local:3000"
URL = "https://console.example"
PICTURES = PROJECT / "build" / "console" / "sign-in"
HIDDEN = re.compile(r'<input type="hidden" name="(\w+)" value="([^"]*)">')
WAYS_IN = (
    *("/api/v1/user", "/api/v1/repos/robotkube/deployment", "/login/oauth/userinfo", "/v2/"),
    *(f"/robotkube/deployment.git/info/refs?service=git-{service}-pack" for service in ("upload", "receive")),
)
VERIFIER, ANOTHER = "a verifier of forty-three characters or more", "another verifier of that many characters or so"


class BroughtClientIds:
    """The port ClientIds, with the kubelet that brings the ConfigMap: a file below `folder`."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "client_id"

    def publish(self, namespace: str, config_map: str, client_id: str) -> bool:
        assert (namespace, config_map) == ("robotkube", "console-sign-in")
        if self.file.exists() and self.file.read_text() == client_id:
            return False
        self.file.parent.mkdir(exist_ok=True)
        self.file.write_text(client_id)
        return True


@dataclass
class Stage:
    """The forge, what bootstrap makes there, and the settings of the console."""

    forge: EncryptedForge
    administration: GiteaAdministration
    configuration: bootstrap.ForgeConfiguration
    console: console_settings.ConsoleConfiguration
    client_ids: BroughtClientIds

    @property
    def sign_in(self) -> SignIn:
        assert self.console.sign_in is not None
        return self.console.sign_in

    @property
    def provider(self) -> OpenIdConnect:
        """The forge as the console asks it."""
        return OpenIdConnect(self.sign_in, client_id_file=self.console.client_id_file)

    def account(self, name: str) -> tuple[str, str]:
        [match] = [one for one in self.configuration.setup.accounts if one.name == name]
        return match.name, match.password

    def register(self, url: str = URL) -> list[str]:
        """Have the client registered, with the console at this address; what changed."""
        [client] = self.configuration.clients
        run = Bootstrap(60, time.monotonic, time.sleep)
        run.sign_in([replace(client, redirect=f"{url}/auth/callback")], self.administration, self.client_ids)
        return run.changed

    def applications(self) -> list[dict[str, Any]]:
        """The forge's OAuth2 applications of the administrator."""
        with self.http() as browser:
            answer = browser.get("/api/v1/user/applications/oauth2", auth=self.forge.administrator())
        return list(answer.raise_for_status().json())

    def http(self) -> httpx.Client:
        """A browser's connection to the forge, at the address at which people see it."""
        return httpx.Client(
            base_url=f"https://127.0.0.1:{self.forge.port}", verify=certificate_authorities.certificate_authorities()
        )


class Browser:
    """A person's browser: the console on one side, the forge's pages on the other."""

    def __init__(self, stage: Stage, account: str) -> None:
        self._stage = stage
        self._account = stage.account(account)
        people = People(stage.sign_in, stage.provider, stage.console.writers)
        around = ConsoleSurroundings(stage.console.hosts, stage.sign_in.encrypted)
        self.console = Client(
            Console(ReadModel("e", lambda: 7), people, PlatformInMemory().asking, around).app, stage.sign_in.url
        )

    def agree(self, location: str, granted: str = "true") -> dict[str, str]:
        """Sign in at the forge, and answer what it asks; what it sends back to the console."""
        assert location.startswith(f"https://127.0.0.1:{self._stage.forge.port}/login/oauth/authorize?")
        with self._stage.http() as forge:
            to_login = forge.get(location)
            assert (to_login.status_code, urlsplit(to_login.headers["location"]).path) == (303, "/user/login")
            name, password = self._account
            entered = forge.post(to_login.headers["location"], data={"user_name": name, "password": password})
            assert entered.status_code == 303
            asking = forge.get(entered.headers["location"])
            assert asking.status_code == 200, asking.text
            form = dict(HIDDEN.findall(asking.text))
            answered = forge.post("/login/oauth/grant", data={**form, "granted": granted})
        assert answered.status_code == 303
        back, _, query = answered.headers["location"].partition("?")
        assert back == f"{URL}/auth/callback"
        return {name: values[0] for name, values in parse_qs(query).items()}

    def refusal(self, location: str) -> httpx.Response:
        """What the forge answers at this address, once the person is signed in there."""
        with self._stage.http() as forge:
            name, password = self._account
            forge.post("/user/login", data={"user_name": name, "password": password})
            return forge.get(location)

    def sign_in(self) -> httpx.Response:
        """The whole way."""
        begun = self.console.get("/auth/login")
        assert begun.status_code == 302, begun.text
        return self.console.get("/auth/callback", params=self.agree(begun.headers["location"]))

    @property
    def session(self) -> dict[str, Any]:
        document: dict[str, Any] = self.console.get("/api/session").json()
        return document


def render(helm: Any, port: int) -> Any:
    """The embedded platform, with sign-in by its forge."""
    sign_in = {"forge": True, "url": URL}
    values = {"anybodyReads": False, "links": {"forge": f"https://127.0.0.1:{port}"}, "signIn": sign_in}
    return helm.template(PLATFORM, *EMBEDDED, console=values)


@pytest.fixture(scope="module")
def stage(helm: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    port = free_port()
    folder = tmp_path_factory.mktemp("files")
    rendered = render(helm, port)
    forge = EncryptedForge(tmp_path_factory.mktemp("forge") / "pod", rendered, port)
    file = mounted(rendered, "console", folder / "console")
    text = file.read_text().replace(SERVICE, f"localhost:{port}")
    file.write_text(text.replace("/etc/robotkube/sign-in", str(folder / "sign-in")))
    console = read_settings(file, console_settings.read_configuration)
    configuration = read_settings(
        mounted(rendered, "bootstrap", folder / "bootstrap"), bootstrap.read_configuration
    ).forge
    assert configuration is not None
    with pytest.MonkeyPatch.context() as patching:
        patching.setattr(certificate_authorities, "_trusted", {})
        try:
            forge.start()
            certificate_authorities.trust(forge.folder / "ca.crt")
            administration = GiteaAdministration(forge.url, *forge.administrator())
            Bootstrap(60, time.monotonic, time.sleep).forge(configuration.setup, administration)
            made = Stage(forge, administration, configuration, console, BroughtClientIds(folder / "sign-in"))
            made.register()
            yield made
            administration.disconnect()
        finally:
            forge.stop()


def token(stage: Stage, account: str = "operator-team") -> dict[str, Any]:
    """What the forge gives the console for a person's code."""
    code = Browser(stage, account).agree(asked(stage))["code"]
    form = {"grant_type": "authorization_code", "code": code, "redirect_uri": stage.sign_in.redirect}
    form |= {"client_id": stage.provider.client_id(), "code_verifier": VERIFIER}
    with stage.http() as console:
        answer = console.post("/login/oauth/access_token", data=form)
    return dict(answer.raise_for_status().json())


def asked(stage: Stage, verifier: str = VERIFIER) -> str:
    """The address to which the console sends a browser."""
    provider = stage.provider
    addresses = asyncio.run(provider.provider())
    return authorization_url(addresses, stage.sign_in, provider.client_id(), "state", verifier)


def test_a_person_of_the_forge_signs_in_and_reads(stage: Stage) -> None:
    browser = Browser(stage, "operator-team")
    assert browser.console.get("/api/snapshot").status_code == 401
    assert browser.sign_in().status_code == 303
    session = browser.session
    assert (session["user"], session["may_read"], session["may_write"]) == ("operator-team", True, False)
    assert {"robotkube", "robotkube:deployment-write"} <= set(session["groups"])
    assert browser.console.get("/api/snapshot").status_code == 200
    assert browser.sign_in().status_code == 303  # agreed to anew, since nobody else may show this client's id


@pytest.mark.parametrize("account", ["inspector", "viewer", "publisher"])
def test_who_may_not_propose_what_runs_is_known_and_reads_nothing(stage: Stage, account: str) -> None:
    browser = Browser(stage, account)
    assert browser.sign_in().status_code == 303
    assert (browser.session["user"], browser.session["may_read"]) == (account, False)
    answer = browser.console.get("/api/snapshot")
    assert (answer.status_code, answer.json()["title"]) == (403, "Not in a listed group")


def test_who_says_no_to_the_forge_is_not_signed_in(stage: Stage) -> None:
    browser = Browser(stage, "reviewer")
    brought = browser.agree(browser.console.get("/auth/login").headers["location"], granted="false")
    answer = browser.console.get("/auth/callback", params=brought)
    assert (answer.status_code, answer.json()["detail"]) == (403, "The provider says: the request is denied")


def test_the_client_is_registered_once(stage: Stage) -> None:
    assert stage.register() == []
    [application] = stage.applications()
    assert application["client_id"] == stage.client_ids.file.read_text()
    shown = {key: application[key] for key in ("name", "redirect_uris", "confidential_client")}
    assert shown == {
        "name": "robotkube-console",
        "redirect_uris": [f"{URL}/auth/callback"],
        "confidential_client": False,
    }


def test_another_address_of_the_console_is_the_same_client(stage: Stage) -> None:
    [before] = stage.applications()
    assert stage.register("https://elsewhere.example") == ["client robotkube-console"]
    [moved] = stage.applications()
    assert (moved["client_id"], moved["redirect_uris"]) == (
        before["client_id"],
        ["https://elsewhere.example/auth/callback"],
    )
    refused = Browser(stage, "operator-team").refusal(asked(stage))
    assert (refused.status_code, "Unregistered Redirect URI" in refused.text) == (400, True)
    assert stage.register() == ["client robotkube-console"]


def test_an_id_that_was_lost_is_written_again(stage: Stage) -> None:
    """As after an uninstallation, which takes the ConfigMap away, and not the forge's volume."""
    former = stage.client_ids.file.read_text()
    stage.client_ids.file.unlink()
    answer = Browser(stage, "operator-team").console.get("/auth/login")
    assert (answer.status_code, "The Job bootstrap registers the console" in answer.json()["detail"]) == (503, True)
    assert stage.register() == ["client id in robotkube/console-sign-in"]
    assert stage.client_ids.file.read_text() == former


def test_a_code_without_its_verifier_is_of_no_use(stage: Stage) -> None:
    code = Browser(stage, "operator-team").agree(asked(stage))["code"]
    with pytest.raises(InputError, match="failed PKCE code challenge"):
        asyncio.run(stage.provider.person(code, ANOTHER))
    assert asyncio.run(stage.provider.person(code, VERIFIER)).name == "operator-team"
    with pytest.raises(InputError, match="unauthorized_client"):
        asyncio.run(stage.provider.person(code, VERIFIER))


def test_without_a_challenge_nobody_signs_in(stage: Stage) -> None:
    location = re.sub(r"&code_challenge[^&]*", "", asked(stage))
    refused = Browser(stage, "operator-team").refusal(location)
    assert parse_qs(urlsplit(refused.headers["location"]).query)["error_description"] == [
        "PKCE is required for public clients"
    ]


def test_the_console_gets_nothing_that_it_could_act_with(stage: Stage) -> None:
    """Gitea takes an OAuth2 token by Basic authentication, and for Git, for whatever the person may: scopes or not."""
    given = token(stage)
    for name, kind in product(("access_token", "refresh_token", "id_token"), ("Basic", "Bearer")):
        shown = base64.b64encode(f"operator-team:{given[name]}".encode()).decode() if kind == "Basic" else given[name]
        with stage.http() as console:
            console.headers["Authorization"] = f"{kind} {shown}"
            answers = {path: console.get(path).status_code for path in WAYS_IN}
        assert answers == dict.fromkeys(WAYS_IN, 401), (name, kind)
    refresh = {"grant_type": "refresh_token", "refresh_token": given["refresh_token"]}
    with stage.http() as console:
        again = console.post("/login/oauth/access_token", data={**refresh, "client_id": stage.provider.client_id()})
    assert again.json() == {"error": "unauthorized_client", "error_description": "unable to parse refresh token"}


def test_those_ways_are_open_to_who_may(stage: Stage) -> None:
    """Else the test above would say nothing."""
    with stage.http() as person:
        person.auth = stage.account("operator-team")
        answers = {path: person.get(path).status_code for path in WAYS_IN}
    assert answers == {**dict.fromkeys(WAYS_IN, 200), "/login/oauth/userinfo": 401}  # that one takes tokens alone


def header(jwt: str) -> dict[str, str]:
    """The header of a token, which says by which key it is signed."""
    first = jwt.partition(".")[0]
    return dict(json.loads(base64.urlsafe_b64decode(first + "=" * (-len(first) % 4))))


def test_tokens_are_signed_by_a_key_of_the_forges_own_that_stays(stage: Stage) -> None:
    key = stage.forge.folder / "data" / "data" / "jwt" / "private.pem"
    assert key.stat().st_mode & 0o777 == 0o600
    before = header(token(stage)["access_token"])
    assert before["alg"] == "ES256"
    until(stage.forge.renewed(), "another process of the forge")
    assert header(token(stage)["access_token"]) == before


def test_the_forge_offers_no_other_clients(stage: Stage) -> None:
    """Gitea's own ones send codes to any port of a person's machine."""
    git_credential_oauth = "a4792ccc-144e-407e-86c9-5e7d8d9c3269"
    location = asked(stage).replace(stage.provider.client_id(), git_credential_oauth)
    assert "Client ID not registered" in Browser(stage, "operator-team").refusal(location).text


def test_another_issuer_than_the_forge_says_is_refused(stage: Stage) -> None:
    """The same server by another name that is in its certificate: what it names are not its addresses."""
    other = replace(stage.sign_in, issuer=f"https://127.0.0.1:{stage.forge.port}")
    with pytest.raises(UnavailableError, match=r"names the issuer 'https://localhost:\d+' instead of https://127"):
        asyncio.run(OpenIdConnect(other).provider())


def test_a_forge_of_another_authority_is_told_no_code(stage: Stage) -> None:
    code = Browser(stage, "operator-team").agree(asked(stage))["code"]
    before = stage.forge.shown()
    stage.forge.show(3600, authority=new_authority("another", time.time()))
    until(lambda: stage.forge.shows_another_than(before), "the certificate of another authority")
    with pytest.raises(UnavailableError, match=r"its certificate is of an authority that .* does not have"):
        asyncio.run(stage.provider.person(code, VERIFIER))
    until(stage.forge.renewed(), "the renewed certificate")


@pytest.fixture
def served(stage: Stage) -> Iterator[str]:
    """The console with its page, for a browser of this machine; its address, by which the client is registered."""
    port = free_port()
    sign_in = replace(stage.sign_in, url=f"http://localhost:{port}")
    people = People(sign_in, OpenIdConnect(sign_in, client_id_file=stage.console.client_id_file), stage.console.writers)
    around = ConsoleSurroundings(["localhost"], files=read_files(console.build()))
    model = ReadModel("e", lambda: time.time_ns() // 1_000_000)
    running = Console(model, people, PlatformInMemory().asking, around)
    server = AsgiServer(running.app, "127.0.0.1", port)
    stage.register(sign_in.url)
    server.start()
    yield f"{sign_in.url}/"
    running.streams.stop()
    server.stop()
    stage.register()


@pytest.mark.thorough
@pytest.mark.parametrize("granted", ["true", "false"])
def test_a_person_signs_in_in_a_browser(stage: Stage, served: str, granted: str) -> None:
    """Through the forge's own pages, to what the console shows, and out again; or says no to the forge."""
    said = console.browse("sign_in", served, *stage.account("operator-team"), granted, str(PICTURES / granted))
    wanted = {"true": "operator-team signed in, read, and signed out", "false": "not signed in, as it should be"}
    assert said == f"{wanted[granted]}\n"
