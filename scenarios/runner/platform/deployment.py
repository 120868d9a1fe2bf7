"""The forge's repositories as the run sees them: releases, commits and files by Git, pull requests by the forge's API.

A person's change is made as people make them: a commit proposed by AGit (refs/for/main), approved by another person,
merged by the gate.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any, Self

import httpx
import pygit2
import yaml

from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed
from robotkube.foundation.forge.adapters.git.connection import ORIGIN, GitConnection, fetch
from robotkube.foundation.forge.core.trailers import read_trailers
from robotkube.foundation.runtime.adapters.kept_connections import KeptConnections
from scenarios.runner.inputs import NANOSECONDS, Commit, MainState, PullRequestOfRun
from scenarios.runner.platform.access import Endpoint
from scenarios.runner.waiting import RunError

REPOSITORY, CATALOGUE, BRANCH = "robotkube/deployment", "robotkube/catalogue", "main"
ANSWER_SECONDS_MAX = 15.0
PULL_REQUESTS_PER_PAGE = 50
PAGES_MAX = 20
COMMITS_MAX = 2000


class Deployment:
    """A bare clone of `name` in a temporary folder and a connection to the forge, as one person's account; `approver`:
    account and password of the person who approves what this one proposes."""

    def __init__(
        self,
        forge: Endpoint,
        username: str,
        password: str,
        name: str = REPOSITORY,
        approver: tuple[str, str] | None = None,
    ) -> None:
        self._user = username
        self._account = (username, password)
        self._approver = approver
        self._name = name
        self._url = forge.url
        self._client = KeptConnections(
            base_url=f"{self._url}/api/v1/repos/{name}",
            auth=self._account,
            verify=certificate_authorities(),
            timeout=ANSWER_SECONDS_MAX,
        )
        self._folder = tempfile.TemporaryDirectory(prefix="deployment-")
        self._repository = pygit2.init_repository(self._folder.name, bare=True)
        self._repository.remotes.create(ORIGIN, f"{self._url}/{name}.git")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()
        self._folder.cleanup()

    def fetch(self) -> str:
        """Brings the clone up to date; returns main's tip."""
        try:
            fetch(self._repository, [f"+refs/heads/{BRANCH}:refs/heads/{BRANCH}"], self._account)
        except (pygit2.GitError, PermissionError) as error:
            raise RunError(f"{self._url}/{self._name}.git: cannot be fetched as {self._user}: {error}") from error
        return str(self._tip().id)

    def file(self, path: str) -> str:
        """A file of main as text, empty when there is none."""
        blob = self._entry(path)
        return blob.data.decode() if isinstance(blob, pygit2.Blob) else ""

    def files(self, folder: str) -> dict[str, bytes]:
        """All files of main below a folder, by path."""
        tree = self._entry(folder)
        if not isinstance(tree, pygit2.Tree):
            return {}
        return {f"{folder}/{path}": blob.data for path, blob in _blobs(tree)}

    def releases(self) -> dict[str, Mapping[str, Any]]:
        """The release files of main by <namespace>/<release>."""
        return {name: yaml.safe_load(blob.data) for name, blob in _releases(self._tip())}

    def releases_since(self, commit: str) -> Iterator[tuple[str, Any]]:
        """Every release file of main as it stood at `commit` or at a later one: <namespace>/<release> and its content;
        None for one that is not YAML."""
        seen: set[tuple[str, str]] = set()
        walk = self._walk()
        for at, _ in zip(walk, range(COMMITS_MAX), strict=False):
            for name, blob in _releases(at):
                if (name, str(blob.id)) not in seen:
                    seen.add((name, str(blob.id)))
                    yield name, _document(blob.data)
            if str(at.id) == commit:
                return

    def history(self, commit: str) -> tuple[MainState, ...]:
        """Which tasks each release named, at `commit` and at every later commit of main, the oldest first."""
        walk = self._walk()
        states: list[MainState] = []
        named: dict[str, tuple[str, ...]] = {}
        for at, _ in zip(walk, range(COMMITS_MAX), strict=False):
            states.append(MainState(str(at.id), {name: _tasks(blob, named) for name, blob in _releases(at)}))
            if str(at.id) == commit:
                break
        return tuple(reversed(states))

    def message(self, commit: str) -> str:
        """The whole message of a commit of main."""
        return str(self._repository[commit].peel(pygit2.Commit).message)

    def commits(self) -> tuple[Commit, ...]:
        """All commits of main, newest first."""
        walk = self._walk()
        commits = [self._commit(commit) for _, commit in zip(range(COMMITS_MAX), walk, strict=False)]
        return tuple(commits)

    def pull_requests(self) -> tuple[PullRequestOfRun, ...]:
        """All pull requests, in whatever state."""
        requests: list[PullRequestOfRun] = []
        for page in range(1, PAGES_MAX + 1):
            part = self._call("GET", "/pulls", params={"state": "all", "limit": PULL_REQUESTS_PER_PAGE, "page": page})
            requests += [_pull_request(item) for item in part]
            if len(part) < PULL_REQUESTS_PER_PAGE:
                break
        return tuple(requests)

    def pull_request(self, number: int) -> PullRequestOfRun:
        """One pull request."""
        return _pull_request(self._call("GET", f"/pulls/{number}"))

    def propose(self, path: str, text: str, message: str, topic: str) -> str:
        """Proposes one changed file on top of main; returns the commit. The forge opens the pull request."""
        parent = self._tip()
        tree = self._with_file(parent.tree, path.split("/"), self._repository.create_blob(text.encode()))
        who = pygit2.Signature(self._user, f"{self._user}@forge.invalid")
        commit = self._repository.create_commit(None, who, who, message, tree, [parent.id])
        reference = f"refs/heads/{topic}"
        self._repository.references.create(reference, commit, force=True)
        connection = GitConnection(self._account)
        try:
            self._repository.remotes[ORIGIN].push([f"{reference}:refs/for/{BRANCH}/{topic}"], callbacks=connection)
        except (pygit2.GitError, PermissionError) as error:
            raise RunError(f"the forge did not accept the proposal of {self._user} for {path}: {error}") from error
        if connection.refusal:
            raise RunError(f"the forge refused the proposal of {self._user} for {path}: {connection.refusal}")
        return str(commit)

    def number_of(self, commit: str) -> int | None:
        """The open or merged pull request whose head is `commit`."""
        part = self._call("GET", "/pulls", params={"state": "all", "limit": PULL_REQUESTS_PER_PAGE})
        return next((int(item["number"]) for item in part if (item.get("head") or {}).get("sha") == commit), None)

    def approve(self, number: int, commit: str) -> None:
        """A review "approve" of exactly `commit` by the other person; RunError when the forge does not take it."""
        if self._approver is None:
            raise RunError(f"pull request #{number} of {self._user}: nobody was named who approves it")
        body = {"event": "APPROVED", "commit_id": commit, "body": ""}
        self._call("POST", f"/pulls/{number}/reviews", json=body, auth=self._approver)

    def comments(self, number: int) -> str:
        """What was said about a pull request."""
        return "\n".join(str(item["body"]) for item in self._call("GET", f"/issues/{number}/comments"))

    def _call(self, method: str, path: str, **options: Any) -> Any:
        try:
            answer = self._client.request(method, path, **options)
        except httpx.HTTPError as error:
            raise RunError(f"forge {self._url}: {method} {path}: {what_failed(error, self._url)}") from error
        if answer.is_error:
            raise RunError(
                f"forge {self._url}: {method} {path} as {self._user}: {answer.status_code} {answer.text[:300]}"
            )
        return answer.json()

    def _walk(self) -> Any:
        """Main's commits from its tip on, by their first parents: what else they joined was never main."""
        walk = self._repository.walk(self._tip().id, pygit2.enums.SortMode.TOPOLOGICAL)
        walk.simplify_first_parent()
        return walk

    def _tip(self) -> pygit2.Commit:
        return self._repository.references[f"refs/heads/{BRANCH}"].peel(pygit2.Commit)

    def _entry(self, path: str) -> Any:
        try:
            return self._tip().tree[path]
        except KeyError:
            return None

    def _with_file(self, tree: pygit2.Tree | None, parts: list[str], blob: pygit2.Oid) -> pygit2.Oid:
        """The tree with one file put at `parts`."""
        builder = self._repository.TreeBuilder(tree) if tree is not None else self._repository.TreeBuilder()
        name, *rest = parts
        if not rest:
            builder.insert(name, blob, pygit2.enums.FileMode.BLOB)
        else:
            below = tree[name] if tree is not None and name in tree else None
            below = below if isinstance(below, pygit2.Tree) else None
            builder.insert(name, self._with_file(below, rest, blob), pygit2.enums.FileMode.TREE)
        return builder.write()

    def _commit(self, commit: pygit2.Commit) -> Commit:
        return Commit(
            sha=str(commit.id),
            parents=tuple(str(parent) for parent in commit.parent_ids),
            author=commit.author.name,
            subject=commit.message.partition("\n")[0],
            time=commit.commit_time * NANOSECONDS,
            trailers=read_trailers(commit.message),
            paths=tuple(self._paths(commit)),
        )

    def _paths(self, commit: pygit2.Commit) -> Iterator[str]:
        """Paths that a commit touches against its first parent."""
        if commit.parents:
            difference = commit.parents[0].tree.diff_to_tree(commit.tree)
        else:
            difference = commit.tree.diff_to_tree(swap=True)
        for delta in difference.deltas:
            yield delta.new_file.path


def _blobs(tree: pygit2.Tree) -> Iterator[tuple[str, pygit2.Blob]]:
    """Files of a tree with their paths in it."""
    for entry in tree:
        if isinstance(entry, pygit2.Tree):
            yield from ((f"{entry.name}/{path}", blob) for path, blob in _blobs(entry))
        elif isinstance(entry, pygit2.Blob):
            yield str(entry.name), entry


def _releases(commit: pygit2.Commit) -> Iterator[tuple[str, pygit2.Blob]]:
    """<namespace>/<release> and file of every release of a commit."""
    if "releases" in commit.tree and isinstance(folder := commit.tree["releases"], pygit2.Tree):
        yield from ((path.removesuffix(".yaml"), blob) for path, blob in _blobs(folder) if path.count("/") == 1)


def _document(data: bytes) -> Any:
    try:
        return yaml.safe_load(data)
    except (yaml.YAMLError, UnicodeDecodeError):
        return None


def _tasks(blob: pygit2.Blob, named: dict[str, tuple[str, ...]]) -> tuple[str, ...]:
    """The tasks that a release file names; `named` keeps what was read once."""
    key = str(blob.id)
    if key not in named:
        document = _document(blob.data)
        metadata = document.get("metadata") if isinstance(document, Mapping) else None
        annotations = metadata.get("annotations") if isinstance(metadata, Mapping) else None
        words = annotations.get("robotkube.io/tasks", "") if isinstance(annotations, Mapping) else ""
        named[key] = tuple(str(words).split())
    return named[key]


def specification_digests(releases: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """A digest of each release's specification: what it asks for, not which plan wrote it."""
    return {
        name: hashlib.sha256(json.dumps(document["spec"], sort_keys=True).encode()).hexdigest()[:16]
        for name, document in sorted(releases.items())
    }


def _pull_request(item: Mapping[str, Any]) -> PullRequestOfRun:
    merged = bool(item.get("merged"))
    commit = item.get("merge_commit_sha") if merged else None
    return PullRequestOfRun(int(item["number"]), str(item.get("title", "")), merged, str(commit) if commit else None)
