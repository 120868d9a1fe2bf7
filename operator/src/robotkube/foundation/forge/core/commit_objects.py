"""Commit objects: the Git objects of a proposal, which a proposer sends the gate in addition to its push, as JSON.

    {"repository": "robotkube/deployment", "commit": "<40 hex>",
     "objects": [{"kind": "commit" | "tree" | "blob", "content": "<base64>"}, ...]}

An object's id follows from its content, so no object can replace another.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.json_codec import read_json

KINDS = ("commit", "tree", "blob")
OBJECTS_MAX = 1000  # a plan for 100 tasks has about 300
BYTES_MAX = 1024 * 1024  # of all contents
WHERE = "commit objects"


@dataclass(frozen=True)
class CommitObjects:
    """The objects of a commit: `commit` is the id of one of `objects`, which are kind and content."""

    commit: str
    objects: tuple[tuple[str, bytes], ...]


def object_id(kind: str, content: bytes) -> str:
    """The id that Git gives to an object."""
    return hashlib.sha1(b"%s %d\0%s" % (kind.encode(), len(content), content), usedforsecurity=False).hexdigest()


def write_objects(sent: CommitObjects, repository: str) -> bytes:
    """The JSON; `repository` is `<organisation>/<name>`."""
    objects = [{"kind": kind, "content": base64.b64encode(content).decode()} for kind, content in sent.objects]
    return json.dumps({"repository": repository, "commit": sent.commit, "objects": objects}).encode()


def read_objects(body: bytes, repository: str) -> CommitObjects:
    """The objects for `repository` in the JSON; DocumentError lists every problem."""
    try:
        document = read_json(body)
    except ValueError as error:
        raise DocumentError(WHERE, [f"the body is not readable as JSON: {error}"]) from error
    if not isinstance(document, Mapping):
        raise DocumentError(WHERE, ["the body must be a JSON object"])
    items = document.get("objects")
    if not isinstance(items, list) or not 0 < len(items) <= OBJECTS_MAX:
        raise DocumentError(WHERE, [f"objects: must be a list of 1 to {OBJECTS_MAX} objects; let the rest be fetched"])
    problems: list[str] = []
    received = CommitObjects(str(document.get("commit")), tuple(_objects(items, problems)))
    if document.get("repository") != repository:
        problems.append(f"repository: must be {repository}")
    if sum(len(content) for _, content in received.objects) > BYTES_MAX:
        problems.append(f"objects: more than {BYTES_MAX} bytes; let them be fetched")
    if not problems and received.commit not in (object_id(*pair) for pair in received.objects if pair[0] == "commit"):
        problems.append("commit: must be the id of one of objects, of kind commit")
    if problems:
        raise DocumentError(WHERE, problems)
    return received


def _objects(items: list[Any], problems: list[str]) -> Iterator[tuple[str, bytes]]:
    for index, item in enumerate(items):
        entry = item if isinstance(item, Mapping) else {}
        kind = entry.get("kind")
        content = entry.get("content")
        if kind not in KINDS:
            problems.append(f"objects[{index}].kind: must be one of {', '.join(KINDS)}")
            continue
        try:
            yield kind, base64.b64decode(content if isinstance(content, str) else "!", validate=True)
        except ValueError:
            problems.append(f"objects[{index}].content: must be text in base64")
