"""Markdown as forges read it: what each line is, the links and anchors of a page, and its text in lines of 120.

Everything here takes the text of a page and looks at nothing else.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

WIDTH = 120

FENCE = re.compile(r"^ *(```+|~~~+)")
HEADING = re.compile(r"^#{1,6} +(?P<title>.+?) *#*$")
ITEM = re.compile(r"^(?P<prefix> *(?:[-*+]|\d{1,9}[.)]) +)\S")
HTML = re.compile(r"^ *<(?:!--|/?[A-Za-z][\w-]*[ />])")
CODE_SPAN = re.compile(r"(?<!`)(`+)(?!`)(?:(?!\n[ \t]*\n).)+?(?<!`)\1(?!`)", re.DOTALL)
LINK = re.compile(
    r"\[(?P<label>(?:[^\[\]]|\[[^\[\]]*\])*)\]\(\s*<?(?P<target>[^()\s<>]+(?:\([^()\s]*\))?)>?(?:\s+\"[^\"]*\")?\s*\)"
)
DEFINITION = re.compile(r"^ {0,3}\[(?P<label>[^\]\n]+)\]:[ \t]+<?(?P<target>[^\s<>]+)", re.MULTILINE)
IDENTIFIER = re.compile(r"<[a-zA-Z][^>]*\b(?:id|name)=\"([^\"]+)\"")
UNBREAKABLE = re.compile(rf"{CODE_SPAN.pattern}|\]\([^()\n]*\)", re.DOTALL)
BEGINS_A_BLOCK = re.compile(r"[-+*]$|\d{1,9}[.)]$|#{1,6}$|[=-]+$|>|\||```|~~~|<[A-Za-z/!]")
"""A word that would be read as the mark of a list, heading, quote, table, fence or of HTML at the start of a line."""


@dataclass(frozen=True)
class Line:
    """One line. `kind`: text, item, heading, table, quote, html, code (fences and indented) or blank."""

    number: int
    text: str
    kind: str


@dataclass(frozen=True)
class Link:
    """A link, an image or the definition of one: where it stands in the text, what it shows, where it leads."""

    start: int
    end: int
    line: int
    label: str
    target: str


def lines(text: str) -> list[Line]:
    """Every line with its kind."""
    result: list[Line] = []
    fence, content = "", 0
    for number, line in enumerate(text.splitlines(), 1):
        before = result[-1].kind if result else "blank"
        opening = FENCE.match(line)
        if fence:
            kind = "code"
            if opening and opening[1].startswith(fence) and not line.strip(" `~"):
                fence = ""
        elif opening:
            kind, fence = "code", opening[1]
        else:
            kind = _kind(line, before, content)
        content = _content(line, kind, before, content)
        result.append(Line(number, line, kind))
    return result


def _kind(line: str, before: str, content: int) -> str:
    """The kind of a line outside fences; `content` is the column at which the text of the list around it begins."""
    indent = len(line) - len(line.lstrip())
    if not line.strip():
        return "blank"
    if before not in ("text", "item") and indent >= content + 4:
        return "code"
    for kind, is_one in (
        ("table", line.lstrip().startswith("|")),
        ("heading", HEADING.match(line)),
        ("item", ITEM.match(line)),
        ("quote", line.lstrip().startswith(">")),
        ("html", HTML.match(line)),
    ):
        if is_one:
            return kind
    return "text"


def _content(line: str, kind: str, before: str, content: int) -> int:
    item = ITEM.match(line)
    if kind == "item" and item:
        return len(item["prefix"])
    ends = kind not in ("blank", "code") and before not in ("text", "item")
    return min(content, len(line) - len(line.lstrip())) if ends else content


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
    names = set(IDENTIFIER.findall(masked(text)))
    for line in lines(text):
        heading = HEADING.match(line.text) if line.kind == "heading" else None
        if heading:
            slug = re.sub(r"[^\w\- ]", "", LINK.sub(r"\g<label>", heading["title"]).lower()).replace(" ", "-")
            names.add(f"{slug}-{seen[slug]}" if seen[slug] else slug)
            seen[slug] += 1
    return names


def links(text: str) -> Iterator[Link]:
    """The links of a page, in order; what stands in code is none."""
    hidden = masked(text)
    for match in sorted((*LINK.finditer(hidden), *DEFINITION.finditer(hidden)), key=lambda match: match.start()):
        label = text[match.start("label") : match.end("label")]
        yield Link(match.start(), match.end(), hidden.count("\n", 0, match.start()) + 1, label, match["target"])


def masked(text: str) -> str:
    """The page with every character of its code replaced, at the same places; HTML comments count as code."""
    shown = [re.sub(".", "\0", line.text) if line.kind == "code" else line.text for line in lines(text)]
    whole = "\n".join(shown) + "\n"
    return re.sub(r"<!--.*?-->", _hidden, CODE_SPAN.sub(_hidden, whole), flags=re.DOTALL)


def _hidden(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", "\0", match[0])
