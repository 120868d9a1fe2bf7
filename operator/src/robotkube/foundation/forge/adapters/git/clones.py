"""A bare clone of one repository of the forge, kept up to date: fetch, read commits and files, push one commit.

The gate reads and moves main with it, and reads the catalogue; the publisher writes the catalogue with it. A clone
keeps the texts of the last files it was asked for, by blob id.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import pygit2
from pygit2.enums import FileMode

from robotkube.errors import AccountRefusedError, DocumentError, InputError, RobotKubeError, UnavailableError
from robotkube.foundation.forge.adapters.git.commit_objects import LOOSE_MAX, pack_loose, store_objects
from robotkube.foundation.forge.adapters.git.connection import (
    ORIGIN,
    GitConnection,
    fetch,
    look_up,
    open_clone,
    what_failed,
)
from robotkube.foundation.forge.adapters.git.refusals import refusal_words, refused_status
from robotkube.foundation.forge.core.commit_objects import CommitObjects
from robotkube.foundation.forge.ports.repositories import Commit, CommitShape
from robotkube.writes import writes

FILES_CACHED_MAX = 4096
FILE_BYTES_MAX = 1024 * 1024
CHANGED_FILES_MAX = 1000
CHANGED_CHARACTERS_MAX = 16 * 1024 * 1024  # of all texts that a commit brings
CHANGED_ENTRIES_MAX = 20_000  # of the folders that are compared: a few objects can spell out billions of paths
DEPTH_MAX = 16
HEADS = "refs/pull/{}/head"  # where the forge keeps the commit of a pull request; {} is its number


class GitClone:
    """Ports MainBranch and Catalogue for one repository `<url>/<organisation>/<name>`; the clone stands in `folder`.

    Not for several threads at once. UnavailableError: the forge does not answer or refuses the account; a caller may
    try again. InputError: what was asked for is not there, or the forge refuses what is pushed; DocumentError: the
    commit is not one that can be judged.
    """

    def __init__(
        self,
        url: str,
        repository: str,
        username: str,
        password: str,
        folder: Path,
        branch: str = "main",
        heads: str = HEADS,
        remote: bool = True,
    ) -> None:
        """`remote` False: what stands in `folder` is read and never fetched, and its settings stay as they are."""
        self._heads = heads
        self._where = f"git {url}/{repository}"
        self._account = (username, password)
        self._branch = branch
        self._repository = open_clone(folder, url, repository) if remote else pygit2.Repository(str(folder))
        self._text = lru_cache(FILES_CACHED_MAX)(self._read_text)
        self._loose = 0  # objects that were stored since the last pack was made

    @property
    def tip(self) -> str:
        """The branch's tip as last fetched or pushed; empty before the first fetch and for an empty repository."""
        reference = self._repository.references.get(f"refs/heads/{self._branch}")
        return str(reference.target) if reference else ""

    def fetch(self) -> str:
        """Bring the branch's tip here and return its commit id."""
        self._fetch([])
        if self._loose > LOOSE_MAX:
            pack_loose(self._repository)
            self._loose = 0
        return self.tip

    def moved_to(self, commit: str) -> None:
        """Note that the branch stands at `commit`, which is here: as if it had been fetched."""
        self._repository.references.create(f"refs/heads/{self._branch}", self._lookup(commit).id, force=True)

    def proposal(self, number: int) -> Commit:
        """The head commit of pull request `number`; brings the branch's tip as well, by the same connection."""
        self._fetch([f"+{self._heads.format(number)}:refs/proposals/{number}"])
        reference = self._repository.references.get(f"refs/proposals/{number}")
        if reference is None:
            raise InputError(f"{self._where}: {self._heads.format(number)} is not there")
        return self.commit(str(reference.target))

    def receive(self, objects: CommitObjects) -> Commit | None:
        """Store commit objects; their commit, when it stands on the branch's tip as it is known here and everything
        that it brings is here now; None: it has to be fetched."""
        self._loose += len(objects.objects)
        return self.commit(objects.commit) if store_objects(self._repository, objects, self.tip) else None

    def contains(self, commit: str) -> bool:
        """Return whether `commit` is the branch's tip or one of its ancestors."""
        git_commit = self._lookup(commit)
        tip = self.tip
        return tip == commit or (tip != "" and self._repository.descendant_of(tip, git_commit.id))

    def _fetch(self, specifications: list[str]) -> None:
        main = f"+refs/heads/{self._branch}:refs/heads/{self._branch}"
        try:
            fetch(self._repository, [main, *specifications], self._account)
        except (pygit2.GitError, PermissionError, OSError) as error:
            raise self._unavailable("fetch", error) from error

    def _unavailable(self, what: str, error: Exception) -> UnavailableError:
        """The error for what libgit2 raised, which calls a refused password `authentication that we do not support`."""
        text = what_failed(error, str(self._repository.remotes[ORIGIN].url))
        if isinstance(error, PermissionError) or "authentication" in text:
            text = f"the forge refuses account {self._account[0]}: its password is wrong, or it is not made yet"
            return AccountRefusedError(f"{self._where}: {what}: {text}")
        return UnavailableError(f"{self._where}: {what}: {text}")

    def commit(self, commit: str) -> Commit:
        """A commit that is here, with its changes to its first parent (all its files when it has none)."""
        git_commit = self._lookup(commit)
        parents = tuple(str(parent) for parent in git_commit.parent_ids)
        return self._with_changes(git_commit, parents, self._lookup(parents[0]).tree if parents else None)

    def changes_since(self, commit: str, base: str) -> Commit:
        """A commit that is here, with everything it changes against `base`, as if that were its parent."""
        return self._with_changes(self._lookup(commit), (base,), self._lookup(base).tree)

    def changes_since_branch(self, commit: str) -> Commit:
        """A commit that is here, with everything it changes since it left the branch, as if that were its parent."""
        git_commit = self._lookup(commit)
        base = self._repository.merge_base(git_commit.id, self._lookup(self.tip).id) if self.tip else None
        if base is None:
            problem = f"has no history in common with {self._branch}; start from its tip"
            raise DocumentError(f"commit {commit}", [problem])
        return self._with_changes(git_commit, (str(base),), self._lookup(str(base)).tree)

    def overlaps(self, change: Commit) -> Sequence[str]:
        """Paths of `change`, whose only parent is where it left the branch, that the branch changed otherwise since."""
        trees = [self._lookup(commit).tree for commit in (change.parents[0], self.tip, change.id)]
        return [path for path in sorted({*change.changes, *change.irregular}) if _overlap(path, *trees)]

    def shape(self, commit: str) -> CommitShape:
        """Parents and tree of a commit that is here."""
        git_commit = self._lookup(commit)
        return CommitShape(tuple(str(parent) for parent in git_commit.parent_ids), str(git_commit.tree_id))

    def still_as_in(self, commit: str) -> Sequence[str]:
        """Paths that `commit`, one of the branch's, changed and that the branch's tip has as it brought them."""
        change = self.commit(commit)
        then, now = self._lookup(commit).tree, self._lookup(self.tip).tree
        return [
            path for path in sorted({*change.changes, *change.irregular}) if _place(then, path) == _place(now, path)
        ]

    def _with_changes(self, commit: pygit2.Commit, parents: tuple[str, ...], before: pygit2.Tree | None) -> Commit:
        changes: dict[str, str | None] = {}
        irregular: list[str] = []
        characters = 0
        for path, blob, mode in self._changes(commit, before):
            text = None if blob is None else self._ordinary_text(blob, mode)
            if blob is not None and text is None:
                irregular.append(path)
            else:
                changes[path] = text
                characters += len(text or "")
            if characters > CHANGED_CHARACTERS_MAX:
                problem = f"brings more than {CHANGED_CHARACTERS_MAX} characters; split it"
                raise DocumentError(f"commit {commit.id}", [problem])
        return Commit(
            id=str(commit.id),
            parents=parents,
            message=commit.message,
            author=commit.author.name,
            changes=changes,
            irregular=tuple(irregular),
        )

    def _changes(self, commit: pygit2.Commit, before: pygit2.Tree | None) -> list[tuple[str, pygit2.Oid | None, int]]:
        """Path, new blob (None = removed) and mode. Compared here and not by libgit2, which first lists everything."""
        changes: list[tuple[str, pygit2.Oid | None, int]] = []
        for count, change in enumerate(_compared(before, commit.tree, "", 0)):
            if change is not None:
                changes.append(change)
            if len(changes) > CHANGED_FILES_MAX or count > CHANGED_ENTRIES_MAX:
                problem = f"changes more than {CHANGED_FILES_MAX} files; split it"
                raise DocumentError(f"commit {commit.id}", [problem])
        return changes

    def _ordinary_text(self, blob: pygit2.Oid, mode: int) -> str | None:
        if mode != FileMode.BLOB:
            return None
        try:
            return self._text(str(blob))
        except (InputError, UnicodeDecodeError):
            return None

    def _read_text(self, blob: str) -> str:
        _, size = self._repository.odb.read_header(blob)  # a small pack can hold gigabytes, which reading would unpack
        content = self._repository[blob] if size <= FILE_BYTES_MAX else None
        if not isinstance(content, pygit2.Blob):
            raise InputError(f"{self._where}: {blob} is not a file of at most {FILE_BYTES_MAX} bytes")
        return bytes(content.data).decode()

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        """Path -> text of every ordinary text file below `folders` in `commit`; others are left out."""
        tree = self._lookup(commit).tree
        files: dict[str, str] = {}
        for folder in folders:
            entry = tree[folder] if folder in tree else None  # noqa: SIM401 - a Tree has no get
            if isinstance(entry, pygit2.Tree):
                self._collect(entry, folder, files)
        return files

    def _collect(self, tree: pygit2.Tree, prefix: str, files: dict[str, str]) -> None:
        for entry in tree:
            path = f"{prefix}/{entry.name}"
            if isinstance(entry, pygit2.Tree):
                self._collect(entry, path, files)
                continue
            text = self._ordinary_text(entry.id, entry.filemode)
            if text is not None:
                files[path] = text

    def irregular(self, commit: str, folders: Sequence[str]) -> Sequence[str]:
        """Paths of the files that `files` leaves out."""
        tree = self._lookup(commit).tree
        paths: list[str] = []
        for folder in folders:
            entry = tree[folder] if folder in tree else None  # noqa: SIM401 - a Tree has no get
            if isinstance(entry, pygit2.Tree):
                self._collect_irregular(entry, folder, paths)
        return paths

    def _collect_irregular(self, tree: pygit2.Tree, prefix: str, paths: list[str]) -> None:
        for entry in tree:
            path = f"{prefix}/{entry.name}"
            if isinstance(entry, pygit2.Tree):
                self._collect_irregular(entry, path, paths)
            elif self._ordinary_text(entry.id, entry.filemode) is None:
                paths.append(path)

    def headers(self, since: str, commits_max: int) -> Iterator[tuple[str, str]]:
        """Id and message of the branch's first-parent commits after `since`, newest first, at most `commits_max`."""
        commit = self.tip
        for _ in range(commits_max):
            if not commit or commit == since:
                return
            git_commit = self._lookup(commit)
            yield commit, git_commit.message
            commit = str(git_commit.parent_ids[0]) if git_commit.parent_ids else ""

    @writes("git")
    def push_main(self, commit: str) -> bool:
        """Move the branch to exactly `commit`, never by force; False when it has moved meanwhile."""
        name = f"refs/pushes/{self._branch}"
        self._repository.references.create(name, commit, force=True)
        connection = GitConnection(self._account)
        try:
            self._repository.remotes[ORIGIN].push([f"{name}:refs/heads/{self._branch}"], callbacks=connection)
        except pygit2.GitError as error:
            if "non-fastforward" in str(error) or "not present locally" in str(error):
                return False
            raise self._not_pushed(commit, error) from error
        except (PermissionError, OSError) as error:
            raise self._unavailable("push", error) from error
        if connection.refusal:
            return self._refused(commit, connection.refusal)
        self.moved_to(commit)
        return True

    def _not_pushed(self, commit: str, error: Exception) -> RobotKubeError:
        """The error for what libgit2 raised at a push: the forge is away, does not know the account, or refuses."""
        if not (status := refused_status(error)):
            return self._unavailable("push", error)
        url = str(self._repository.remotes[ORIGIN].url)
        return self._refusal(commit, refusal_words(status, url, self._account))

    def _refused(self, commit: str, refusal: str) -> bool:
        if self.fetch() == commit:
            return True
        if self.tip not in self._lookup(commit).parent_ids:
            return False
        raise self._refusal(commit, refusal)

    def _refusal(self, commit: str, words: str) -> InputError:
        return InputError(
            f"{self._where}: push of {commit} to {self._branch} refused: {words}; "
            f"account {self._account[0]} must be on the branch's push list (the bootstrap Job sets it)"
        )

    def log(self, since: str | None, commits_max: int) -> Sequence[Commit]:
        """First-parent commits of the branch after `since` (exclusive; None = from the first), the newest `commits_max`
        of them, oldest first."""
        commits: list[Commit] = []
        commit = self.tip
        while commit and commit != since and len(commits) < commits_max:
            commits.append(self.commit(commit))
            commit = commits[-1].parents[0] if commits[-1].parents else ""
        return commits[::-1]

    def touching(self, since: str | None, commits_max: int, path: str, words: Sequence[str]) -> Sequence[Commit]:
        """Those of the newest `commits_max` first-parent commits after `since` that change `path` or whose message
        holds one of `words`, oldest first. Of the others only the message is read."""
        commits: list[Commit] = []
        commit = self.tip
        count = 0
        while commit and commit != since and count < commits_max:
            git_commit = self._lookup(commit)
            parent = self._lookup(str(git_commit.parent_ids[0])) if git_commit.parent_ids else None
            if any(word in git_commit.message for word in words) or _entry(git_commit, path) != _entry(parent, path):
                commits.append(self.commit(commit))
            commit = str(git_commit.parent_ids[0]) if git_commit.parent_ids else ""
            count += 1
        return commits[::-1]

    def _lookup(self, commit: str) -> pygit2.Commit:
        return look_up(self._repository, commit, self._where)


def _entry(commit: pygit2.Commit | None, path: str) -> str:
    """The id of what stands at a path; empty when nothing does."""
    return str(commit.tree[path].id) if commit is not None and path in commit.tree else ""


def _overlap(path: str, base: pygit2.Tree, tip: pygit2.Tree, head: pygit2.Tree) -> bool:
    """Return whether `tip` and `head` both changed what `base` has at `path`, to something different; or `tip` has made
    a file of one of the folders above it."""
    now = _place(tip, path)
    if now not in (_place(base, path), _place(head, path)):
        return True
    above = [path[:index] for index, character in enumerate(path) if character == "/"]
    files = [folder for folder in above if (place := _place(tip, folder)) and place[1] != FileMode.TREE]
    return any(_place(tip, folder) != _place(base, folder) for folder in files)


def _place(tree: pygit2.Tree, path: str) -> tuple[str, int] | None:
    """Id and mode of what stands at a path; None when nothing does."""
    return (str(tree[path].id), int(tree[path].filemode)) if path in tree else None


def _compared(
    before: pygit2.Tree | None, after: pygit2.Tree | None, prefix: str, depth: int
) -> Iterator[tuple[str, pygit2.Oid | None, int] | None]:
    """What differs, file by file: path, new blob and mode; None for every entry that is compared besides."""
    if depth > DEPTH_MAX:
        raise DocumentError(prefix[:200], [f"nested deeper than {DEPTH_MAX} folders; write it flatter"])
    old, new = ({str(entry.name): entry for entry in tree or ()} for tree in (before, after))
    for name in sorted({*old, *new}):
        yield None
        was, is_now = old.get(name), new.get(name)
        if was is not None and is_now is not None and (was.id, was.filemode) == (is_now.id, is_now.filemode):
            continue
        folder, new_folder = (entry if isinstance(entry, pygit2.Tree) else None for entry in (was, is_now))
        if (folder, new_folder) != (None, None):
            yield from _compared(folder, new_folder, f"{prefix}{name}/", depth + 1)
        if is_now is not None and new_folder is None:
            yield f"{prefix}{name}", is_now.id, is_now.filemode
        elif was is not None and folder is None:
            yield f"{prefix}{name}", None, 0
