"""What an Argo CD of others gets back: patches that make it what it was, whatever came between."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from typing import Any

import pytest

from ci.given_argocd import Kubectl, patches, server_values
from robotkube.delivery.preflight.core.argocd import ServerSpeech
from robotkube.delivery.preflight.core.findings import Unread


def patched(value: Any, patch: Any) -> Any:
    """A JSON merge patch, as the API server does it (RFC 7396)."""
    if not isinstance(patch, Mapping):
        return patch
    result = dict(value) if isinstance(value, Mapping) else {}
    for key, change in patch.items():
        if change is None:
            result.pop(key, None)
        else:
            result[key] = patched(result.get(key), change)
    return result


def test_what_came_goes_and_what_changed_is_as_before() -> None:
    before = {
        "configmap/a": {"data": {"url": "u", "policy.csv": "old"}},
        "secret/s": {"data": {"webhook.github.secret": "s"}},
        "appproject/default": {"spec": {"sourceRepos": ["*"]}},
        "deployment/d": {"spec": {"template": {"metadata": {"annotations": {"hook": None}}}}},
        "deployment/same": {"spec": {"x": 1}},
    }
    now = {
        "configmap/a": {"data": {"url": "u", "policy.csv": "new", "accounts.manager": "login"}},
        "secret/s": {"data": {"webhook.github.secret": "n", "webhook.gogs.secret": "n"}},
        "appproject/default": {"spec": {"sourceRepos": [], "namespaceResourceBlacklist": [{"group": "*"}]}},
        "deployment/d": {"spec": {"template": {"metadata": {"annotations": {"hook": "f"}}}}},
        "deployment/same": {"spec": {"x": 1}},
    }
    undone = patches(before, now)
    assert undone["deployment/same"] == {}
    assert undone["deployment/d"] == {"spec": {"template": {"metadata": {"annotations": {"hook": None}}}}}
    for name in ("configmap/a", "secret/s", "appproject/default"):
        assert patched(now[name], undone[name]) == before[name], name


def having(**secrets: Mapping[str, str]) -> Kubectl:
    """A kubectl that gets these Secrets of Argo CD's namespace, and nothing else."""

    def kubectl(*words: str) -> str:
        assert words[:3] == ("-n", "argocd", "get"), words
        data = secrets.get(words[3].removeprefix("secret/").replace("-", "_"))
        encoded = {key: base64.b64encode(text.encode()).decode() for key, text in (data or {}).items()}
        return json.dumps({"data": encoded}) if data is not None else ""

    return kubectl


OWN = {"tls.crt": "own\n", "tls.key": "secret", "server.secretkey": "secret"}


@pytest.mark.parametrize(
    ("secrets", "authorities"),
    [
        ({"argocd_secret": OWN}, "own\n"),
        ({"argocd_secret": OWN, "argocd_server_tls": {"tls.crt": "given", "tls.key": "secret"}}, "given\n"),
        (
            {"argocd_secret": OWN, "argocd_server_tls": {"tls.crt": "leaf\n", "ca.crt": "authority"}},
            "authority\nleaf\n",
        ),
        ({"argocd_secret": OWN, "argocd_server_tls": {"tls.key": "secret"}}, "own\n"),
    ],
)
def test_the_certificate_that_a_server_shows_is_told_to_managers(
    secrets: Mapping[str, Mapping[str, str]], authorities: str
) -> None:
    """In the order in which Argo CD takes them (its page tls.md); no key of theirs is."""
    assert server_values(having(**secrets), ServerSpeech(True, "")) == {"authorities": authorities}


@pytest.mark.parametrize("spoken", [None, ServerSpeech(False, ""), ServerSpeech(Unread("forbidden"), Unread("no"))])
def test_nothing_is_told_where_the_chart_is_right_or_nobody_can_say(spoken: ServerSpeech | None) -> None:
    assert server_values(having(argocd_secret=OWN), spoken) == {}


def test_a_root_path_is_part_of_the_address() -> None:
    assert server_values(having(), ServerSpeech(False, "cd")) == {"url": "http://argocd-server.argocd.svc/cd"}
    told = server_values(having(argocd_secret=OWN), ServerSpeech(True, "cd"))
    assert told == {"url": "https://argocd-server.argocd.svc/cd", "authorities": "own\n"}
