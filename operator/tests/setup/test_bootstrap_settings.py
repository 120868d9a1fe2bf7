"""Settings of the bootstrap Job: which Deployments read the hooks' secrets."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import WORD
from robotkube.foundation.runtime.settings_file import read_settings, warn_of_former_keys
from robotkube.setup.bootstrap import FORMER_KEYS, read_configuration
from robotkube.setup.loops.bootstrap import SignInClient


def settings_file(folder: Path, **argocd: Any) -> Path:
    for name, text in {"username": "manager", "password": "any", "secret": "any"}.items():
        (folder / name).write_text(text)
    account = {"name": "manager", "credentials": str(folder)}
    wiring = {"namespace": "argocd", "account": account, "rbac": "p, role:x\n", "closed_project": "default", **argocd}
    wiring["hook"] = {"secret": str(folder / "secret")}
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump({"log_level": "info", "wait_seconds": 1, "argocd": wiring}))
    return path


@pytest.mark.parametrize(
    ("written", "readers"),
    [
        ({"hook_readers": ["argocd-server", "other"]}, ("argocd-server", "other")),
        ({"hook_reader": "argocd-applicationset-controller"}, ("argocd-applicationset-controller",)),
    ],
)
def test_deployments_are_listed_or_one_is_named_as_formerly(
    tmp_path: Path, written: dict[str, Any], readers: tuple[str, ...]
) -> None:
    settings = read_settings(settings_file(tmp_path, **written), read_configuration, FORMER_KEYS)
    assert settings.argocd.hook_readers == readers


@pytest.mark.parametrize("written", [{}, {"hook_readers": "argocd-server"}, {"hook_readers": [1]}])
def test_what_is_no_list_of_names_is_refused(tmp_path: Path, written: dict[str, Any]) -> None:
    with pytest.raises(DocumentError, match=r"argocd\.hook_readers"):
        read_settings(settings_file(tmp_path, **written), read_configuration, FORMER_KEYS)


def test_what_restarts_for_another_authority_may_be_left_out(tmp_path: Path) -> None:
    def read(**written: Any) -> tuple[str, ...]:
        path = settings_file(tmp_path, hook_readers=["argocd-server"], **written)
        return read_settings(path, read_configuration, FORMER_KEYS).argocd.trust_readers

    assert read() == ()
    assert read(trust_readers=["argocd-repo-server"]) == ("argocd-repo-server",)
    with pytest.raises(DocumentError, match=r"argocd\.trust_readers"):
        read(trust_readers="argocd-repo-server")


def test_the_former_key_is_taken_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = settings_file(tmp_path, hook_reader="argocd-server")
    with caplog.at_level(logging.WARNING):
        warn_of_former_keys(path, FORMER_KEYS)
    assert caplog.messages == [
        f"settings have a former key file={path} key=argocd.hook_reader new_key=argocd.hook_readers"
    ]


IS_FORMER = "argocd.hook_reader is the former name of argocd.hook_readers"
BOTH = "argocd.hook_reader: is the former name of argocd.hook_readers, which is there as well"


@pytest.mark.parametrize(
    ("written", "problems"),
    [
        ({"hook_reader": None}, [f"argocd.hook_reader: missing ({IS_FORMER})"]),
        ({"hook_reader": "a b"}, [f"argocd.hook_reader: 'a b' must match {WORD.pattern} ({IS_FORMER})"]),
        ({"hook_reader": "a", "hook_readers": ["a", "b"]}, [f"{BOTH}; remove argocd.hook_reader"]),
        ({"hook_reader": None, "hook_readers": ["a"]}, [f"{BOTH}; remove argocd.hook_reader"]),
        (
            {"hook_reader": "a", "hook_readers": None},
            [f"{BOTH}, without a value; give it what argocd.hook_reader has and remove argocd.hook_reader"],
        ),
    ],
)
def test_a_problem_names_the_former_key_that_stands_in_the_file(
    tmp_path: Path, written: dict[str, Any], problems: list[str]
) -> None:
    with pytest.raises(DocumentError) as refused:
        read_settings(settings_file(tmp_path, **written), read_configuration, FORMER_KEYS)
    assert list(refused.value.problems) == problems


FORGE = {"accounts": [], "organisations": [], "repositories": [], "webhooks": []}


def forge_file(folder: Path, **more: Any) -> Path:
    path = settings_file(folder, hook_readers=["argocd-server"])
    document = yaml.safe_load(path.read_text())
    forge = {"url": "https://forge.robotkube.svc:3000", "administrator": str(folder), **FORGE}
    path.write_text(yaml.safe_dump({**document, "forge": {**forge, **more}}))
    return path


def test_argocd_is_told_who_may_sign_for_the_forge(tmp_path: Path) -> None:
    (tmp_path / "ca.crt").write_text("PEM")
    settings = read_settings(forge_file(tmp_path, authorities=f"{tmp_path}/ca.crt"), read_configuration, FORMER_KEYS)
    assert settings.argocd.trusted == {"forge.robotkube.svc": "PEM"}
    assert settings.forge is not None
    assert settings.forge.authorities == tmp_path / "ca.crt"


def test_authorities_that_are_not_there_are_named(tmp_path: Path) -> None:
    with pytest.raises(
        DocumentError, match=r"forge\.authorities: .*none\.crt cannot be read: .*ConfigMap robotkube-ca"
    ):
        read_settings(forge_file(tmp_path, authorities=f"{tmp_path}/none.crt"), read_configuration, FORMER_KEYS)


CLIENT = {"name": "robotkube-console", "redirect": "https://console.example/auth/callback"}
PLACE = {"namespace": "robotkube", "name": "console-sign-in"}


def test_clients_by_which_people_sign_in_may_be_left_out(tmp_path: Path) -> None:
    def read(**more: Any) -> tuple[SignInClient, ...]:
        forge = read_settings(forge_file(tmp_path, **more), read_configuration, FORMER_KEYS).forge
        assert forge is not None
        return forge.clients

    assert read() == ()
    assert read(sign_in_clients=[{**CLIENT, "config_map": PLACE}]) == (
        SignInClient("robotkube-console", "https://console.example/auth/callback", "robotkube", "console-sign-in"),
    )


@pytest.mark.parametrize(
    ("client", "problem"),
    [
        (CLIENT, r"forge\.sign_in_clients\[0\]\.config_map: missing"),
        (
            {**CLIENT, "config_map": {**PLACE, "name": "A b"}},
            r"sign_in_clients\[0\]\.config_map\.name: 'A b' must match",
        ),
        (
            {**CLIENT, "config_map": PLACE, "redirect": "console"},
            r"sign_in_clients\[0\]\.redirect: 'console' must match",
        ),
        ({**CLIENT, "config_map": PLACE, "secret": "x"}, r"sign_in_clients\[0\]\.secret: unknown key; remove it"),
    ],
)
def test_what_is_wrong_with_a_client_is_named(tmp_path: Path, client: dict[str, Any], problem: str) -> None:
    with pytest.raises(DocumentError, match=problem):
        read_settings(forge_file(tmp_path, sign_in_clients=[client]), read_configuration, FORMER_KEYS)
