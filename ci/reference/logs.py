"""`make reference`: docs/reference/logs.md, the events that processes log, from the calls in the code that log them.

A line is written by `process.log("event", key=...)`, or by a module's logger as "event key=%s", which the process takes
apart (foundation.runtime.settings_file). Words that are not in the code as they stand are shown as `...`.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ci.docs import markdown
from ci.folders import PROJECT

SOURCES = PROJECT / "operator" / "src" / "robotkube"
PAGE = PROJECT / "docs" / "reference" / "logs.md"
NO_PROCESS = ("testing", "cli")
"""Packages whose words are no log lines of a process."""

FLOORS = ("foundation", "robots", "registry", "delivery")
"""Packages that hold one for each subject."""

EVERYBODYS = "foundation/runtime"

LEVELS = ("debug", "info", "warning", "error", "exception")
FIELD = re.compile(r"\s*\b([a-z_]+)=('?)%[-+.\d]*[a-z]\2")
PLACE = re.compile(r"%[-+.\d]*[a-z]")
SENTENCES = "robots/"
"""Lines of loggers below it stay whole: their process takes no keys out of them."""

HEAD = """# Log lines

Written by `make reference` from the code; a test says when this page is not current. Whoever searches logs by words
finds here which words there are; a change of one stands in the [CHANGELOG](../../CHANGELOG.md) as "Renamed".

Every process writes one line per unit of work to stderr: key=value on a terminal, one JSON object elsewhere. Each line
has `time` (UTC, milliseconds), `process` and `event`; then the keys of the event. Those that have a level in the tables
have the key `level` at the end; `log_level` of the [settings](settings.md) of a platform's process is the least that it
writes. An exception that was not expected stands in `error`. `...` is for words that differ from line to line.

These events are everybody's:
"""


@dataclass(frozen=True, order=True)
class LogEvent:
    """One event as the code writes it: where, its words, its level (empty: it has none) and keys. `text`: the call's
    own, which has the keys of a logger's line in it."""

    package: str
    event: str
    level: str
    keys: tuple[str, ...]
    text: str = field(default="", compare=False)


def events(sources: Path = SOURCES) -> list[LogEvent]:
    """All events in the code, in the order of packages and words, each once."""
    return sorted({_event(*call) for call in calls(sources) if call[2] is not None})


def without_words(sources: Path = SOURCES) -> list[str]:
    """`<package>: <call>` of what logs words that stand elsewhere, such as an error's own."""
    return sorted(f"{package}: {ast.unparse(call)}" for package, _, text, call in calls(sources) if text is None)


def page(known: Sequence[LogEvent]) -> str:
    """The whole page."""
    packages = dict.fromkeys(event.package for event in known)
    lines = [HEAD, *_table(event for event in known if event.package == EVERYBODYS)]
    for package in packages:
        if package != EVERYBODYS:
            lines += ["", f"## {package}", "", *_table(event for event in known if event.package == package)]
    return markdown.wrapped("\n".join(lines).rstrip() + "\n")


def _table(known: Iterator[LogEvent]) -> Iterator[str]:
    yield "| event | level | keys |"
    yield "| --- | --- | --- |"
    for one in known:
        keys = ", ".join(f"`{key}`" if key != "..." else key for key in one.keys)
        yield f"| `{one.event}` | {one.level} | {keys} |".replace("|  |", "| |").replace("|  |", "| |")


Call = tuple[str, str, str | None, ast.Call]
"""Package, level (`log` of a process), words (None: not in the call) and the call."""


def calls(sources: Path) -> Iterator[Call]:
    """Every call that logs."""
    for path in sorted(sources.rglob("*.py")):
        parts = path.relative_to(sources).parts
        if parts[0] in NO_PROCESS:
            continue
        package = "/".join(parts[:2]) if parts[0] in FLOORS else parts[0].removesuffix(".py")
        source = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)) if "log" in source else ():  # in the names of all that log
            if isinstance(node, ast.Call) and node.args and (method := _method(node)):
                yield package, method, _text(node.args[0]), node


def _method(call: ast.Call) -> str:
    """The level of a logger's call, `log` for one of a process, or nothing."""
    function = call.func
    if not isinstance(function, ast.Attribute):
        return ""
    owner = ast.unparse(function.value)
    if owner == "log" and function.attr in LEVELS:
        return "error" if function.attr == "exception" else function.attr
    is_process = (owner.endswith("process") and function.attr == "log") or function.attr == "_log"
    return "log" if is_process or (owner == "self" and function.attr == "log") else ""


def _text(node: ast.expr) -> str | None:
    """The words of a call; None when they are not in it."""
    text = None
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        text = node.value
    if isinstance(node, ast.JoinedStr):
        text = "".join(str(part.value) if isinstance(part, ast.Constant) else "%s" for part in node.values)
    return text if text and PLACE.sub("", text).strip(" :") else None


def _event(package: str, method: str, text: str | None, call: ast.Call) -> LogEvent:
    text = text or ""
    if method == "log":
        named = tuple(keyword.arg or "..." for keyword in call.keywords)
        return LogEvent(package, PLACE.sub("...", text), "", named, text)
    if package.startswith(SENTENCES):
        return LogEvent(package, PLACE.sub("...", text), method, (), text)
    keys = tuple(match[1] for match in FIELD.finditer(text))
    return LogEvent(package, PLACE.sub("...", FIELD.sub("", text)).strip(), method, keys, text)
