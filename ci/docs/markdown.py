"""Markdown as forges read it: what each line is, the links and anchors of a page, and its text in lines of 120.

Everything here takes the text of a page and looks at nothing else.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from html.parser import HTMLParser
from itertools import pairwise
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.rules_inline import StateInline, html_inline, image, link
from markdown_it.token import Token

WIDTH = 120

NEWLINE = re.compile(r"\r\n?|\n")
ITEM = re.compile(r"^(?P<prefix> *(?:[-*+]|\d{1,9}[.)]) +)\S")
CODE_SPAN = re.compile(r"(?<!`)(`+)(?!`)(?:(?!\n[ \t]*\n).)+?(?<!`)\1(?!`)", re.DOTALL)
UNBREAKABLE = re.compile(rf"{CODE_SPAN.pattern}|\]\([^()\n]*\)", re.DOTALL)
BEGINS_A_BLOCK = re.compile(r"[-+*]$|\d{1,9}[.)]$|#{1,6}$|[=-]+$|>|\||```|~~~|<[A-Za-z/!]")
"""A word that would be read as the mark of a list, heading, quote, table, fence or of HTML at the start of a line."""

KINDS = {
    "paragraph_open": "text",
    "list_item_open": "item",
    "heading_open": "heading",
    "table_open": "table",
    "blockquote_open": "quote",
    "html_block": "html",
    "fence": "code",
    "code_block": "code",
    "hr": "rule",
}
SHOWN = {"text", "code_inline", "softbreak"}
ADDRESSES = {"a": "href", "img": "src"}


@dataclass(frozen=True)
class Line:
    """One line. `kind`: text, item (the first line of one), heading, table, quote, html, code (fences and indented),
    rule (between two parts of a page), definition (of a link) or blank."""

    number: int
    text: str
    kind: str


@dataclass(frozen=True)
class Link:
    """A link or an image: where it stands in the text, what it shows, where it leads.

    `kind`: inline (`[a](b)`), reference (`[a][b]`), definition (`[b]: c`), undefined (a reference to no definition; the
    target is its name) or html. `start` is -1 where the place in the text is not known, as in HTML and definitions.
    """

    start: int
    end: int
    line: int
    label: str
    target: str
    kind: str


@dataclass(frozen=True)
class _Parsed:
    tokens: Sequence[Token]
    environment: dict[str, Any]


@dataclass(frozen=True)
class _Tag:
    line: int
    name: str
    attributes: dict[str, str]


def _placed_link(state: StateInline, silent: bool) -> bool:
    """The rule for links, which also notes where each stands, and each reference that is defined nowhere."""
    start = state.pos
    before = len(state.tokens)
    shown = link(state, silent)
    if silent:
        return shown
    if shown:
        _note(state, start, before, "link_open")
    elif undefined := _undefined(state, start):
        state.push("undefined_reference", "", 0).meta = undefined
    return shown


def _placed_image(state: StateInline, silent: bool) -> bool:
    """The rule for images, which also notes where each stands."""
    start = state.pos + 1
    before = len(state.tokens)
    shown = image(state, silent)
    if shown and not silent:
        _note(state, start, before, "image")
    return shown


def _placed_html(state: StateInline, silent: bool) -> bool:
    """The rule for HTML in a text, which also notes where each tag stands."""
    start = state.pos
    shown = html_inline(state, silent)
    if shown and not silent:
        state.tokens[-1].meta = {"start": start}
    return shown


def _note(state: StateInline, start: int, before: int, kind: str) -> None:
    token = next(token for token in state.tokens[before:] if token.type == kind)
    token.meta = {"start": start, "label_end": _closing(state, start), "end": state.pos}


def _undefined(state: StateInline, start: int) -> dict[str, Any] | None:
    """A reference `[label][name]` or `[name][]` at this place; a name alone in brackets is text."""
    label_end = _closing(state, start) if state.src[start] == "[" else -1
    if not (start < label_end and state.src.startswith("[", label_end + 1)):
        return None
    end = _closing(state, label_end + 1)
    name = state.src[label_end + 2 : end] or state.src[start + 1 : label_end]
    if end < 0 or not name.strip():
        return None
    return {"start": start, "label_end": label_end, "end": end + 1, "name": name}


def _closing(state: StateInline, start: int) -> int:
    """The place of the bracket that closes the one at `start`; -1 when there is none."""
    return int(state.md.helpers.parseLinkLabel(state, start))


def _parser() -> MarkdownIt:
    parser = MarkdownIt("commonmark").enable("table")
    parser.inline.ruler.at("link", _placed_link)
    parser.inline.ruler.at("image", _placed_image)
    parser.inline.ruler.at("html_inline", _placed_html)
    parser.normalizeLink = lambda url: url  # type: ignore[method-assign]
    return parser


PARSER = _parser()


@lru_cache(maxsize=512)
def _parsed(text: str) -> _Parsed:
    environment: dict[str, Any] = {}
    return _Parsed(PARSER.parse(text, environment), environment)


def lines(text: str) -> list[Line]:
    """Every line with its kind."""
    rows = text.splitlines()
    kinds = ["text" if row.strip() else "blank" for row in rows]
    parsed = _parsed("\n".join(rows))
    for token in parsed.tokens:
        kind = KINDS.get(token.type, "")
        if kind and token.map:
            _mark(kinds, rows, kind, range(token.map[0], min(token.map[1], len(rows))))
    for definition in _definitions(parsed):
        for number in range(*definition["map"]):
            kinds[number] = "definition"
    return [Line(number, row, kind) for number, (row, kind) in enumerate(zip(rows, kinds, strict=True), 1)]


def _mark(kinds: list[str], rows: Sequence[str], kind: str, numbers: range) -> None:
    """Give the lines of a block its kind; the text of a quote is part of it, and of an item the first line is."""
    for number in numbers:
        if kind == "item":
            kinds[number] = kind if number == numbers.start else kinds[number]
        elif kind == "text":
            kinds[number] = kind if kinds[number] not in ("item", "quote") else kinds[number]
        elif rows[number].strip() or kind == "code":
            kinds[number] = kind


def _definitions(parsed: _Parsed) -> list[dict[str, Any]]:
    """Every definition of a link, also a second one of the same name."""
    environment = parsed.environment
    return [*environment.get("references", {}).values(), *environment.get("duplicate_refs", [])]


def wrapped(text: str, width: int = WIDTH) -> str:
    """The page with each paragraph that has a line of more than `width` characters set anew, word by word.

    Shown it is the same. Tables, code, headings and HTML stay as they are, and so does a paragraph with a forced line
    break. Code within the text and targets of links are not broken. Wrapping what was wrapped changes nothing.
    """
    result: list[str] = []
    paragraph: list[Line] = []
    for line in lines(text):
        if line.kind == "text" and paragraph:
            paragraph.append(line)
            continue
        result += _set(paragraph, width)
        paragraph = [line] if line.kind in ("text", "item") else []
        result += [] if paragraph else [line.text]
    return "\n".join([*result, *_set(paragraph, width)]) + ("\n" if text.endswith("\n") else "")


def _set(paragraph: Sequence[Line], width: int) -> list[str]:
    """The lines of a paragraph; all of them anew when one is too long."""
    unchanged = [line.text for line in paragraph]
    if all(len(line) <= width for line in unchanged):
        return unchanged
    item = ITEM.match(unchanged[0])
    forced = any(line.endswith(("  ", "\\")) for line in unchanged[:-1])
    nested = item and BEGINS_A_BLOCK.match(unchanged[0][len(item["prefix"]) :].split(" ")[0])
    if forced or nested:
        return unchanged
    first = item["prefix"] if item else unchanged[0][: len(unchanged[0]) - len(unchanged[0].lstrip())]
    result = [first]
    for word in words(" ".join([unchanged[0][len(first) :], *unchanged[1:]])):
        line = result[-1]
        if line == first:
            result[-1] = f"{first}{word}"
        elif len(line) + 1 + len(word) > width:
            result.append(" " * len(first) + word)
        else:
            result[-1] = f"{line} {word}"
    return result


def words(text: str) -> list[str]:
    """The parts of a text between which a line may end. A word that would begin a block belongs to the one before, and
    one that would force a break at the end of a line to the one behind."""
    kept = UNBREAKABLE.sub(lambda match: re.sub(r"\s+", "\0", match[0]), text)
    parts: list[str] = []
    for word in kept.split():
        if parts and (BEGINS_A_BLOCK.match(word) or parts[-1].endswith("\\")):
            parts[-1] += f"\0{word}"
        else:
            parts.append(word)
    return [part.replace("\0", " ") for part in parts]


def too_long(text: str, width: int = WIDTH) -> Iterator[Line]:
    """Lines of more than `width` characters that could be shorter: none of tables and code, nor a single word."""
    for line in lines(text):
        if len(line.text) > width and line.kind not in ("table", "code"):
            item = ITEM.match(line.text)
            if line.kind in ("heading", "html") or len(words(line.text[len(item["prefix"]) if item else 0 :])) > 1:
                yield line


def anchors(text: str) -> set[str]:
    """The anchors of a page as forges make them: of its headings, and those it sets itself."""
    seen: Counter[str] = Counter()
    tokens = _parsed(text).tokens
    names = {tag.attributes.get(key, "") for token in tokens for tag in _tags(token) for key in ("id", "name")} - {""}
    for opening, inline in pairwise(tokens):
        if opening.type == "heading_open":
            slug = re.sub(r"[^\w\- ]", "", _shown(inline).lower()).replace(" ", "-")
            names.add(f"{slug}-{seen[slug]}" if seen[slug] else slug)
            seen[slug] += 1
    return names


def _shown(heading: Token) -> str:
    """The text of a heading without its marks."""
    parts = heading.children or ()
    return "".join(" " if part.type == "softbreak" else part.content for part in parts if part.type in SHOWN)


def links(text: str) -> list[Link]:
    """The links of a page, in order; what stands in code is none."""
    parsed = _parsed(text)
    of_html = [
        Link(-1, -1, tag.line, "", tag.attributes[ADDRESSES[tag.name]], "html")
        for token in parsed.tokens
        for tag in _tags(token)
        if ADDRESSES.get(tag.name, "") in tag.attributes
    ]
    definitions = [
        Link(-1, -1, definition["map"][0] + 1, "", definition["href"], "definition")
        for definition in _definitions(parsed)
    ]
    return sorted((*_written(text, parsed), *of_html, *definitions), key=lambda link: (link.line, link.start))


def _written(text: str, parsed: _Parsed) -> Iterator[Link]:
    """Links and images in the text of a page, with their places; one within another follows it."""
    rows = NEWLINE.split(text)
    starts = [0, *(newline.end() for newline in NEWLINE.finditer(text))]
    cell_end = 0  # behind the cell before, in a table
    for before, token in pairwise(parsed.tokens):
        if before.type == "tr_open":
            cell_end = 0
        if token.type != "inline" or not token.map:
            continue
        in_table = before.type in ("th_open", "td_open")
        places = _places(token.content, rows[token.map[0] :], starts[token.map[0] :], cell_end if in_table else None)
        cell_end = max([cell_end, *(place + 1 - starts[token.map[0]] for place in places[:-1][-1:])])
        for part in token.children or ():
            if "label_end" in part.meta:
                yield _link(text, token, part, places)


def _link(text: str, block: Token, part: Token, places: Sequence[int]) -> Link:
    """A link whose places in the text of its block were noted."""
    start, label_end, end = part.meta["start"], part.meta["label_end"], part.meta["end"]
    known = -1 not in (places[start], places[label_end], places[end - 1])
    kind = "inline" if block.content[end - 1] == ")" else "reference"
    return Link(
        places[start] if known else -1,
        places[end - 1] + 1 if known else -1,
        (block.map or [0])[0] + 1 + block.content.count("\n", 0, start),
        text[places[start] + 1 : places[label_end]] if known else block.content[start + 1 : label_end],
        part.meta.get("name") or str(part.attrGet("src" if part.type == "image" else "href") or ""),
        "undefined" if part.type == "undefined_reference" else kind,
    )


def _places(content: str, rows: Sequence[str], starts: Sequence[int], cell_end: int | None) -> list[int]:
    """The place in the page of each character of the text of a block, -1 where that is not known. The marks of quotes
    and lists before it are not part of the text; of a table's row it is one cell, in which pipes are escaped."""
    places: list[int] = []
    for row, start, part in zip(rows, starts, content.split("\n"), strict=False):
        column = row.rfind(part) if cell_end is None else row.find(part, cell_end)
        if column < 0:
            column = row.find(part.replace("|", "\\|"), cell_end or 0)
        for character in part:
            if column >= 0 and row.startswith("\\|", column) and character == "|":
                column += 1
            places.append(start + column if column >= 0 else -1)
            column += column >= 0
        places.append(start + len(row))  # where the line ends
    return places


def _tags(token: Token) -> Iterator[_Tag]:
    """The tags of HTML in a block."""
    line = token.map[0] + 1 if token.map else 0
    if token.type == "html_block":
        yield from _Html(line, token.content).tags
    for part in token.children or ():
        if part.type == "html_inline":
            yield from _Html(line + token.content.count("\n", 0, part.meta["start"]), part.content).tags


class _Html(HTMLParser):
    """The tags in a piece of HTML that begins at a line of a page."""

    def __init__(self, line: int, text: str) -> None:
        super().__init__()
        self._line = line
        self.tags: list[_Tag] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {name: value or "" for name, value in attrs}
        self.tags.append(_Tag(self._line + self.getpos()[0] - 1, tag, attributes))
