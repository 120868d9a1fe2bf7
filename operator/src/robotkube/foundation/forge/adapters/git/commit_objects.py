"""Commit objects, which go from one clone to another without the forge: collecting and storing them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pygit2
from pygit2.enums import ObjectType

from robotkube.foundation.forge.core.commit_objects import BYTES_MAX, OBJECTS_MAX, CommitObjects, object_id

TYPES = {"commit": ObjectType.COMMIT, "tree": ObjectType.TREE, "blob": ObjectType.BLOB}
KINDS = {int(number): kind for kind, number in TYPES.items()}
LOOSE_MAX = 500  # objects that were stored as files of their own; of more, a pack is made


def new_objects(repository: pygit2.Repository, commit: pygit2.Commit) -> CommitObjects | None:
    """`commit` and what it brings that its first parent has not; None when that is more than may be sent."""
    before = commit.parents[0].tree if commit.parents else None
    identifiers = [commit.id, *islice(_new_ids(commit.tree, before), OBJECTS_MAX)]
    if len(identifiers) > OBJECTS_MAX:
        return None
    objects = []
    total = 0
    for identifier in dict.fromkeys(identifiers):
        total += repository.odb.read_header(identifier)[1]
        if total > BYTES_MAX:
            return None
        kind, content = repository.odb.read(identifier)
        objects.append((KINDS[int(kind)], content))
    return CommitObjects(str(commit.id), tuple(objects))


def store_objects(repository: pygit2.Repository, received: CommitObjects, tip: str) -> bool:
    """Store the objects: whether their commit stands on `tip` alone and everything that it brings is here now. The
    commit itself is written last: what has it asks the forge for nothing below it, so that what is missing would stay
    so."""
    odb = repository.odb
    content = next(content for kind, content in received.objects if object_id(kind, content) == received.commit)
    tree, parents = _header(content)
    if parents != [tip] or tree is None:
        return False
    try:
        for kind, other in received.objects:
            if kind != "commit":
                odb.write(TYPES[kind], other)
        after = repository[tree]
        before = repository[tip]
        if not isinstance(after, pygit2.Tree) or not isinstance(before, pygit2.Commit):
            return False
        identifiers = list(islice(_new_ids(after, before.tree), OBJECTS_MAX + 1))
        if len(identifiers) > OBJECTS_MAX or not all(identifier in odb for identifier in identifiers):
            return False
        odb.write(TYPES["commit"], content)
    except (KeyError, ValueError, pygit2.GitError):  # what is missing, or no object of its kind
        return False
    return True


def _header(commit: bytes) -> tuple[str | None, list[str]]:
    """Ids of the tree and of the parents that the content of a commit names."""
    lines = commit.partition(b"\n\n")[0].decode(errors="replace").split("\n")
    parents = [line.removeprefix("parent ") for line in lines if line.startswith("parent ")]
    return lines[0].removeprefix("tree ") if lines[0].startswith("tree ") else None, parents


def _new_ids(after: pygit2.Tree, before: pygit2.Tree | None) -> Iterator[pygit2.Oid]:
    """Ids of `after` and of everything below it that does not stand at the same place in `before`; some twice."""
    yield after.id
    for entry in after:
        name = str(entry.name)
        was = before[name] if before is not None and name in before else None
        if was is not None and was.id == entry.id:
            continue
        if isinstance(entry, pygit2.Tree):
            yield from _new_ids(entry, was if isinstance(was, pygit2.Tree) else None)
        else:
            yield entry.id


def pack_loose(repository: pygit2.Repository) -> None:
    """Pack the objects that are files of their own, each of which occupies a block of the disk."""
    loose = list(Path(repository.path).glob("objects/??/*"))
    builder = pygit2.PackBuilder(repository)
    for path in loose:
        builder.add(pygit2.Oid(hex=path.parent.name + path.name))
    builder.write()
    for path in loose:
        path.unlink()
