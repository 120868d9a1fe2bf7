"""What a browser would load from elsewhere when it shows the site: there must be nothing."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

LOADED = {
    "script": ("src",),
    "link": ("href", "imagesrcset"),
    "img": ("src", "srcset"),
    "source": ("src", "srcset"),
    "iframe": ("src",),
    "frame": ("src",),
    "base": ("href",),
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
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
OF_STYLES = re.compile(r"(?:url\(\s*|@import\s*(?=[\"']))[\"']?\s*([^\"')\s;]+)", re.IGNORECASE)
"""Addresses in a style sheet: `url(...)` with and without quotes, wherever it stands, and the text of an `@import`."""

IMAGE_SET = re.compile(r"image-set\(([^;}]*)", re.IGNORECASE)
QUOTED = re.compile(r"[\"']([^\"']*)[\"']")
OF_SCRIPTS = re.compile(
    r"(?:\b(?:import|from|fetch|importScripts|Worker|WebSocket|EventSource|sendBeacon)\s*\(?"
    r"|\.open\(\s*[\"'`]\w+[\"'`]\s*,|\.(?:src|href|action)\s*=|\blocation\s*=)\s*[\"'`]([^\"'`]+)"
)
"""Addresses that a script writes out where it imports, fetches, connects, or sets what an element loads."""

REFRESH = re.compile(r"\burl\s*=\s*[\"']?([^\"']+)", re.IGNORECASE)


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.foreign: list[str] = []
        self.within = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.within = tag
        self.foreign += in_style(given.get("style", "")) + in_page(given.get("srcdoc", ""))
        self.foreign += [
            address for name, value in given.items() if name.startswith("on") for address in in_script(value)
        ]
        if tag == "meta" and given.get("http-equiv", "").strip().lower() == "refresh":
            self.foreign += _foreign(REFRESH.findall(given.get("content", "")))
        if tag == "link" and set(given.get("rel", "").split()) <= SHOWN_ONLY:
            return
        for attribute in LOADED.get(tag, ()):
            value = given.get(attribute, "")
            addresses = value.split(",") if attribute.endswith("srcset") else [value]
            self.foreign += [f"<{tag} {attribute}> {address}" for address in _foreign(addresses)]

    def handle_endtag(self, tag: str) -> None:
        self.within = ""

    def handle_data(self, data: str) -> None:
        if self.within == "style":
            self.foreign += in_style(data)
        if self.within == "script":
            self.foreign += in_script(data)


def _foreign(addresses: list[str]) -> list[str]:
    return [address.strip() for address in addresses if ELSEWHERE.match(address)]


def in_page(html: str) -> list[str]:
    """What a page would load from elsewhere."""
    page = _Page()
    page.feed(html)
    page.close()
    return page.foreign


def in_style(css: str) -> list[str]:
    """What a style sheet would load from elsewhere."""
    rules = COMMENT.sub(" ", css)
    quoted = [
        address for images in IMAGE_SET.findall(rules) for address in QUOTED.findall(re.sub(r"url\(.*?\)", "", images))
    ]
    return _foreign(OF_STYLES.findall(rules) + quoted)


def in_script(code: str) -> list[str]:
    """What a script would load from elsewhere, as far as it writes addresses out."""
    return _foreign(OF_SCRIPTS.findall(code))


def findings(site: Path) -> Iterator[str]:
    """`file: what` for everything that the pages, style sheets and scripts below a folder would load from elsewhere."""
    for suffix, foreign_in in ((".html", in_page), (".css", in_style), (".js", in_script)):
        for path in sorted(site.rglob(f"*{suffix}")):
            for address in foreign_in(path.read_text(encoding="utf-8")):
                yield f"{path.relative_to(site)}: {address}"
