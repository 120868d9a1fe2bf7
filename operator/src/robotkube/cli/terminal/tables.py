"""Tables on a terminal: folded to its width, with short digests. Elsewhere they are the plain lines of `output`."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import TextIO

from robotkube.foundation.documents.core.patterns import DIGEST_IN_TEXT


def is_terminal(stream: TextIO) -> bool:
    """Return whether tables can be drawn for people on `stream`."""
    return stream.isatty() and find_spec("rich") is not None


def shortened(text: str) -> str:
    """`text` with the first twelve digits of each digest."""
    return DIGEST_IN_TEXT.sub(r"sha256:\1…", text)


def draw(headings: Sequence[str], rows: Sequence[Sequence[str]], stream: TextIO) -> None:
    """Draw a table; a cell that does not fit is folded."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for heading in headings:
        table.add_column(heading, overflow="fold")
    for row in rows:
        table.add_row(*(Text(shortened(cell)) for cell in row))
    Console(file=stream, highlight=False).print(table)
