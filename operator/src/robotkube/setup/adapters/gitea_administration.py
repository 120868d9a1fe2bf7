"""Gitea as its administrator: accounts, organisations, teams, repositories, protection, webhooks and clients of sign-in
over its API.

Each call reads what is there and changes only what differs: it can run after every upgrade and be killed anywhere.
"""

from __future__ import annotations

import base64
import contextlib
from collections.abc import Mapping, Sequence
from typing import Any

import httpx

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed
from robotkube.foundation.runtime.adapters.kept_connections import KeptConnections

TIMEOUT_SECONDS = 30.0
PAGE_ITEMS = 50
PAGES_MAX = 20
SIGN_IN_CLIENTS = "/user/applications/oauth2"
SEED_MESSAGE = "Begin this repository\n\nThe only commit of main without a pull request.\n"

# The gate pushes what it checked. Gitea wants a style of merging; who may use it is said by `protect`.
REPOSITORY_OPTIONS: Mapping[str, Any] = {
    "has_pull_requests": True,
    "allow_merge_commits": False,
    "allow_rebase": False,
    "allow_rebase_explicit": False,
    "allow_squash_merge": False,
    "allow_fast_forward_only_merge": True,
    "default_merge_style": "fast-forward-only",
    "allow_manual_merge": False,
    "autodetect_manual_merge": True,  # what the gate pushed shows as merged
    "has_issues": False,
    "has_wiki": False,
    "has_projects": False,
    "has_packages": False,
    "has_releases": False,
    "has_actions": False,
}


class GiteaAdministration:
    """The port ForgeAdministration for the forge at `url`, as `username` (an administrator of the forge)."""

    def __init__(self, url: str, username: str, password: str) -> None:
        self._url = url
        self._username = username
        self._client = KeptConnections(
            base_url=f"{url}/api/v1",
            auth=(username, password),
            verify=certificate_authorities(),
            timeout=TIMEOUT_SECONDS,
        )

    def disconnect(self) -> None:
        """Close the connections."""
        self._client.close()

    def answers(self) -> bool:
        """Check that it serves and accepts the administrator's password: False, UnavailableError before."""
        try:
            self._call("GET", "/user")
        except InputError as error:  # the forge's own set-up makes this account moments after it serves
            raise UnavailableError(f"{error}; the administrator is not there or has another password") from error
        return False

    def make_account(self, name: str, password: str) -> bool:
        """Make an account with that password; no e-mail reaches it."""
        if self._find(f"/users/{name}") is None:
            account = {"username": name, "email": f"{name}@forge.invalid", "password": password}
            self._call("POST", "/admin/users", {**account, "must_change_password": False})
            return True
        if self._knows(name, password):
            return False
        self._call("PATCH", f"/admin/users/{name}", {"login_name": name, "source_id": 0, "password": password})
        return True

    def _knows(self, name: str, password: str) -> bool:
        try:
            answer = httpx.get(  # without what the administrator's client keeps
                f"{self._url}/api/v1/user",
                auth=(name, password),
                verify=certificate_authorities(),
                timeout=TIMEOUT_SECONDS,
            )
        except httpx.HTTPError as error:
            raise UnavailableError(f"forge {self._url}: {what_failed(error, self._url)}") from error
        return answer.status_code == 200

    def make_organisation(self, name: str) -> bool:
        """Make a private organisation."""
        if self._find(f"/orgs/{name}") is not None:
            return False
        self._call("POST", "/orgs", {"username": name, "visibility": "private"})
        return True

    def make_repository(self, repository: str, description: str, branch: str) -> bool:
        """Make a private, empty repository with pull requests."""
        organisation, _, name = repository.partition("/")
        wanted = {"description": description, "default_branch": branch, "private": True, **REPOSITORY_OPTIONS}
        present = self._find(f"/repos/{repository}")
        if present is None:
            first = {"name": name, "private": True, "default_branch": branch, "description": description}
            present = self._call("POST", f"/orgs/{organisation}/repos", first)
        elif not _differences(present, wanted):
            return False
        options = {key: wanted[key] for key in _differences(present, wanted)}
        if present.get("empty") and "default_branch" in options:
            del options["default_branch"]  # refused while there is no branch
        # Gitea accepts the merge styles only together with has_pull_requests.
        self._call("PATCH", f"/repos/{repository}", {**options, **REPOSITORY_OPTIONS})
        return True

    def seed(self, repository: str, branch: str, files: Mapping[str, bytes]) -> bool:
        """Make the first commit, only when the repository is empty."""
        if not self._call("GET", f"/repos/{repository}").get("empty"):
            return False
        if not files:
            raise InputError(f"seed of {repository}: the folder holds no files; settings and image must agree on it")
        changes = [
            {"operation": "create", "path": path, "content": base64.b64encode(content).decode()}
            for path, content in sorted(files.items())
        ]
        identity = {"name": self._username, "email": f"{self._username}@forge.invalid"}
        who = {"author": identity, "committer": identity}
        commit = {"branch": branch, "message": SEED_MESSAGE, "files": changes, **who}
        self._call("POST", f"/repos/{repository}/contents", commit)
        return True

    def protect(self, repository: str, branch: str, pushers: Sequence[str]) -> bool:
        """Protect the branch: only `pushers` push it, nobody by force, and nobody else merges; only `pushers` tag."""
        rule = {
            "enable_push": True,
            "enable_push_whitelist": True,
            "push_whitelist_usernames": sorted(pushers),
            "enable_force_push": False,
            "enable_merge_whitelist": True,  # without it, whoever may write may press the button
            "merge_whitelist_usernames": sorted(pushers),
            "block_on_outdated_branch": False,
            "block_admin_merge_override": True,
        }
        changed = self._protect_branch(repository, branch, rule)
        return self._protect_tags(repository, pushers) or changed

    def _protect_branch(self, repository: str, branch: str, rule: Mapping[str, Any]) -> bool:
        path = f"/repos/{repository}/branch_protections"
        present = next((r for r in self._call("GET", path) if r.get("rule_name") == branch), None)
        if present is None:
            self._call("POST", path, {"rule_name": branch, **rule})
        elif _differences(present, rule):
            self._call("PATCH", f"{path}/{branch}", dict(rule))
        else:
            return False
        return True

    def _protect_tags(self, repository: str, taggers: Sequence[str]) -> bool:
        path = f"/repos/{repository}/tag_protections"
        rule = {"name_pattern": "*", "whitelist_usernames": sorted(taggers)}
        present = next((r for r in self._call("GET", path) or [] if r.get("name_pattern") == "*"), None)
        if present is None:
            self._call("POST", path, rule)
        elif _differences(present, rule):
            self._call("PATCH", f"{path}/{present['id']}", rule)
        else:
            return False
        return True

    def make_team(
        self, organisation: str, team: str, units: Mapping[str, str], members: frozenset[str], repository: str
    ) -> bool:
        """Make a team with exactly these members and units; for one repository, or for none when it is empty."""
        level = "write" if "write" in units.values() else "read"
        wanted = {"permission": level, "units_map": dict(units), "includes_all_repositories": False}
        present = next((t for t in self._pages(f"/orgs/{organisation}/teams") if t["name"] == team), None)
        changed = present is None
        if present is None:
            present = self._call("POST", f"/orgs/{organisation}/teams", {"name": team, **wanted})
        elif _differences(present, {key: wanted[key] for key in ("units_map", "includes_all_repositories")}):
            self._call("PATCH", f"/teams/{present['id']}", {"name": team, **wanted})
            changed = True
        changed = self._set_members(present["id"], members) or changed
        return (bool(repository) and self._give_repository(present["id"], repository)) or changed

    def _set_members(self, team: int, members: frozenset[str]) -> bool:
        present = {member["login"] for member in self._pages(f"/teams/{team}/members")}
        for name in sorted(members - present):
            self._call("PUT", f"/teams/{team}/members/{name}")
        for name in sorted(present - members):
            self._call("DELETE", f"/teams/{team}/members/{name}")
        return present != members

    def _give_repository(self, team: int, repository: str) -> bool:
        if any(given["full_name"] == repository for given in self._pages(f"/teams/{team}/repos")):
            return False
        self._call("PUT", f"/teams/{team}/repos/{repository}")
        return True

    def make_webhook(self, repository: str, url: str, events: Sequence[str], secret: str) -> bool:
        """Make a webhook with signed deliveries, one per repository and url; its secret cannot be read, so it is set
        each time."""
        path = f"/repos/{repository}/hooks"
        config = {"url": url, "content_type": "json", "secret": secret}
        written, shown = _hook_events(events)
        wanted = {"config": config, "events": sorted(written), "active": True}
        hooks = self._webhooks(path, url)
        for double in hooks[1:]:
            self._call("DELETE", f"{path}/{double['id']}")
        if not hooks:
            self._call("POST", path, {"type": "gitea", **wanted})
            return True
        self._call("PATCH", f"{path}/{hooks[0]['id']}", wanted)
        return set(hooks[0].get("events") or []) != shown or not hooks[0].get("active")

    def remove_webhook(self, repository: str, url: str) -> bool:
        """Remove the webhooks of a repository to `url`."""
        path = f"/repos/{repository}/hooks"
        hooks = self._webhooks(path, url)
        for hook in hooks:
            self._call("DELETE", f"{path}/{hook['id']}")
        return bool(hooks)

    def _webhooks(self, path: str, url: str) -> list[Any]:
        return [hook for hook in self._pages(path) if (hook.get("config") or {}).get("url") == url]

    def make_sign_in_client(self, name: str, redirect: str) -> bool:
        """Make an OAuth2 application of the administrator's, without a secret of any use: a public client, which Gitea
        asks for PKCE, and whom each person agrees to at each sign-in."""
        wanted = {
            "name": name,
            "redirect_uris": [redirect],
            "confidential_client": False,
            "skip_secondary_authorization": False,
        }
        present = self._sign_in_client(name)
        if present is None:
            self._call("POST", SIGN_IN_CLIENTS, wanted)
        elif _differences(present, wanted):
            self._call("PATCH", f"{SIGN_IN_CLIENTS}/{present['id']}", wanted)
        else:
            return False
        return True

    def client_id(self, name: str) -> str:
        """The id that Gitea has drawn for it."""
        present = self._sign_in_client(name)
        if present is None:
            raise UnavailableError(f"forge {self._url}: no OAuth2 application {name!r} any more")
        return str(present["client_id"])

    def _sign_in_client(self, name: str) -> Any:
        """The first one of this name; None when there is none. Gitea lets a name stand for several."""
        named = [page for page in self._pages(SIGN_IN_CLIENTS) if page["name"] == name]
        return min(named, key=lambda one: int(one["id"]), default=None)

    def _find(self, path: str) -> Any:
        """The object at a path; None when it is not there."""
        with contextlib.suppress(_NotFoundError):
            return self._call("GET", path)
        return None

    def _pages(self, path: str) -> list[Any]:
        entries: list[Any] = []
        for page in range(1, PAGES_MAX + 1):
            items = self._call("GET", f"{path}?limit={PAGE_ITEMS}&page={page}") or []
            entries += items
            if len(items) < PAGE_ITEMS:
                return entries
        raise InputError(f"forge {self._url}: {path} has more than {PAGES_MAX * PAGE_ITEMS} entries")

    def _call(self, method: str, path: str, body: Mapping[str, Any] | None = None) -> Any:
        what = f"forge {self._url}: {method} {path}"
        try:
            answer = self._client.request(method, path, json=body)
        except httpx.HTTPError as error:
            raise UnavailableError(f"{what}: {what_failed(error, self._url)}") from error
        if answer.status_code >= 500:
            raise UnavailableError(f"{what}: {answer.status_code} {answer.text[:500]}")
        if answer.is_error:
            kind = _NotFoundError if answer.status_code == 404 else InputError
            raise kind(f"{what}: {answer.status_code} {answer.text[:500]}")
        return answer.json() if answer.content else None


class _NotFoundError(InputError):
    pass


def _hook_events(events: Sequence[str]) -> tuple[set[str], set[str]]:
    """Gitea's names of the events when they are written and when they are shown: `pull_request` written would mean
    comments and labels too; new commits of a pull request and reviews are events of their own."""
    if "pull_request" not in events:
        return set(events), set(events)
    others = set(events) - {"pull_request"}
    both = others | {"pull_request_sync", "pull_request_review"}
    return both | {"pull_request_only"}, both | {"pull_request"}


def _differences(present: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """Keys that `present` shows with another value; keys that the API does not show cannot differ."""
    return [key for key, value in wanted.items() if key in present and present[key] != value]
