"""Argo CD's own objects in its namespace: accounts, rights, secrets, projects, through the Kubernetes API."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import bcrypt
from kubernetes import client
from urllib3.exceptions import HTTPError

from robotkube.errors import InputError, UnavailableError

SECRET = "argocd-secret"  # noqa: S105 - the object's name
SECONDS_MAX = 10
PROJECT_API = ("argoproj.io", "v1alpha1")
HOOK_ANNOTATION, TRUST_ANNOTATION = "robotkube.io/hook-secret", "robotkube.io/trusted-servers"
HOOK_KEYS = "webhook."  # with which keys of argocd-secret begin that check hooks
RANDOM_BYTES = 32
CLOSED: Mapping[str, Any] = {
    "sourceRepos": [],
    "destinations": [],
    "clusterResourceWhitelist": [],
    "namespaceResourceBlacklist": [{"group": "*", "kind": "*"}],
}
_PASSING = frozenset({404, 409, 429})  # Argo CD makes some of these objects itself, moments after it starts


def _now() -> datetime:
    return datetime.now(UTC)


class KubernetesArgoCDConfiguration:
    """The port ArgoCDConfiguration in `namespace`; `now` gives the time (UTC) that goes with a new password."""

    def __init__(self, api: client.ApiClient, namespace: str, now: Callable[[], datetime] | None = None) -> None:
        self._core = client.CoreV1Api(api)
        self._apps = client.AppsV1Api(api)
        self._objects = client.CustomObjectsApi(api)
        self._namespace = namespace
        self._now = now or _now

    def answers(self) -> bool:
        """Check that Argo CD has made its secret's server.secretkey: False, UnavailableError before."""
        if not self._secret().get("server.secretkey"):
            raise UnavailableError(f"{self._namespace}/{SECRET}: no server.secretkey yet; argocd-server makes it")
        return False

    def patch_config_map(self, name: str, data: Mapping[str, str]) -> bool:
        """Set keys of a ConfigMap."""
        with self._errors(f"ConfigMap {name}"):
            config_map = self._core.read_namespaced_config_map(name, self._namespace, _request_timeout=SECONDS_MAX)
            if all((config_map.data or {}).get(key) == value for key, value in data.items()):
                return False
            self._core.patch_namespaced_config_map(
                name, self._namespace, {"data": dict(data)}, _request_timeout=SECONDS_MAX
            )
        return True

    def _secret(self) -> dict[str, str]:
        with self._errors(f"Secret {SECRET}"):
            secret = self._core.read_namespaced_secret(SECRET, self._namespace, _request_timeout=SECONDS_MAX)
        return {key: base64.b64decode(value).decode() for key, value in (secret.data or {}).items()}

    def set_hook_secrets(self, given: Mapping[str, str], unused: Sequence[str]) -> bool:
        """Set keys of argocd-secret; each of `unused` without a value gets a random one that nobody keeps."""
        secret = self._secret()
        random = {key: secrets.token_hex(RANDOM_BYTES) for key in unused if not secret.get(key)}
        return self._patch_secret({**random, **given})

    def _patch_secret(self, data: Mapping[str, str]) -> bool:
        secret = self._secret()
        if all(secret.get(key) == value for key, value in data.items()):
            return False
        body = {"data": {key: base64.b64encode(value.encode()).decode() for key, value in data.items()}}
        with self._errors(f"Secret {SECRET}"):
            self._core.patch_namespaced_secret(SECRET, self._namespace, body, _request_timeout=SECONDS_MAX)
        return True

    def set_password(self, account: str, password: str) -> bool:
        """Set a local account's password unless the stored hash fits it."""
        key = f"accounts.{account}.password"
        stored = self._secret().get(key, "")
        with contextlib.suppress(ValueError):  # not a hash
            if stored and bcrypt.checkpw(password.encode(), stored.encode()):
                return False
        hashed = bcrypt.hashpw(password.encode(), bcrypt.gensalt(10)).decode()
        return self._patch_secret({key: hashed, f"{key}Mtime": self._now().strftime("%Y-%m-%dT%H:%M:%SZ")})

    def close_project(self, name: str) -> bool:
        """Make an AppProject allow nothing."""
        place = (*PROJECT_API, self._namespace, "appprojects", name)
        with self._errors(f"AppProject {name}"):
            project = self._objects.get_namespaced_custom_object(*place, _request_timeout=SECONDS_MAX)
            spec = project.get("spec") or {}
            # Argo CD leaves empty lists out; what else the project allows is taken away by null.
            body = {key: None for key in spec if key not in CLOSED} | dict(CLOSED)
            if {key: value for key, value in spec.items() if value} == {k: v for k, v in CLOSED.items() if v}:
                return False
            self._objects.patch_namespaced_custom_object(
                *place, {"spec": body}, _content_type="application/merge-patch+json", _request_timeout=SECONDS_MAX
            )
        return True

    def restart_on_change(self, deployment: str, hooks: bool, trusted: Mapping[str, str]) -> bool:
        """Restart a Deployment when, and only when, `trusted` (server -> PEM, if any) or, with `hooks`, the secrets of
        hooks are not those it was last restarted for."""
        wanted = {TRUST_ANNOTATION: _fingerprint(trusted)} if trusted else {}
        if hooks:
            secret = self._secret()
            wanted[HOOK_ANNOTATION] = _fingerprint({key: secret[key] for key in secret if key.startswith(HOOK_KEYS)})
        with self._errors(f"Deployment {deployment}"):
            present = self._apps.read_namespaced_deployment(deployment, self._namespace, _request_timeout=SECONDS_MAX)
            if wanted.items() <= (present.spec.template.metadata.annotations or {}).items():
                return False
            body = {"spec": {"template": {"metadata": {"annotations": wanted}}}}
            self._apps.patch_namespaced_deployment(deployment, self._namespace, body, _request_timeout=SECONDS_MAX)
        return True

    def rolled_out(self, deployment: str) -> bool:
        """Check that the pods of a Deployment are those it asks for now, and ready: False, UnavailableError before."""
        with self._errors(f"Deployment {deployment}"):
            read = self._apps.read_namespaced_deployment(deployment, self._namespace, _request_timeout=SECONDS_MAX)
        asked, status = read.spec.replicas, read.status
        seen = status.observed_generation == read.metadata.generation
        counted = {status.replicas or 0, status.updated_replicas or 0, status.available_replicas or 0}
        if not seen or counted != {asked}:
            ready = min(status.updated_replicas or 0, status.available_replicas or 0) if seen else 0
            raise UnavailableError(f"{self._namespace}/{deployment}: {ready} of {asked} new pods are ready")
        return False

    @contextlib.contextmanager
    def _errors(self, what: str) -> Iterator[None]:
        where = f"Argo CD, {what} in namespace {self._namespace}"
        try:
            yield
        except client.ApiException as error:
            text = f"{where}: {error.status} {error.reason}"
            if error.status in _PASSING or error.status >= 500:
                raise UnavailableError(f"{text}; it must be there: install Argo CD in that namespace first") from error
            raise InputError(f"{text}; the Role of the bootstrap Job must allow get and patch on it") from error
        except (HTTPError, OSError) as error:
            raise UnavailableError(f"{where}: the API server does not answer: {error}") from error


def _fingerprint(values: Mapping[str, str]) -> str:
    return hashlib.sha256(json.dumps(dict(values), sort_keys=True).encode()).hexdigest()[:16]
