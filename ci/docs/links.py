"""Links between the pages of this repository: each leads to a file that is there, and to a heading that it has."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from posixpath import dirname, normpath
from urllib.parse import unquote

from ci.docs import markdown
from ci.errors import InputError
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
        f"{name}:{link.line}: {link.target or 'a link'}: {wrong}"
        for name, text in pages.items()
        for link in markdown.links(text)
        if (wrong := _wrong(name, link, known, folders, reach))
    ]


def resolved(page: str, target: str) -> tuple[str, str]:
    """Path within the repository and anchor that a link of `page` leads to; "." is the repository itself."""
    path, _, anchor = target.partition("#")
    return normpath(f"{dirname(page)}/{unquote(path)}".lstrip("/")) if path else page, unquote(anchor)


def _wrong(page: str, link: markdown.Link, known: set[str], folders: set[str], reach: dict[str, set[str]]) -> str:
    if link.kind == "undefined":
        return "no definition of a link has this name"
    if link.kind == "reference" or ELSEWHERE.match(link.target):
        return ""  # the definition of a reference is a link of its own
    if not link.target:
        return "leads nowhere"
    path, anchor = resolved(page, link.target)
    if path not in known | folders:
        return f"there is no {path}"
    if path in known and link.target.partition("#")[0].endswith("/"):
        return f"{path} is no folder"
    file = normpath(f"{path}/README.md") if path in folders else path
    if anchor and (file in reach or path in folders) and anchor not in reach.get(file, ()):
        return f"{file} has no such heading"
    return ""


def _parents(name: str) -> Iterator[str]:
    while name:
        name = dirname(name)
        yield name or "."


def text(name: str, top: Path = PROJECT) -> str:
    """The text of a page of the repository. InputError, with the fix, when it is none."""
    try:
        return (top / name).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: byte {error.start} is no UTF-8; save the file as UTF-8") from error
    except IsADirectoryError as error:
        raise InputError(f"{name}: this is a folder, or a link to one; a page is a file: rename it") from error


def findings(top: Path = PROJECT) -> list[str]:
    """The broken links of this repository, and the pages that cannot be read."""
    names = files(top)
    unreadable = {}
    for name in sorted(name for name in names if name.endswith(".md")):
        try:
            text(name, top)
        except InputError as error:
            unreadable[name] = str(error)
    return [*unreadable.values(), *broken(names, lambda name: "" if name in unreadable else text(name, top))]
