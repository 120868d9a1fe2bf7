"""What a browser would load from elsewhere when it shows the site: there must be nothing."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

LOADED = {
    "script": ("src",),
    "link": ("href",),
    "img": ("src", "srcset"),
    "source": ("src", "srcset"),
    "iframe": ("src",),
    "embed": ("src",),
    "object": ("data",),
    "video": ("src", "poster"),
    "audio": ("src",),
    "track": ("src",),
    "use": ("href", "xlink:href"),
    "image": ("href", "xlink:href"),
    "input": ("src",),
    "form": ("action",),
}
"""Tags and those of their attributes whose address a browser fetches; those of `a` wait for a person."""

SHOWN_ONLY = {"canonical", "alternate", "author", "license", "next", "prev", "edit"}
"""Relations of a `link` that are not fetched."""

ELSEWHERE = re.compile(r"^\s*(?:[a-z][a-z0-9+.-]*:)?//", re.IGNORECASE)
OF_STYLES = re.compile(r"(?:url\(\s*|@import\s+)[\"']?([^\"')\s;]+)", re.IGNORECASE)


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.styling = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.styling = tag == "style"
        self.found += _foreign(OF_STYLES.findall(given.get("style", "")))
        if tag == "link" and set(given.get("rel", "").split()) <= SHOWN_ONLY:
            return
        for attribute in LOADED.get(tag, ()):
            addresses = given.get(attribute, "").split(",") if attribute == "srcset" else [given.get(attribute, "")]
            self.found += [f"<{tag} {attribute}> {address}" for address in _foreign(addresses)]

    def handle_endtag(self, tag: str) -> None:
        self.styling = self.styling and tag != "style"

    def handle_data(self, data: str) -> None:
        if self.styling:
            self.found += _foreign(OF_STYLES.findall(data))


def _foreign(addresses: list[str]) -> list[str]:
    return [address.strip() for address in addresses if ELSEWHERE.match(address)]


def in_page(html: str) -> list[str]:
    """What a page would load from elsewhere."""
    page = _Page()
    page.feed(html)
    page.close()
    return page.found


def in_style(css: str) -> list[str]:
    """What a style sheet would load from elsewhere."""
    return _foreign(OF_STYLES.findall(css))


def findings(site: Path) -> Iterator[str]:
    """`file: what` for everything that the pages and style sheets below a folder would load from elsewhere."""
    for suffix, foreign_in in ((".html", in_page), (".css", in_style)):
        for path in sorted(site.rglob(f"*{suffix}")):
            for address in foreign_in(path.read_text(encoding="utf-8")):
                yield f"{path.relative_to(site)}: {address}"
