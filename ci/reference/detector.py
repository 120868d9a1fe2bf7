"""The table of metrics in docs/reference/event-detector.md, from the code that serves them."""

from __future__ import annotations

from ci.docs import markdown
from ci.folders import PROJECT
from ci.reference.charts import BEGIN, END
from robotkube.robots.detector.loops.status import METRICS, PREFIX

PAGE = PROJECT / "docs" / "reference" / "event-detector.md"


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
