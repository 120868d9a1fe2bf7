"""report.html: one file without scripts and without anything to load."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from scenarios.runner.inputs import NANOSECONDS
from scenarios.runner.report import Report

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1c2330;background:#fff;max-width:68rem;margin:2rem auto;padding:0 1.2rem}
h1{font-size:1.5rem;margin:0}h2{font-size:1.1rem;margin:2.2rem 0 .5rem}p{margin:.3rem 0}
table{border-collapse:collapse;width:100%}th,td{text-align:left;vertical-align:top;padding:.3rem .7rem .3rem 0}
th{border-bottom:2px solid #d6dbe4;font-weight:600}td{border-bottom:1px solid #edf0f4}
.number{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}code{font:13px ui-monospace,monospace}
.yes{color:#0b7a3e}.no{color:#b3261e;font-weight:600}.quiet{color:#5d6778}.warning{background:#fff6dd;padding:.4rem
.7rem}
.bar{background:#7aa5d8;height:.8rem;border-radius:2px}
"""


def page(done: Report) -> str:
    """The report as HTML: verdict, timeline, expectations, latencies, CPU, audit."""
    document = done.document
    sections = [
        _verdict(document),
        *(f'<p class="warning">{escape(text)}</p>' for text in document["warnings"]),
        "<h2>Timeline</h2>",
        _timeline(done),
        "<h2>Expectations</h2>",
        _expectations(done),
        "<h2>From the event to the first point cloud</h2>",
        _breakdown(document["latency_breakdown_seconds"]),
        "<h2>CPU</h2>",
        _cpu(document["cpu_core_seconds"]),
        "<h2>Audit</h2>",
        _audit(document["audit"]),
        "<h2>Set-up</h2>",
        _table(("step", "seconds"), [(escape(k), f"{v:.1f}") for k, v in document["set_up_seconds"].items()], {1}),
    ]
    title = escape(document["scenario"])
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title>'
    body = "".join(sections)
    head += f"<style>{STYLE}</style>"
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def _verdict(document: dict[str, object]) -> str:
    parameters = document["parameters"]
    assert isinstance(parameters, dict)
    verdict = '<span class="yes">passed</span>' if document["passed"] else '<span class="no">failed</span>'
    numbers = ", ".join(f"{escape(name)} {escape(str(value))}" for name, value in parameters.items())
    where = f"run {document['run']}, provider {document['provider']}, {document['nodes']} nodes"
    name = escape(str(document["scenario"]))
    return f'<h1>{name}: {verdict}</h1><p class="quiet">{escape(where)}</p><p class="quiet">{numbers}</p>'


def _timeline(done: Report) -> str:
    rows = [
        (
            f"{(moment.time - done.inputs.started) / NANOSECONDS:.3f}",
            escape(moment.text),
            f"#{moment.pull_request}" if moment.pull_request else "",
            _code(moment.commit),
        )
        for moment in done.moments
    ]
    return _table(("s", "what", "pull request", "commit"), rows, {0})


def _expectations(done: Report) -> str:
    rows = [
        (
            escape(row.name.replace("_", " ")),
            escape(row.expected),
            escape(value(row.measured)),
            '<span class="yes">yes</span>' if row.passed else '<span class="no">no</span>',
        )
        for row in done.table
    ]
    return _table(("expectation", "expected", "measured", "holds"), rows, {1, 2})


def _breakdown(parts: Sequence[dict[str, float | None]]) -> str:
    names = list(parts[0]) if parts else []
    rows = [(str(number), *(value(one[name]) for name in names)) for number, one in enumerate(parts, 1)]
    heads = ("encounter", *(f"{name.replace('_', ' ')} (s)" for name in names))
    return _table(heads, rows, set(range(len(heads))))


def _cpu(seconds: dict[str, float]) -> str:
    most = max(seconds.values(), default=0.0) or 1.0
    rows = [
        (escape(name), f"{spent:.1f}", f'<div class="bar" style="width:{100 * spent / most:.1f}%"></div>')
        for name, spent in sorted(seconds.items(), key=lambda item: -item[1])
    ]
    return _table(("component", "core seconds", "share"), rows, {1})


def _audit(entries: Sequence[dict[str, object]]) -> str:
    rows = []
    for entry in entries:
        request = entry["pull_request"]
        causes = " ".join(str(entry[key]) for key in ("task", "event") if entry[key])
        subject = escape(str(entry["subject"]))
        rows.append(
            (
                _code(entry["commit"]),
                subject,
                f"#{request}" if request else "",
                escape(causes),
                _missing(entry["missing"]),
            )
        )
    return _table(("commit", "subject", "pull request", "task, event", "complete"), rows, set())


def _missing(names: object) -> str:
    assert isinstance(names, list)
    missing = escape(", ".join(names))
    return f'<span class="no">missing: {missing}</span>' if missing else '<span class="yes">yes</span>'


def value(measured: object) -> str:
    """A measured value for people; what could not be measured says so."""
    if measured is None:
        return "not known"
    if isinstance(measured, bool):
        return str(measured).lower()
    return f"{measured:.3f}".rstrip("0").rstrip(".") if isinstance(measured, float) else str(measured)


def _code(commit: object) -> str:
    return f"<code>{escape(str(commit)[:10])}</code>" if commit else ""


def _table(heads: Iterable[str], rows: Iterable[Sequence[str]], numbers: set[int]) -> str:
    """A table of cells that are HTML already; columns in `numbers` are set right."""

    def cell(tag: str, index: int, text: str) -> str:
        return f"<{tag}{' class=number' if index in numbers else ''}>{text}</{tag}>"

    head = "".join(cell("th", index, escape(text)) for index, text in enumerate(heads))
    body = "".join(f"<tr>{''.join(cell('td', i, text) for i, text in enumerate(row))}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
