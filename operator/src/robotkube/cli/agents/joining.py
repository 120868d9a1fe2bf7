"""What an agent's machine needs to join the cluster, in one file: a kubeconfig with which its kubelet asks for a
certificate (a token that expires, the API server's address and authority), and the labels that its Node shall have.

The token is a bootstrap token of Kubernetes: https://kubernetes.io/docs/reference/access-authn-authz/bootstrap-tokens/
"""

from __future__ import annotations

import base64
import json
import os
import secrets
import string
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from robotkube.cli.platform import AGENT_LABEL, Platform
from robotkube.errors import InputError, RefusalError
from robotkube.foundation.documents.core.yaml_codec import write_mapping

ROLE_LABEL = "robotkube.io/role"
EXTENSION = "robotkube.io/agent"
TOKENS = "/api/v1/namespaces/kube-system/secrets"
REVIEWS = "/apis/authentication.k8s.io/v1/tokenreviews"
NODES_GROUP = "system:bootstrappers:kubeadm:default-node-token"
TAKEN_SECONDS_MAX = 15.0
POLL_SECONDS = 1.0
LETTERS = string.ascii_lowercase + string.digits


@dataclass(frozen=True)
class JoinToken:
    """A bootstrap token of one agent, and when it ends."""

    agent: str
    number: str
    secret: str
    expires: str

    @property
    def text(self) -> str:
        """The token as it is sent."""
        return f"{self.number}.{self.secret}"

    @property
    def document(self) -> Mapping[str, Any]:
        """The Secret by which the API server knows it."""
        values = {
            "token-id": self.number,
            "token-secret": self.secret,
            "expiration": self.expires,
            "usage-bootstrap-authentication": "true",
            "auth-extra-groups": NODES_GROUP,
            "description": f"for the Node of agent {self.agent}",
        }
        return {
            "apiVersion": "v1",
            "kind": "Secret",
            "metadata": {"name": f"bootstrap-token-{self.number}", "labels": {AGENT_LABEL: self.agent}},
            "type": "bootstrap.kubernetes.io/token",
            "stringData": values,
        }


def new_token(agent: str, now: datetime, hours: int) -> JoinToken:
    """A token that nobody knows yet, for so many hours."""
    number, secret = ("".join(secrets.choice(LETTERS) for _ in range(length)) for length in (6, 16))
    return JoinToken(agent, number, secret, (now + timedelta(hours=hours)).strftime("%Y-%m-%dT%H:%M:%SZ"))


def join_file(token: JoinToken, role: str, server: str, authority: str) -> str:
    """The text of the file. Without an `authority` (PEM) the machine's own authorities verify the API server."""
    labels = {AGENT_LABEL: token.agent, ROLE_LABEL: role}
    about = {
        "agent": token.agent,
        "role": role,
        "expires": token.expires,
        "nodeLabels": ",".join(f"{key}={value}" for key, value in labels.items()),
    }
    trusted = {"certificate-authority-data": base64.b64encode(authority.encode()).decode()} if authority else {}
    named = {"cluster": "robotkube", "user": token.agent, "extensions": [{"name": EXTENSION, "extension": about}]}
    return write_mapping(
        {
            "apiVersion": "v1",
            "kind": "Config",
            "clusters": [{"name": "robotkube", "cluster": {"server": server, **trusted}}],
            "users": [{"name": token.agent, "user": {"token": token.text}}],
            "contexts": [{"name": token.agent, "context": named}],
            "current-context": token.agent,
        }
    )


def give_token(platform: Platform, token: JoinToken) -> None:
    """Have the API server know the token, and those of before of this agent no more. Whatever goes wrong, the token is
    gone again then: RefusalError when it takes no bootstrap tokens, InputError when it may not be asked."""
    before = [one["metadata"]["name"] for one in join_tokens(platform) if _agent(one) == token.agent]
    platform.call("POST", TOKENS, body=token.document).read()
    try:
        _check_taken(platform, token)
    except BaseException:
        _end(platform, str(token.document["metadata"]["name"]))
        raise
    for old in before:
        _end(platform, old)


def _end(platform: Platform, name: str) -> None:
    platform.call("DELETE", f"{TOKENS}/{name}").read()


def _check_taken(platform: Platform, token: JoinToken) -> None:
    if not _is_taken(platform, token):
        raise RefusalError(
            "NoBootstrapTokens",
            "the API server takes no bootstrap tokens, so there is no file. Start it with "
            "--enable-bootstrap-token-auth, or join the Node as your cluster does, with the labels "
            f"{AGENT_LABEL}={token.agent} and {ROLE_LABEL}",
        )


def _is_taken(platform: Platform, token: JoinToken) -> bool:
    """Return whether the API server takes the token, which it may learn of a moment after it was made; it remembers for
    ten seconds what it did not know."""
    review = {"apiVersion": "authentication.k8s.io/v1", "kind": "TokenReview", "spec": {"token": token.text}}
    end = time.monotonic() + TAKEN_SECONDS_MAX
    while True:
        answer = json.loads(platform.call("POST", REVIEWS, body=review).data)
        if answer.get("status", {}).get("authenticated"):
            return True
        if time.monotonic() >= end:
            return False
        time.sleep(POLL_SECONDS)


def join_tokens(platform: Platform) -> Iterable[Mapping[str, Any]]:
    """The Secrets of agents' tokens that stand; InputError when they may not be read."""
    answer = platform.call("GET", TOKENS, [("labelSelector", AGENT_LABEL)])
    items: list[Mapping[str, Any]] = json.loads(answer.data)["items"]
    return [one for one in items if one.get("type") == "bootstrap.kubernetes.io/token"]


def token_ends(platform: Platform) -> Mapping[str, str]:
    """The ends of agents' tokens, by agent, of those that have one; none when tokens may not be read."""
    try:
        tokens = join_tokens(platform)
    except InputError:
        return {}
    return {_agent(token): base64.b64decode(token["data"]["expiration"]).decode() for token in tokens}


def _agent(secret: Mapping[str, Any]) -> str:
    return str(secret["metadata"]["labels"][AGENT_LABEL])


def write_secret_file(path: Path, text: str) -> None:
    """Write a new file that only its owner reads; InputError when there is one already."""
    try:
        number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError as error:
        raise InputError(f"--file {path}: is there already; name another one, or remove it") from error
    except OSError as error:
        raise InputError(f"--file {path}: cannot be written: {error}") from error
    with os.fdopen(number, "w", encoding="utf-8") as file:
        file.write(text)
