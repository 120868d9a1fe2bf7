"""Links between the pages of this repository: each leads to a file that is there, and to a heading that it has."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from posixpath import dirname, normpath
from urllib.parse import unquote

from ci import markdown
from ci.folders import PROJECT

ELSEWHERE = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:|//")


def files(top: Path = PROJECT) -> set[str]:
    """Files of the repository and those that could be added to it, by path; what Git ignores is not among them."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=top, capture_output=True, text=True, check=True, timeout=60)
    return {name for name in listed.stdout.split("\0") if name and (top / name).exists()}


def broken(known: set[str], read: Callable[[str], str]) -> list[str]:
    """`page:line: what is wrong` for each broken link of each page among the `known` files; `read` gives their text."""
    folders = {folder for name in known for folder in _parents(name)}
    pages = {name: read(name) for name in sorted(known) if name.endswith(".md")}
    reach = {name: markdown.anchors(text) for name, text in pages.items()}
    return [
        f"{name}:{link.line}: {link.target}: {wrong}"
        for name, text in pages.items()
        for link in markdown.links(text)
        if (wrong := _wrong(name, link.target, known | folders, reach))
    ]


def resolved(page: str, target: str) -> tuple[str, str]:
    """Path within the repository and anchor that a link of `page` leads to; "." is the repository itself."""
    path, _, anchor = target.partition("#")
    return normpath(f"{dirname(page)}/{unquote(path)}".lstrip("/")) if path else page, unquote(anchor)


def _wrong(page: str, target: str, known: set[str], reach: dict[str, set[str]]) -> str:
    if ELSEWHERE.match(target):
        return ""
    path, anchor = resolved(page, target)
    if path not in known:
        return f"there is no {path}"
    if anchor and path in reach and anchor not in reach[path]:
        return f"{path} has no such heading"
    return ""


def _parents(name: str) -> Iterator[str]:
    while name:
        name = dirname(name)
        yield name or "."


def findings() -> list[str]:
    """The broken links of this repository."""
    return broken(files(), lambda name: (PROJECT / name).read_text(encoding="utf-8"))
