"""Names of metrics: what alerts and dashboards ask for, and what the reference pages name."""

from __future__ import annotations

import re
from collections.abc import Iterator

from robotkube.delivery.manager.adapters.prometheus import METRICS, PREFIX
from robotkube.robots.recording.loops.counters import RecorderCounts
from tests.stages.paths import CHARTS, REPOSITORY

FILES = CHARTS / "robotkube" / "files" / "monitoring"
PAGES = REPOSITORY / "docs" / "reference"
ASKED = re.compile(r"\b(?:robotkube|process)_[a-z_]+\b")
NAMED = re.compile(r"`(robotkube_[a-z_]+)(?:\{[^`]*\})?`")
TABLE = re.compile(r"^\| (?:metric|name) \(`(robotkube_[a-z]+_)\.\.\.`\)")
HISTOGRAM = re.compile("_(?:bucket|sum|count)$")
OF_EVERY_PROCESS = {"process_resident_memory_bytes"}


def documented() -> set[str]:
    """Full names of all metrics of the reference pages; those of a recording by the names of its counts."""
    names = {PREFIX + one.name for one in METRICS}
    names |= {f"robotkube_recorder_{name}_total" for name in RecorderCounts().numbers()}
    for page in sorted(PAGES.glob("*.md")):
        if page.name == "monitoring.md":  # made from the alerts themselves
            continue
        text = page.read_text("utf-8")
        names |= {*NAMED.findall(text), *of_tables(text)}
    return names


def of_tables(text: str) -> Iterator[str]:
    """Names of tables whose head has their prefix."""
    prefix = ""
    for line in text.splitlines():
        match = TABLE.match(line)
        prefix = match[1] if match else prefix if line.startswith("|") else ""
        if prefix and not match:
            yield from (prefix + name for name in re.findall("`([a-z_]+)`", line.split("|")[1]))


def asked(text: str) -> set[str]:
    """Names of metrics in an expression; `recording` and the like are labels and words of the language."""
    return {HISTOGRAM.sub("", name) for name in ASKED.findall(text)} - {"robotkube"}
