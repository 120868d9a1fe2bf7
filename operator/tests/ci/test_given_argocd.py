"""What an Argo CD of others gets back: patches that make it what it was, whatever came between."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ci.given_argocd import patches


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
