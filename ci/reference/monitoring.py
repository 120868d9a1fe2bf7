"""The table of alerts in docs/reference/monitoring.md, from the platform chart's list of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from ci.docs import markdown
from ci.folders import PROJECT

ALERTS = PROJECT / "charts" / "robotkube" / "files" / "monitoring" / "alerts.yaml"
PAGE = PROJECT / "docs" / "reference" / "monitoring.md"
BEGIN, END = "<!-- written by `make reference`: begin -->", "<!-- end -->"


def page(text: str) -> str:
    """The page with its table anew. ValueError without both marks."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{PAGE.name} needs both marks: {BEGIN} and {END}")
    alerts = yaml.safe_load(ALERTS.read_text(encoding="utf-8"))
    return markdown.wrapped("\n".join([f"{before}{begin}", *_table(alerts), f"{end}{after}"]))


def _table(alerts: list[dict[str, Any]]) -> Iterator[str]:
    yield from ("| alert | severity | told when it holds for | expression |", "| --- | --- | --- | --- |")
    for alert in alerts:
        lasts = f"{alert['seconds']} s" if alert["seconds"] else "at once"
        expression = " ".join(alert["expr"].split()).replace("|", "\\|")
        yield f"| `{alert['alert']}` | {alert['severity']} | {lasts} | `{expression}` |"


def write() -> Path:
    """Write the page anew; its path."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return PAGE
