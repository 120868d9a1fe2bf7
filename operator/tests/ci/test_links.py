"""The check of links: what is broken is found in whatever form it stands, and what is not is left alone."""

from __future__ import annotations

import pytest

from ci import check, links

PAGES = {
    "README.md": "# Here it is\n\n## Two words: `code`\n\n## Two words: `code`\n",
    "docs/page.md": "# Page\n",
    "docs/tool.py": "",
}


def broken(text: str, name: str = "docs/new.md") -> list[str]:
    pages = {**PAGES, name: text}
    return links.broken(set(pages), lambda page: pages[page])


@pytest.mark.parametrize(
    "text",
    [
        "[a](page.md) [b](../README.md#here-it-is) [c](#own)\n\n# Own\n",
        "[the second](../README.md#two-words-code-1), [a folder](..), [another](../docs), [code](tool.py#L3)",
        "[elsewhere](https://example.org/nothing.md#x), [mail](mailto:a@example.org)",
        "`[a](nowhere.md)`\n\n```\n[a](nowhere.md)\n```\n\n    [a](nowhere.md)\n\n<!-- [a](nowhere.md) -->",
        '[a](#set-by-hand)\n\n<a id="set-by-hand"></a>',
    ],
)
def test_what_leads_somewhere_is_no_finding(text: str) -> None:
    assert broken(text) == []


@pytest.mark.parametrize(
    ("text", "finding"),
    [
        ("[a](nowhere.md)", "docs/new.md:1: nowhere.md: there is no docs/nowhere.md"),
        (
            "one\n\n- [in a\n  list](../docs/nowhere.md#x)",
            "docs/new.md:3: ../docs/nowhere.md#x: there is no docs/nowhere.md",
        ),
        ("| [in a table](nowhere/) |", "docs/new.md:1: nowhere/: there is no docs/nowhere"),
        ("![a picture](picture.png)", "docs/new.md:1: picture.png: there is no docs/picture.png"),
        ("[a][b]\n\n[b]: nowhere.md", "docs/new.md:3: nowhere.md: there is no docs/nowhere.md"),
        ("[out](../../README.md)", "docs/new.md:1: ../../README.md: there is no ../README.md"),
        ("[a](../README.md#there)", "docs/new.md:1: ../README.md#there: README.md has no such heading"),
        (
            "[a](../README.md#two-words-code-2)",
            "docs/new.md:1: ../README.md#two-words-code-2: README.md has no such heading",
        ),
        ("# Own\n\n[a](#other)", "docs/new.md:3: #other: docs/new.md has no such heading"),
        ("```\n# Own\n```\n[a](#own)", "docs/new.md:4: #own: docs/new.md has no such heading"),
    ],
)
def test_what_is_broken_is_found_with_its_place(text: str, finding: str) -> None:
    assert broken(text) == [finding]


def test_the_check_reads_the_pages_of_this_repository() -> None:
    known = links.files()
    assert {"README.md", "docs/decisions/README.md", "docs/reference/testing.md"} <= known
    assert not [name for name in known if name.startswith("build/")]
    assert check.CHECKS["links"] is links.findings
    assert links.findings() == []
