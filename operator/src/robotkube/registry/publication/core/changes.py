"""The gate's checks of what people propose to the catalogue who are no publishers: policies, applications, withdrawals.

All problems at once, each a sentence for its author. What says that something was verified is the gate's alone: of a
published version a person changes the state, nothing else, and may take files away.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.catalogue.core.sources import Tools
from robotkube.registry.publication.core.submissions import CHARTS, EVIDENCE, KEYS, READ_FOLDERS, new_findings

VERIFIED, WITHDRAWN = "verified", "withdrawn"
SIGNERS = "policies/signers"  # with it the forge's hook would take break-glass here as well


def change_problems(
    changes: Mapping[str, str | None], irregular: Iterable[str], main: Mapping[str, str], tools: Tools
) -> tuple[str, ...]:
    """What is wrong with `changes` (path -> text, None = removed) and the paths of what is no ordinary text file, given
    main's files below READ_FOLDERS."""
    problems = [f"{path}: not an ordinary text file (a link, a program, binary or too long)" for path in irregular]
    if not changes and not problems:
        problems.append("the pull request changes nothing")
    for path, text in sorted(changes.items()):
        problems += _of_the_gate(path, text, main)
    folders = tuple(f"{folder}/" for folder in READ_FOLDERS)
    touched = {path: text for path, text in changes.items() if path.startswith(folders)}
    after = {path: text for path, text in {**main, **touched}.items() if text is not None}
    if touched:
        problems += [f"{path}: {text}" for path, text in new_findings(main, after, touched, tools)]
    return tuple(dict.fromkeys(problems))


def _of_the_gate(path: str, text: str | None, main: Mapping[str, str]) -> Iterable[str]:
    """Problems of a file that is not for people: what a person may do with it is take it away, or withdraw a
    version."""
    folder = path.split("/", 1)[0]
    if text is not None and path == SIGNERS:
        yield f"{path}: break-glass is for the deployment repository, where it stands out afterwards; leave it out"
    if text is None or folder not in (CHARTS, EVIDENCE, KEYS):
        return
    if folder != CHARTS or not path.endswith(".yaml"):
        yield f"{path}: the gate alone writes this file, when it publishes; leave it out"
    elif path not in main:
        yield f"{path}: the gate alone adds chart versions; submit it (robotkube registry submit)"
    elif not _changes_state_alone(main[path], text, path):
        yield (
            f"{path}: a person changes status.state of a published version, to {WITHDRAWN} or back to {VERIFIED}, and "
            "nothing else; submit another version"
        )


def _changes_state_alone(before: str, after: str, path: str) -> bool:
    try:
        old, new = _without_state(read_mapping(before, path)), _without_state(read_mapping(after, path))
    except DocumentError:
        return False
    return old[0] == new[0] and {old[1], new[1]} <= {VERIFIED, WITHDRAWN}


def _without_state(document: Mapping[str, Any]) -> tuple[dict[str, Any], Any]:
    """A document without its state, and the state."""
    status = document.get("status")
    if not isinstance(status, dict):
        return dict(document), None
    rest = {key: value for key, value in status.items() if key != "state"}
    return {**document, "status": rest}, status.get("state") if isinstance(status.get("state"), str) else None
