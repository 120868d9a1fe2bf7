"""Settings of the console: what is wrong is named with its key and what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.console.core.asking import Writers
from robotkube.delivery.console.settings import ConsoleConfiguration, read_configuration
from robotkube.errors import DocumentError
from robotkube.foundation.runtime.settings_file import read_settings

SIGN_IN = {"issuer": "https://forge.example", "client_id": "c", "url": "https://console.example", "groups": ["a"]}
BY_THE_FORGE = {
    **{key: value for key, value in SIGN_IN.items() if key != "client_id"},
    "client_id_file": "/etc/robotkube/sign-in/client_id",
    "pages": "https://git.example",
    "by_id_token": True,
}
LEAST: dict[str, Any] = {
    "listen": {"address": "127.0.0.1", "port": 0, "health_port": 0},
    "log_level": "info",
    "namespaces": {"platform": "robotkube", "argocd": "argocd"},
    "agents": [{"name": "cloud-0", "role": "cloud", "namespace": "cloud-0", "records": True}],
    "managers": [{"name": "manager", "url": "http://manager:8080"}],
    "hosts": ["localhost"],
    "anybody_reads": True,
}


def read(folder: Path, **changed: Any) -> ConsoleConfiguration:
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in {**LEAST, **changed}.items() if value is not None}))
    return read_settings(path, read_configuration)


def test_the_least(tmp_path: Path) -> None:
    settings = read(tmp_path)
    assert (settings.sign_in, settings.poses, settings.page) == (None, None, None)
    assert settings.agents[0]["records"] is True


def test_pages_of_gate_and_certificates(tmp_path: Path) -> None:
    assert read(tmp_path).gate == ""
    assert read(tmp_path, gate={"url": "https://gate:8080"}).gate == "https://gate:8080"
    assert read(tmp_path, certificates={"url": "http://certificates:8081"}).certificates == "http://certificates:8081"
    with pytest.raises(DocumentError, match=r"gate\.url"):
        read(tmp_path, gate={"url": "gate"})


def test_who_may_ask_for_tasks(tmp_path: Path) -> None:
    writers = [{"group": "robotkube:Owners", "namespaces": ["cloud-0"]}]
    settings = read(tmp_path, sign_in={**SIGN_IN, "writers": writers}, anybody_reads=None)
    assert settings.writers == (Writers("robotkube:Owners", frozenset(["cloud-0"])),)
    assert read(tmp_path).writers == ()


def test_signing_in(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("s3cret\n")
    given = {**SIGN_IN, "client_secret": str(tmp_path / "secret")}
    sign_in = read(tmp_path, sign_in=given, anybody_reads=None).sign_in
    assert sign_in is not None
    assert (sign_in.issuer, sign_in.client_secret, sign_in.encrypted) == ("https://forge.example", "s3cret", True)
    assert sign_in.redirect == "https://console.example/auth/callback"
    assert sign_in.scopes == ("openid", "profile", "groups", "read:user")
    asked = read(tmp_path, sign_in={**given, "scopes": ["openid"]}, anybody_reads=None).sign_in
    assert asked is not None
    assert asked.scopes == ("openid",)


def test_signing_in_by_a_client_that_is_registered_later(tmp_path: Path) -> None:
    settings = read(tmp_path, sign_in=BY_THE_FORGE, anybody_reads=None)
    assert settings.client_id_file == Path("/etc/robotkube/sign-in/client_id")
    assert settings.sign_in is not None
    assert (settings.sign_in.client_id, settings.sign_in.pages, settings.sign_in.by_id_token) == (
        "",
        "https://git.example",
        True,
    )
    assert settings.who_signs_in() == "by the provider, once /etc/robotkube/sign-in/client_id is there"
    brought = tmp_path / "client_id"
    brought.write_text("c")
    there = read(tmp_path, sign_in={**BY_THE_FORGE, "client_id_file": str(brought)}, anybody_reads=None)
    other = read(tmp_path, sign_in=SIGN_IN, anybody_reads=None)
    assert there.who_signs_in() == other.who_signs_in() == "by the provider"
    assert read(tmp_path).who_signs_in() == "nobody: everybody who reaches it reads"
    forwarded = read(tmp_path, anybody_reads=None, by_forward=True)
    assert forwarded.who_signs_in() == "nobody: who may forward ports to its pod reads"
    assert (other.client_id_file, other.sign_in and other.sign_in.by_id_token) == (None, False)


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        (
            {"anybody_reads": None},
            r"sign_in: missing; or say that everybody who reaches it reads \(anybody_reads: true",
        ),
        ({"by_forward": True}, "by_forward: is true, and anybody_reads says that others read; take out one"),
        ({"by_forward": True, "anybody_reads": None, "sign_in": SIGN_IN}, "by_forward: is true, and sign_in says"),
        ({"by_forward": "yes"}, "by_forward: 'yes' must be true or false"),
        ({"anybody_reads": False}, "sign_in: missing"),
        ({"sign_in": {**SIGN_IN, "groups": []}}, r"sign_in\.groups: must name one group or more"),
        ({"sign_in": {**SIGN_IN, "issuer": "forge"}}, r"sign_in\.issuer: 'forge' must match"),
        ({"sign_in": {**SIGN_IN, "client_id_file": "/a/b"}}, "sign_in: needs one of client_id and client_id_file, the"),
        ({"sign_in": {**SIGN_IN, "client_id": None}}, "sign_in: needs one of client_id and client_id_file"),
        ({"sign_in": {**BY_THE_FORGE, "client_id_file": "b"}}, r"sign_in\.client_id_file: 'b' must match"),
        ({"sign_in": {**BY_THE_FORGE, "pages": "git"}}, r"sign_in\.pages: 'git' must match"),
        ({"sign_in": {**BY_THE_FORGE, "by_id_token": "yes"}}, r"sign_in\.by_id_token: must be true or false"),
        ({"sign_in": {**SIGN_IN, "scopes": ["a b"]}}, r"sign_in\.scopes\[0\]: 'a b' must match"),
        (
            {"sign_in": {**SIGN_IN, "writers": [{"group": " a", "namespaces": ["B"]}]}},
            r"sign_in\.writers\[0\]\.group: ' a' must match",
        ),
        ({"sign_in": {**SIGN_IN, "writers": [{"group": "a"}]}}, r"sign_in\.writers\[0\]\.namespaces: missing"),
        ({"poses": {"topic": "mqtt/pose"}}, r"poses\.topic: must have \{agent\} as one of its levels"),
        ({"managers": [{"name": "m"}]}, r"managers\[0\]\.url: missing"),
        (
            {"managers": [{"name": "m", "url": "http://m:8080", "namespaces": ["A b"]}]},
            r"managers\[0\]\.namespaces\[0\]: 'A b' must match",
        ),
        ({"agents": [{"name": "A b"}]}, r"agents\[0\]\.name: 'A b' must match"),
        ({"hosts": ["a/b"]}, r"hosts\[0\]: 'a/b' must match"),
        ({"proxies": ["ingress"]}, r"proxies\[0\]: 'ingress' must match"),
        ({"colour": "red"}, "colour: unknown key; remove it"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, changed: dict[str, Any], problem: str) -> None:
    with pytest.raises(DocumentError, match=problem):
        read(tmp_path, **changed)


def test_whom_it_believes_of_managers_and_of_the_provider(tmp_path: Path) -> None:
    ours, theirs = "/etc/robotkube/authorities/ca.crt", "/etc/ssl/theirs.crt"
    both = read(tmp_path, authorities=ours, sign_in={**SIGN_IN, "authorities": theirs}, anybody_reads=None)
    assert both.authorities == (Path(ours), Path(theirs))
    assert read(tmp_path, authorities=ours).authorities == (Path(ours),)
    assert read(tmp_path).authorities == ()
    with pytest.raises(DocumentError, match=r"authorities: .ca\.crt. must match"):
        read(tmp_path, authorities="ca.crt")
