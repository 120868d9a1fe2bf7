"""Files of the repository before and after a run: tests leave all of them as they were.

Compared is what git does not ignore, by content, whatever is committed meanwhile. What tests write goes into folders
for temporary files, into `build`, or into the cache folder. Files that git had before are told from others: who runs
the tests may keep what they print beside them.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path

LISTED = ("git", "ls-files", "-z", "--exclude-standard")
KINDS = ("--cached", "--others")
LIST_SECONDS_MAX = 60
NAMED_MAX = 20
REMEDY = (
    "a test that writes below the repository writes to tmp_path or build instead; whoever edits files while tests run "
    "does so in another working tree (git worktree add), or runs the tests again"
)


@dataclass(frozen=True)
class Files:
    """What each file of a folder holds, as a digest, and which of them git has; `unread` says why that is not known,
    empty when it is."""

    digests: Mapping[str, str] = field(default_factory=dict)
    kept: Set[str] = frozenset()
    unread: str = ""


def read(folder: Path) -> Files:
    """The files of a git checkout, those that are not added yet too; of another folder none, and why."""
    listed: dict[str, list[str]] = {}
    for kind in KINDS:
        try:
            done = subprocess.run(
                (*LISTED, kind), cwd=folder, capture_output=True, timeout=LIST_SECONDS_MAX, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return Files(unread=f"git cannot be asked for its files: {error}")
        listed[kind] = [os.fsdecode(name) for name in done.stdout.split(b"\0") if name]
        if done.returncode or (kind == "--cached" and not listed[kind]):
            reason = done.stderr.decode(errors="replace").strip().partition("\n")[0] or "git has no file of it"
            return Files(unread=f"it is no git checkout ({reason})")
    names = sorted({name for each in listed.values() for name in each})
    digests = {name: digest for name in names if (digest := _digest(folder / name))}
    return Files(digests, frozenset(listed["--cached"]))


def _digest(path: Path) -> str:
    """What a file is and holds; empty where none is."""
    try:
        if path.is_symlink():
            return f"link to {path.readlink()}"
        if path.is_dir():
            return "repository"  # one within this one: git names its folder, and looks no further
        kind = "program" if path.stat().st_mode & 0o100 else "file"
        return f"{kind} {hashlib.sha256(path.read_bytes()).hexdigest()}"
    except (FileNotFoundError, NotADirectoryError):
        return ""
    except OSError as error:
        return f"unreadable: {error.strerror}"


def difference(before: Files, after: Files) -> str:
    """Which files that git had are not as they were, and what to do, in one sentence; empty when all are, or nobody
    knows."""
    if not before.unread and after.unread:
        return f"git named {len(before.digests):,} files before the tests, and none since: {after.unread}"
    return _sentence_of(before, after, before.kept)


def difference_of_others(before: Files, after: Files) -> str:
    """The same of the files that git did not have before."""
    return _sentence_of(before, after, (before.digests.keys() | after.digests.keys()) - before.kept)


def _sentence_of(before: Files, after: Files, names: Set[str]) -> str:
    if before.unread or after.unread:
        return ""
    became = _changes(*({name: one.digests[name] for name in names & one.digests.keys()} for one in (before, after)))
    if not became:
        return ""
    more = f", and {len(became) - NAMED_MAX:,} more" if len(became) > NAMED_MAX else ""
    return f"{', '.join(became[:NAMED_MAX])}{more} while the tests ran; {REMEDY}"


def _changes(before: Mapping[str, str], after: Mapping[str, str]) -> list[str]:
    """Each file that is not as it was, with what became of it."""
    what = {
        name: "made" if name not in before else "removed" if name not in after else "changed"
        for name in sorted(before.keys() | after.keys())
        if before.get(name) != after.get(name)
    }
    return [f"{name.encode(errors='backslashreplace').decode()} was {became}" for name, became in what.items()]
