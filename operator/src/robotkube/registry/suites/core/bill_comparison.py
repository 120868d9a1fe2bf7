"""Compares a bill of materials (CycloneDX) with the image that it is attached to, in both directions.

Compared are Debian packages, Python packages that are installed as wheels, and ELF files by path and digest. What else
a bill names (Go modules, licences, the system) is not looked at; files that are no ELF files need only be there.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.registry.suites.core.image_contents import ImageContents, Package, python_name
from robotkube.registry.suites.core.pod_security import items, mapping

SHOWN_MAX = 5
PACKAGE_URL = re.compile(r"pkg:(deb|pypi)/(?:[^?#]*/)?([^/?#@]+)@([^?#]+)(?:\?([^#]*))?(?:#.*)?")
ESCAPED = re.compile(r"(?:%[0-9A-Fa-f]{2})+")


@dataclass(frozen=True)
class ListedContents:
    """What a bill names, as far as it is compared; `files` is path -> every SHA-256 that it has for it."""

    debian: frozenset[Package]
    sources: frozenset[Package]
    wheels: frozenset[Package]
    files: Mapping[str, Collection[str]]


def differences(bill: Mapping[str, Any], image: ImageContents) -> Iterator[str]:
    """What is on one side only, a sentence for each kind, the first few by name."""
    listed = listed_contents(bill)
    elf = image.elf
    yield from _lacking("Debian package", image.debian - listed.debian)
    yield from _lacking("Python package", image.wheels - listed.wheels)
    yield from _lacking("ELF file", {(path, "") for path in elf.keys() - listed.files.keys()})
    yield from _lacking("ELF file's digest", {(path, "") for path in elf if not listed.files.get(path, "-")})
    others = {(path, "") for path in elf if not {elf[path]}.issuperset(listed.files.get(path, ()))}
    yield from _sentence("has another digest than the image for {}: {}", "ELF file", others)
    yield from _strange("Debian package", listed.debian - image.debian)
    yield from _strange("Debian source package", listed.sources - image.sources)
    yield from _strange("Python package", listed.wheels - image.wheels - image.eggs)
    yield from _strange("file", {(path, "") for path in listed.files.keys() - image.files.keys()})


def listed_contents(bill: Mapping[str, Any]) -> ListedContents:
    """What the components of a bill name, those within others as well."""
    packages: dict[str, set[Package]] = {"deb": set(), "source": set(), "pypi": set()}
    files: dict[str, set[str]] = {}
    waiting = list(items(bill.get("components")))
    while waiting:
        component = waiting.pop()
        waiting += items(component.get("components"))
        match = PACKAGE_URL.fullmatch(str(component.get("purl") or ""))
        if match:
            kind = match[1]
            name = _unescaped(match[2])
            version = _unescaped(match[3])
            is_source = kind == "deb" and "arch=source" in (match[4] or "").split("&")
            packages["source" if is_source else kind].add((python_name(name) if kind == "pypi" else name, version))
        elif component.get("type") == "file":
            path = f"/{str(component.get('name') or '').lstrip('/')}"
            files.setdefault(path, set()).update(_digests(component))
    debian, sources, wheels = (frozenset(packages[kind]) for kind in ("deb", "source", "pypi"))
    return ListedContents(debian, sources, wheels, files)


def _digests(component: Mapping[str, Any]) -> set[str]:
    hashes = [mapping(entry) for entry in items(component.get("hashes"))]
    return {str(entry.get("content")).lower() for entry in hashes if entry.get("alg") == "SHA-256"}


def _unescaped(text: str) -> str:
    def decoded(match: re.Match[str]) -> str:
        return bytes.fromhex(match[0].replace("%", "")).decode("utf-8", errors="replace")

    return ESCAPED.sub(decoded, text)


def _lacking(what: str, missing: Collection[Package]) -> Iterator[str]:
    return _sentence("lacks {} of the image: {}", what, missing)


def _strange(what: str, named: Collection[Package]) -> Iterator[str]:
    return _sentence("names {} that the image does not have: {}", what, named)


def _sentence(words: str, what: str, named: Collection[Package]) -> Iterator[str]:
    if named:
        count = f"{len(named)} {what}{'s' if len(named) > 1 else ''}"
        shown = ", ".join(" ".join(filter(None, one)) for one in sorted(named)[:SHOWN_MAX])
        more = f" and {len(named) - SHOWN_MAX} more" if len(named) > SHOWN_MAX else ""
        yield words.format(count, shown) + more
