"""Tables: drawn for people on a terminal, with short digests; the same bytes as ever in a pipe."""

from __future__ import annotations

import io

import pytest
from rich.text import Text

from robotkube.cli.output import Table, write
from robotkube.cli.terminal.tables import shortened

DIGEST = f"sha256:{'0123456789ab' * 5}cdef"
LONG = "words " * 20
ROWS = [
    {"release": "cloud-0/recorder", "digest": DIGEST, "messages": [], "reason": LONG},
    {"release": "vehicle-00/[bold]", "digest": f"registry/own-images/a@{DIGEST}", "messages": ["a", "b"], "reason": ""},
]
TABLE = Table("releases", ("release", "digest", "messages", "reason"), ROWS)


class Terminal(io.StringIO):
    """A stream that is a terminal."""

    def isatty(self) -> bool:
        return True


def written(stream: io.StringIO, table: Table = TABLE, form: str = "table") -> str:
    write(table, form, stream)
    return stream.getvalue()


def test_a_pipe_gets_whole_digests_in_aligned_lines() -> None:
    heading, first, second = written(io.StringIO()).splitlines()
    assert heading.split() == ["RELEASE", "DIGEST", "MESSAGES", "REASON"]
    assert first == f"cloud-0/recorder   {DIGEST:<93}  -         {LONG[:79]}…"
    assert second == f"vehicle-00/[bold]  registry/own-images/a@{DIGEST}  a,b       -"
    assert heading.index("MESSAGES") == second.index("a,b")


def test_a_terminal_gets_short_digests_and_whole_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm")
    text = Text.from_ansi(written(Terminal())).plain
    assert "sha256:0123456789ab…" in text
    assert DIGEST not in text
    assert "registry/own-images/a@sha256:0123456789ab…" in text
    assert "vehicle-00/[bold]" in text, "names are no markup"
    assert text.count("words") == 20, "nothing is cut, it is folded"
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize("form", ["json", "yaml"])
def test_other_forms_are_the_same_on_a_terminal(form: str) -> None:
    assert written(Terminal(), form=form) == written(io.StringIO(), form=form)
    assert DIGEST in written(Terminal(), form=form)


def test_a_text_has_another_form_on_a_terminal_only_where_there_is_one() -> None:
    same = Table("audit", (), [{}], single=True, text="whole\n")
    other = Table("audit", (), [{}], single=True, text="whole\n", terminal_text="short\n")
    assert [written(Terminal(), one) for one in (same, other)] == ["whole\n", "short\n"]
    assert [written(io.StringIO(), one) for one in (same, other)] == ["whole\n", "whole\n"]


def test_several_tables_are_apart() -> None:
    both = Table("a", ("x",), [{"x": 1}], more=(Table("b", ("y",), [{"y": 2}]), Table("c", ("z",), [])))
    assert written(io.StringIO(), both) == "X\n1\n\nY\n2\n"
    assert [line.strip() for line in written(Terminal(), both).splitlines() if "\x1b" not in line] == ["1", "", "2"]


def test_what_is_no_whole_digest_stays() -> None:
    assert shortened(f"sha256:{'0' * 12} {'0' * 64}") == f"sha256:{'0' * 12} {'0' * 64}"
