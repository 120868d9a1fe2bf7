"""What main said of releases and tasks, commit by commit: only its own commits count, not what they joined."""

from __future__ import annotations

from collections.abc import Iterator

import pygit2
import pytest

from scenarios.runner.inputs import MainState
from scenarios.runner.platform.access import Endpoint
from scenarios.runner.platform.deployment import Deployment

MAIN = "refs/heads/main"


class Clone(Deployment):
    """A deployment repository whose commits a test writes."""

    def write(self, tasks: str | None, *parents: str, side: bool = False) -> str:
        """A commit with one release that names `tasks` (None: without the release)."""
        text = f"metadata: {{annotations: {{robotkube.io/tasks: {tasks}}}}}\nspec: {{a: 1}}\n"
        files = {} if tasks is None else {"recorder.yaml": text}
        tree = self._folder_of("releases", self._folder_of("cloud-0", self._files(files)))
        who = pygit2.Signature("somebody", "somebody@forge.invalid")
        made = self._repository.create_commit(None if side else MAIN, who, who, "a commit\n\nwhy\n", tree, [*parents])
        return str(made)

    def _files(self, files: dict[str, str]) -> pygit2.Oid:
        builder = self._repository.TreeBuilder()
        for name, text in files.items():
            builder.insert(name, self._repository.create_blob(text.encode()), pygit2.enums.FileMode.BLOB)
        return builder.write()

    def _folder_of(self, name: str, tree: pygit2.Oid) -> pygit2.Oid:
        builder = self._repository.TreeBuilder()
        builder.insert(name, tree, pygit2.enums.FileMode.TREE)
        return builder.write()


@pytest.fixture
def clone() -> Iterator[Clone]:
    with Clone(Endpoint("127.0.0.1", 1), "person", "password") as cloned:
        yield cloned


def test_each_commit_of_main_says_which_tasks_its_releases_name(clone: Clone) -> None:
    first = clone.write("cloud-0/a")
    never = clone.write("cloud-0/never", first, side=True)
    second = clone.write("cloud-0/a cloud-0/b", first, never)
    third = clone.write(None, second)
    both = {"cloud-0/recorder": ("cloud-0/a", "cloud-0/b")}
    assert clone.history(second) == (MainState(second, both), MainState(third, {}))
    assert clone.history(first)[0] == MainState(first, {"cloud-0/recorder": ("cloud-0/a",)})
    assert [commit.sha for commit in clone.commits()] == [third, second, first]
    assert clone.message(second) == "a commit\n\nwhy\n"
    seen = [document["metadata"]["annotations"]["robotkube.io/tasks"] for _, document in clone.releases_since(first)]
    assert seen == ["cloud-0/a cloud-0/b", "cloud-0/a"]


def test_a_file_that_is_no_release_names_no_task(clone: Clone) -> None:
    broken = clone.write("[")
    assert clone.history(broken) == (MainState(broken, {"cloud-0/recorder": ()}),)
