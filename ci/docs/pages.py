"""The pages of the site, from those of the repository: same folders, so links between pages nearly stay as they are.

A README is the index of its folder. A link to what is no page (a chart's values, a test) becomes a link to the forge
when its address is given, else the name of the file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from posixpath import basename, dirname

from ci.docs import markdown
from ci.docs.links import ELSEWHERE, resolved
from ci.errors import SetUpError

Read = Callable[[str], str]

LEFT_OUT = ("operator/src/",)
"""Pages that are no documentation: files for others to start from."""

TOP = "README.md"
PICTURES = "docs/images/"
SECTIONS = {
    "Tutorials": ("docs/tutorials/first-hour.md", "docs/tutorials/use-case.md", "docs/tutorials/"),
    "How-to": ("docs/how-to/",),
    "Explanation": ("docs/explanation/architecture.md", "docs/explanation/"),
    "Reference": ("docs/reference/",),
    "Decisions": ("docs/decisions/README.md", "docs/decisions/"),
    "Charts": ("charts/robotkube/", "charts/apps/", "charts/"),
    "Project": ("CHANGELOG.md", "UPGRADING.md", "CONTRIBUTING.md", "SECURITY.md", ""),
}
"""Titles of the contents, and the beginnings of paths below them, in order; a page stands where it fits first."""

CONTENTS = """
```{{toctree}}
:hidden:
:caption: {title}

{entries}
```
"""


@dataclass(frozen=True)
class Repository:
    """Its files by path, and the address below which a forge shows them; empty when there is none."""

    files: frozenset[str]
    address: str = ""

    def pages(self) -> list[str]:
        return sorted(name for name in self.files if name.endswith(".md") and not name.startswith(LEFT_OUT))

    def pictures(self) -> list[str]:
        """What pages show; in the site they stand where they stand here."""
        return sorted(name for name in self.files if name.startswith(PICTURES))


def site(repository: Repository, read: Read) -> dict[str, str]:
    """Path in the site -> text of every page; the first page also has the contents."""
    pages = repository.pages()
    if TOP not in pages:
        raise SetUpError(
            f"the repository has no {TOP}, the first page of the site; add it, or run in the whole checkout"
        )
    there = frozenset([*pages, *repository.pictures()])
    texts = {place(name): linked(name, read(name), there, repository.address) for name in pages}
    for title, names in contents(pages).items():
        texts[place(TOP)] += CONTENTS.format(title=title, entries="\n".join(map(_entry, names)))
    return texts


def place(name: str) -> str:
    """The place of a page of the repository in the site, and what a link to it has to name."""
    folder, _, file = name.rpartition("/")
    return f"{folder}/index.md".lstrip("/") if file == TOP else name


def linked(page: str, text: str, there: frozenset[str], address: str = "") -> str:
    """The text of a page with links that lead somewhere in the site; `there` are its pages and pictures."""
    parts = []
    end = 0
    for link in sorted(markdown.links(text), key=lambda link: link.start):
        new = _link(page, link, there, address) if link.kind in ("inline", "reference") else ""
        if new and link.start >= end:
            parts += [text[end : link.start], new]
            end = link.end
    return "".join([*parts, text[end:]])


def _link(page: str, link: markdown.Link, there: frozenset[str], address: str) -> str:
    """What stands for a link; empty when it stays."""
    file, hash_sign, anchor = link.target.partition("#")
    if not file or ELSEWHERE.match(link.target):
        return ""
    path, _ = resolved(page, link.target)
    if path in there:
        return f"[{link.label}]({_target(place(file) + hash_sign + anchor)})"
    if f"{path}/{TOP}".removeprefix("./") in there:
        index = f"{file.rstrip('/')}/{place(TOP)}{hash_sign}{anchor}"
        return f"[{link.label}]({_target(index)})"
    if address:
        return f"[{link.label}]({_target(address.rstrip('/') + '/' + path)})"
    return f"`{path}`" if link.label.strip("`") == path else f"{link.label} (`{path}`)"


def _target(address: str) -> str:
    """An address as it stands in a link."""
    return f"<{address}>" if set(address) & set(" ()") else address


def contents(pages: Iterable[str]) -> dict[str, list[str]]:
    """Title of a section -> its pages; every page but the first stands in one."""
    left = [name for name in sorted(pages) if name != TOP]
    sections: dict[str, list[str]] = {}
    for title, beginnings in SECTIONS.items():
        names = [name for beginning in beginnings for name in left if name.startswith(beginning)]
        sections[title] = list(dict.fromkeys(names))
        left = [name for name in left if name not in sections[title]]
    return {title: names for title, names in sections.items() if names}


def _entry(name: str) -> str:
    """A page by its own title; a folder's README outside of docs/ by the folder, since many have the same title."""
    document = "/" + place(name).removesuffix(".md")
    named = basename(name) == TOP and not name.startswith("docs/")
    return f"{dirname(name)} <{document}>" if named else document
