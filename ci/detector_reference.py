"""The table of metrics in docs/reference/event-detector.md, from the code that serves them."""

from __future__ import annotations

from pathlib import Path

from ci import markdown
from ci.chart_reference import BEGIN, END
from robotkube.robots.detector.loops.status import METRICS, PREFIX

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "event-detector.md"


def page(text: str) -> str:
    """The page with its table anew. ValueError without both marks."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{PAGE.name} needs both marks: {BEGIN} and {END}")
    head = [f"| metric (`{PREFIX}...`) | kind | label | meaning |", "| --- | --- | --- | --- |"]
    rows = [
        f"| `{name}` | {kind} | {f'`{label}`' if label else '-'} | {meaning} |"
        for name, (kind, label, meaning) in METRICS.items()
    ]
    return markdown.wrapped("\n".join([f"{before}{begin}", *head, *rows, f"{end}{after}"]))
