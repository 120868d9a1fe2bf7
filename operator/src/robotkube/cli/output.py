"""The output of a command: a table for people, or YAML or JSON for programs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TextIO

from robotkube.cli.terminal import tables
from robotkube.cli.terminal.printing import printable
from robotkube.foundation.documents.core.patterns import DIGEST_IN_TEXT
from robotkube.foundation.documents.core.yaml_codec import write_mapping

FORMATS = ("table", "yaml", "json")
CELL_CHARACTERS_MAX = 80


@dataclass(frozen=True)
class Table:
    """The data of a command: `columns` of every row for people; `rows` whole, for programs. With `single` the one row
    is the document.

    `text` is what people get in place of the table, `terminal_text` on a terminal where that is another. `unknown`:
    column -> what people read where a row has nothing, instead of a dash. `refusal`: why the command ends as refused
    although it has data to show; empty when it does not. `unreachable`: likewise, what could not be asked or did not
    come in time. `reservation`: what it could not prove, although nothing speaks against it. `more` are further tables:
    for programs keys of the one document, for people what follows when it has rows.
    """

    name: str
    columns: Sequence[str]
    rows: Sequence[Mapping[str, Any]]
    single: bool = False
    refusal: str = ""
    unreachable: str = ""
    reservation: str = ""
    text: str = ""
    terminal_text: str = ""
    unknown: Mapping[str, str] = field(default_factory=dict)
    more: Sequence[Table] = ()

    @property
    def is_empty(self) -> bool:
        """Return whether it is a list without anything in it."""
        return not (self.single or self.rows or self.text or any(one.rows for one in self.more))


def write(table: Table, form: str, stream: TextIO) -> None:
    """Write the table to `stream` in one of FORMATS. On a terminal tables are drawn, and digests are short; everywhere
    else the same data give the same bytes."""
    document = dict(table.rows[0]) if table.single else _lists(table)
    is_terminal = form == "table" and tables.is_terminal(stream)
    if form == "json":
        stream.write(json.dumps(document, indent=2, sort_keys=True) + "\n")
    elif form == "table" and table.text:
        text = (is_terminal and table.terminal_text) or table.text
        stream.write(printable(text) if stream.isatty() else text)
    elif form == "yaml" or table.single:
        stream.write(write_mapping(document))
    else:
        _write_tables([one for one in (table, *table.more) if one.rows or not table.more], is_terminal, stream)


def _write_tables(listed: Sequence[Table], is_terminal: bool, stream: TextIO) -> None:
    if not is_terminal:
        stream.write("\n".join("".join(f"{line}\n" for line in lines(one)) for one in listed))
        return
    for number, one in enumerate(listed):
        stream.write("\n" if number else "")
        tables.draw(_headings(one), [_cells(one, row, None) for row in one.rows], stream)


def _lists(table: Table) -> dict[str, Any]:
    return {one.name: [dict(row) for row in one.rows] for one in (table, *table.more)}


def lines(table: Table) -> list[str]:
    """The lines of a table: aligned columns under a heading."""
    cells = [_headings(table), *(_cells(table, row, CELL_CHARACTERS_MAX) for row in table.rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(table.columns))]
    return ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in cells]


def _headings(table: Table) -> list[str]:
    return [name.upper().replace("_", " ") for name in table.columns]


def _cells(table: Table, row: Mapping[str, Any], characters_max: int | None) -> list[str]:
    return [_cell(row.get(name), table.unknown.get(name, "-"), characters_max) for name in table.columns]


def _cell(value: Any, unknown: str, characters_max: int | None) -> str:
    if value is None or value == "" or value == []:
        return unknown
    if isinstance(value, bool):
        return str(value).lower()
    text = ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
    text = printable(" ".join(text.split()))
    if characters_max is None or len(text) <= characters_max or DIGEST_IN_TEXT.search(text):
        return text
    return f"{text[: characters_max - 1]}…"
