"""The audit as one HTML file for an auditor: nothing to load, no scripts, light or dark as the reader's screen is.

Everything that the document says is escaped: names and messages in Git are anybody's words.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

TEMPLATE = "audit_page.html.jinja"


def page(document: Mapping[str, Any]) -> str:
    """The page of an audit's document."""
    concerning = [one for one in document["findings"] if one["concerns"]]
    others = [one for one in document["findings"] if not one["concerns"]]
    return (
        _environment()
        .get_template(TEMPLATE)
        .render(document=document, concerning=concerning, others=others, title=document["asked"] or "all of main")
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"short": _short, "moment": _moment, "image": _image}
    return environment


def _short(digest: object) -> str:
    """A commit's or digest's first 12 digits."""
    return str(digest).removeprefix("sha256:")[:12]


def _moment(time: object) -> str:
    """A time as people read it; fractions of seconds go."""
    return str(time).replace("T", " ").partition(".")[0].removesuffix("Z")


def _image(reference: object) -> str:
    """An image's name and the beginning of its digest."""
    name, _, digest = str(reference).partition("@")
    return f"{name.rpartition('/')[2]}@{_short(digest)}"
