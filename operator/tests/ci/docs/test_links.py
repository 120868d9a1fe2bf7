"""The check of links: what is broken is found in whatever form it stands, and what is not is left alone."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from ci.check import __main__ as checks
from ci.check import rules
from ci.docs import links

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
        "[a](#set-by-hand)\n\n<a id='set-by-hand'></a>",
        "[a](#own-page)\n\nOwn\npage\n===",
        "[a](#own)\n\n   # Own",
        "[a](#own)\n\n- # Own",
        "[a](#own)\n\n> ## Own",
        "[a](#own-page) [b](#snake_case)\n\n# *Own* <b>page</b>\n\n# _snake_case_",
        '[a](page.md "title") [b](page.md (title)) [c](page.md "a \\"b\\"") [d](<page.md>)',
        "[a][page] [page][] [page]\n\n[page]:\n  page.md",
        "[![a picture](tool.py)](page.md) and [a [nested] label](page.md)",
        "[a](..#here-it-is), a list `a[0][1]`, - [ ] a task, [text] in brackets",
        "<a href='page.md#page'>a</a> <img src=\"tool.py\"> <a href='https://example.org'>b</a>",
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
        ("```text```\n[a](nowhere.md)", "docs/new.md:2: nowhere.md: there is no docs/nowhere.md"),
        ("- ```\n  code\n  ```\n\n[a](nowhere.md)", "docs/new.md:5: nowhere.md: there is no docs/nowhere.md"),
        ("[a](nowhere.md 'title')", "docs/new.md:1: nowhere.md: there is no docs/nowhere.md"),
        ("[a](nowhere.md (title))", "docs/new.md:1: nowhere.md: there is no docs/nowhere.md"),
        ('[a](nowhere.md "a \\"b\\"")', "docs/new.md:1: nowhere.md: there is no docs/nowhere.md"),
        ("[a](<no where.md>)", "docs/new.md:1: no where.md: there is no docs/no where.md"),
        ("[a](no(where)(to).md)", "docs/new.md:1: no(where)(to).md: there is no docs/no(where)(to).md"),
        ("[a [b [c] d] e](nowhere.md)", "docs/new.md:1: nowhere.md: there is no docs/nowhere.md"),
        ("[![a](tool.py)](nowhere.md)", "docs/new.md:1: nowhere.md: there is no docs/nowhere.md"),
        ("[![a](picture.png)](page.md)", "docs/new.md:1: picture.png: there is no docs/picture.png"),
        ("one\n[a][undefined]", "docs/new.md:2: undefined: no definition of a link has this name"),
        ("[undefined][]", "docs/new.md:1: undefined: no definition of a link has this name"),
        ("[a]:\n  nowhere.md", "docs/new.md:1: nowhere.md: there is no docs/nowhere.md"),
        ("> [a]: nowhere.md", "docs/new.md:1: nowhere.md: there is no docs/nowhere.md"),
        ("1. one\n\n   [a]: nowhere.md", "docs/new.md:3: nowhere.md: there is no docs/nowhere.md"),
        ("[a]: page.md\n[a]: nowhere.md", "docs/new.md:2: nowhere.md: there is no docs/nowhere.md"),
        ("one\n<a href='nowhere.md'>a</a>", "docs/new.md:2: nowhere.md: there is no docs/nowhere.md"),
        ('<p>\n<img src="nowhere.png">\n</p>', "docs/new.md:2: nowhere.png: there is no docs/nowhere.png"),
        ("[a]()", "docs/new.md:1: a link: leads nowhere"),
        ("[a](page.md/)", "docs/new.md:1: page.md/: docs/page.md is no folder"),
        ("[a](..#there)", "docs/new.md:1: ..#there: README.md has no such heading"),
        ("[a](../docs#there)", "docs/new.md:1: ../docs#there: docs/README.md has no such heading"),
    ],
)
def test_what_is_broken_is_found_with_its_place(text: str, finding: str) -> None:
    assert broken(text) == [finding]


def repository(folder: Path) -> Path:
    subprocess.run(["git", "init", "--quiet", str(folder)], check=True, timeout=60)
    return folder


def test_a_page_with_a_byte_order_mark_has_its_first_heading(tmp_path: Path) -> None:
    (repository(tmp_path) / "page.md").write_text("# Own\n\n[a](#own)\n", encoding="utf-8-sig")
    assert links.findings(tmp_path) == []


def test_pages_that_cannot_be_read_are_findings_and_the_others_are_still_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (repository(tmp_path) / "old.md").write_bytes("[a](page.md) für\n".encode("latin-1"))
    (tmp_path / "folder").mkdir()
    (tmp_path / "linked.md").symlink_to("folder")
    (tmp_path / "page.md").write_text("[a](nowhere.md) [b](old.md)\n", encoding="utf-8")
    assert links.findings(tmp_path) == [
        "linked.md: this is a folder, or a link to one; a page is a file: rename it",
        "old.md: byte 14 is no UTF-8; save the file as UTF-8",
        "page.md:1: nowhere.md: there is no nowhere.md",
    ]
    monkeypatch.setattr(rules, "TOP", tmp_path)
    monkeypatch.setattr(rules.boundaries, "findings", lambda top: [])  # it reads the contracts, of which there are none
    monkeypatch.setattr(rules, "tracked", lambda *patterns: ["old.md"] if "*.md" in patterns else [])
    assert rules.repository_rules() == ["old.md: byte 14 is no UTF-8; save the file as UTF-8"]


def test_the_check_reads_the_pages_of_this_repository() -> None:
    known = links.files()
    assert {"README.md", "docs/decisions/README.md", "docs/reference/testing.md"} <= known
    assert not [name for name in known if name.startswith("build/")]
    assert checks.CHECKS["links"] is links.findings
    assert links.findings() == []
