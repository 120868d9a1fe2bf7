"""Reading and wrapping Markdown: nothing that is shown changes, and nothing but text is touched."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as some
from markdown_it import MarkdownIt

from ci.check import rules
from ci.docs import markdown

LONG = "word " * 40
KEPT = {
    "a table": f"| {LONG}|\n| --- |\n| {LONG}|\n",
    "a fence": f"```console\n$ {LONG}\n# {LONG}\n```\n",
    "a fence in a list": f"- one\n\n  ~~~\n  {LONG}\n  ~~~\n",
    "indented code": f"Text:\n\n    {LONG}\n\nMore.\n",
    "a heading": f"# {LONG.strip()}\n",
    "a forced break": f"{LONG}  \nnext\n",
    "one long word": f"{'x' * 200}\n",
    "one long link": f"[{'x' * 100}](https://example.org/{'y' * 100})\n",
    "a comment": f"<!--\n{LONG}\n{LONG}\n-->\n",
    "definitions": f"[a]: {'x' * 60}.md\n[b]: {'x' * 120}.md\n",
    "lines that fit": "one\ntwo\n  three\n",
}
TOO_LONG = ("a heading", "a forced break", "a comment", "definitions")
"""What is kept, and is to be written shorter by hand."""

SHOWN = {
    "a paragraph": f"{LONG}[a link to somewhere](page.md#there) {LONG}\n",
    "a list": f"- {LONG}\n  {LONG}\n- short\n\n1. {LONG}\n   - {LONG}\n2. {LONG}\n",
    "code in the text": f"{LONG}`a  b {'c ' * 20}` {LONG}`` x ` y `` {LONG}\n",
    "marks in the text": " ".join(["word - word 1. word # word > word | word + word * word === word"] * 8) + "\n",
    "emphasis and HTML": f"**{LONG.strip()}** *{LONG.strip()}* a < b <br> {LONG}\n",
    "no newline at its end": LONG.strip(),
    "under a heading": f"## Heading\n{LONG}\n- {LONG}\n",
}


def shown(text: str) -> str:
    """What a reader sees: HTML, in which any space between words is one."""
    return " ".join(MarkdownIt("commonmark").enable("table").render(text).split())


@pytest.mark.parametrize("text", KEPT.values(), ids=KEPT)
def test_what_is_no_text_is_kept(text: str) -> None:
    assert markdown.wrapped(text) == text


@pytest.mark.parametrize("text", SHOWN.values(), ids=SHOWN)
def test_text_is_wrapped_and_shown_as_before(text: str) -> None:
    after = markdown.wrapped(text)
    assert after != text
    assert max(map(len, after.splitlines())) <= markdown.WIDTH
    assert shown(after) == shown(text)
    assert markdown.wrapped(after) == after
    assert after.endswith("\n") == text.endswith("\n")


WORDS = [
    "word",
    "`a b`",
    "`` a ` b ``",
    "[a b](c.md)",
    "**b",
    "c**",
    "*x*",
    "<br>",
    "\\",
    "*",
    "+",
    "-",
    "1.",
    "#",
    ">",
]
BEGINS = ["", "\n", "- ", "\n1. ", "  ", "\n    ", "# ", "\n> ", "\n| ", "```\n"]
BLOCKS = some.tuples(some.sampled_from(BEGINS), some.lists(some.sampled_from([*WORDS, "|", "==="]), max_size=12))


@given(some.lists(BLOCKS, max_size=8))
def test_any_page_is_shown_as_before(blocks: list[tuple[str, list[str]]]) -> None:
    text = "\n".join(f"{begin}{' '.join(['word', *more])}" for begin, more in blocks)
    after = markdown.wrapped(text, 20)
    assert shown(after) == shown(text)
    assert markdown.wrapped(after, 20) == after


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        (f"short\n{LONG}\n", [2]),
        (f"- {LONG}\n", [1]),
        (f"# {LONG}\n", [1]),
        (f"> {LONG}\n", [1]),
        (f"<!-- {LONG} -->\n", [1]),
        (f"see {'x' * 200}\n", [1]),
        (f"- {'x' * 200}\n", []),
        (f"```text```\n\n{LONG}\n", [3]),
        (f"- ```\n  {LONG}\n  ```\n\n{LONG}\n", [5]),
        (f"> ```\n> {LONG}\n> ```\n", []),
        *((text, []) for name, text in KEPT.items() if name not in TOO_LONG),
    ],
)
def test_lines_that_are_too_long_are_told(text: str, numbers: list[int]) -> None:
    assert [line.number for line in markdown.too_long(text)] == numbers


def test_the_check_tells_long_lines_but_not_of_what_is_published(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pages = ["page.md", "charts/earlier/relay/README.md"]
    for name in pages:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"short\n\n{LONG}\n", encoding="utf-8")
    monkeypatch.setattr(rules, "TOP", tmp_path)
    monkeypatch.setattr(rules, "tracked", lambda *patterns: pages)
    assert rules.long_lines() == ["page.md:3: 200 characters; a line of text has at most 120"]


def test_anchors_are_those_of_forges() -> None:
    text = '# A `b`, c: [d](e.md)\n## Same\n## Same\n### build/x.json\n```\n# no\n```\n<a id="own"></a>\n'
    assert markdown.anchors(text) == {"a-b-c-d", "same", "same-1", "buildxjson", "own"}


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        ("one\n===\ntwo\n---\n\n***\n", ["heading"] * 4 + ["blank", "rule"]),
        ("- one\n  two\n\n      code\n- # three\n", ["item", "text", "blank", "code", "heading"]),
        ("> one\ntwo\n\n[a]:\n  b.md\n", ["quote", "quote", "blank", "definition", "definition"]),
        ("````\n```\n\n````\n<p>\none\n", ["code"] * 4 + ["html"] * 2),
        ("| a |\n| - |\n| b |\nbehind\n", ["table"] * 4),
        ("", []),
    ],
)
def test_lines_have_the_kind_that_a_reader_of_markdown_gives_them(text: str, kinds: list[str]) -> None:
    assert [line.kind for line in markdown.lines(text)] == kinds


@pytest.mark.parametrize(
    "text",
    [
        "`[a](b)` and [a](b)",
        "> quoted\n> [a](b)",
        "- one\n  - [a](b)",
        "| [a] | `[a](b)` | x \\| [a](b) |\n| - | - | - |\n",
        "## [a](b) ##",
        "> - one\n>   two [a](b)\n",
        "[![a](b)",
        "one\r\n\r\ntwo\r\n[a](b)\r\n",
    ],
)
def test_a_link_has_its_place_in_the_text(text: str) -> None:
    (link,) = markdown.links(text)
    assert (text[link.start : link.end], link.label, link.target, link.kind) == ("[a](b)", "a", "b", "inline")
    assert link.start == text.rindex("[a](b)")
    assert link.line == text.count("\n", 0, link.start) + 1
