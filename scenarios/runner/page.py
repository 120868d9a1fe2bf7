"""report.html: one file without scripts and without anything to load, made from the document of report.json."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from scenarios.runner.report import Report

STYLE = """
:root{--line:#e6eaf0;--quiet:#5d6778;--good:#0b7a3e;--bad:#b3261e}
body{font:15px/1.5 system-ui,sans-serif;color:#1c2330;background:#fff;max-width:70rem;margin:2rem auto;padding:0 1.2rem}
h1{font-size:1.5rem;margin:0 0 .2rem}h2{font-size:1.15rem;margin:2.4rem 0 .5rem}p{margin:.3rem 0}
.quiet{color:var(--quiet)}.yes{color:var(--good)}.no{color:var(--bad);font-weight:600}
.badge{font-size:.9rem;border-radius:1rem;padding:.15rem .8rem;margin-left:.6rem;vertical-align:.2rem;color:#fff}
.badge.yes{background:var(--good)}.badge.no{background:var(--bad)}
.warning{background:#fff6dd;border-left:3px solid #e2b93b;padding:.4rem .8rem;margin:.8rem 0}
.tiles{display:grid;grid-template-columns:repeat(3,1fr);gap:.7rem;margin:1.2rem 0}
.tile{border:1px solid var(--line);border-radius:6px;padding:.5rem .8rem}
.tile b{display:block;font-size:1.3rem;font-variant-numeric:tabular-nums}
.tile span{color:var(--quiet);font-size:.85rem;line-height:1.3;display:block}
table{border-collapse:collapse;width:100%}
th,td{text-align:left;vertical-align:top;padding:.28rem .8rem .28rem 0;border-bottom:1px solid var(--line)}
th{border-bottom:2px solid #d0d7e2;font-weight:600;white-space:nowrap}
.number{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
tr.key td{background:#f2f6fb;font-weight:600}tr.bad td{background:#fdecea}tr.sum td{font-weight:600}
td.wide{width:45%}td.text{overflow-wrap:anywhere}code{font:13px ui-monospace,monospace}
.bar{background:#7aa5d8;height:.75rem;border-radius:2px;margin-top:.35rem}
.stack{display:flex;height:1.5rem;border-radius:3px;overflow:hidden;font-size:.8rem;line-height:1.5rem}
.stack div{padding-left:.35rem;white-space:nowrap;overflow:hidden;box-sizing:border-box}
.part0{background:#7d8797;color:#fff}.part1{background:#7aa5d8}.part2{background:#f0b27a}.part3{background:#9cc9a3}
.part4{background:#c9b3dd}.part5{background:#2f6f73;color:#fff}
.legend span{display:inline-block;margin-right:1.1rem}
.legend i{display:inline-block;width:.8rem;height:.8rem;border-radius:2px;margin-right:.35rem;vertical-align:-.05rem}
details summary{cursor:pointer;color:var(--quiet)}details div{font:12.5px/1.5 ui-monospace,monospace}
@media print{body{margin:0}details{display:none}}
"""
KEY_MOMENTS = ("event ", "first point cloud stored", "players start", "run ends")
PARTS = 6
UNITS = {"_hz": "Hz", "_m": "m"}
PROPER_NAMES = {"argo_cd": "Argo CD"}
CAUSES = (
    ("cause", "RobotKube-Cause"),
    ("rule", "RobotKube-Rule"),
    ("event", "RobotKube-Event"),
    ("task", "RobotKube-Task"),
)

Document = Mapping[str, Any]


def page(done: Report) -> str:
    """The report as HTML: verdict, key figures, timeline, expectations, latencies, CPU, audit, evidence, set-up."""
    return page_of(done.document)


def page_of(document: Document) -> str:
    """The same from the document of report.json."""
    sections: tuple[tuple[str, str, str], ...] = (
        ("Timeline", "seconds since the players' start, and since the last event", _timeline(document["timeline"])),
        ("Expectations", "what must hold, over all encounters", _expectations(document["expectations"])),
        (
            "From the event to the first stored point cloud",
            "seconds per encounter, on one scale",
            _breakdown(document["latency_breakdown_seconds"]),
        ),
        ("CPU", "core seconds from before the start to the end of the observation", _cpu(document["cpu_core_seconds"])),
        ("Audit", "every commit of the deployment repository's main, except its seed", _audit(document["audit"])),
        ("Evidence", "every chart that a release on main named during the run", _evidence(document["evidence"])),
        ("Set-up", "seconds before the run", _set_up(document["set_up_seconds"])),
    )
    body = _heading(document) + "".join(f'<p class="warning">{escape(t)}</p>' for t in document["warnings"])
    body += _tiles(document)
    if "steps" in document:
        steps, tasks = _steps(document["steps"]), _tasks(document["tasks"])
        told = (
            ("Steps", "what people and faults did, and when what must follow was seen", steps),
            ("Tasks", "what the manager said to each demand, in its order", tasks),
        )
        sections = (*told, *sections)
    for title, explanation, content in sections:
        body += f'<h2>{title}</h2><p class="quiet">{explanation}</p>{content}'
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    head += f"<title>{escape(document['scenario'])}</title><style>{STYLE}</style>"
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def value(measured: object) -> str:
    """A measured value for people; what could not be measured says so."""
    if measured is None:
        return "not known"
    if isinstance(measured, bool):
        return str(measured).lower()
    return f"{measured:.3f}".rstrip("0").rstrip(".") if isinstance(measured, float) else str(measured)


def _heading(document: Document) -> str:
    kind, word = ("yes", "passed") if document["passed"] else ("no", "failed")
    numbers = ", ".join(_parameter(name, number) for name, number in document["parameters"].items())
    where = f"{document['run']}, provider {document['provider']}, {document['nodes']} nodes"
    title = f'{escape(document["scenario"])}<span class="badge {kind}">{word}</span>'
    return f'<h1>{title}</h1><p class="quiet">{escape(where)}</p><p class="quiet">{numbers}</p>'


def _parameter(name: str, number: object) -> str:
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            return f"{_words(name.removesuffix(suffix))} {value(number)} {unit}"
    return f"{_words(name)} {value(number)}"


def _tiles(document: Document) -> str:
    """The figures a reader looks for first; latencies are the median over encounters."""
    latency, recorded = document["latency_quantiles"], document["recorded"]
    held = sum(row["passed"] for row in document["expectations"])
    tiles = (
        (f"{held} of {len(document['expectations'])}", "expectations hold"),
        (_seconds(latency["event_to_first_point_cloud_stored"]), "event to first cloud stored (median)"),
        (_seconds(latency["stop_to_removed"]), "end of event to last pod gone (median)"),
        (_unit(document["rates_measured"]["pose_hz_min"], "Hz"), "slowest vehicle's poses in its slowest 5 s"),
        (_unit(document["age_seconds"]["pose_p99"], "s"), "99 % of poses not older, in the cloud"),
        (
            f"{value(recorded['lost'])} / {value(recorded['duplicates'])}",
            f"lost / doubled of {value(recorded['poses'])} poses and {value(recorded['point_clouds'])} clouds",
        ),
    )
    return f'<div class="tiles">{"".join(_tile(figure, text) for figure, text in tiles)}</div>'


def _tile(figure: str, text: str) -> str:
    return f'<div class="tile"><b>{escape(figure)}</b><span>{escape(text)}</span></div>'


def _seconds(quantiles: Mapping[str, float | None] | None) -> str:
    middle = (quantiles or {}).get("p50")
    return "not known" if middle is None else f"{middle:.1f} s"


def _unit(number: float | None, unit: str) -> str:
    return value(number) if number is None else f"{value(number)} {unit}"


def _timeline(moments: Sequence[Document]) -> str:
    rows, kinds = [], []
    event: float | None = None
    for moment in moments:
        seconds, what, request = moment["seconds"], str(moment["what"]), moment["pull_request"]
        if what.startswith("event "):
            event = seconds
        since = "" if event is None or what == "run ends" else f"+{seconds - event:.3f}"
        rows.append((f"{seconds:.3f}", since, escape(what), f"#{request}" if request else "", _code(moment["commit"])))
        kinds.append("key" if what.startswith(KEY_MOMENTS) else "")
    heads = ("s", "since event", "what", "pull request", "commit")
    return _table(heads, rows, numbers={0, 1}, text={2}, kinds=kinds)


def _steps(steps: Sequence[Document]) -> str:
    rows = [
        (escape(one["step"]), escape(one["what"]), _thousandths(one["began"]), _thousandths(one["seen"]))
        for one in steps
    ]
    kinds = ["" if one["seen"] is not None else "bad" for one in steps]
    return _table(("step", "what it does", "began, s", "seen, s"), rows, numbers={2, 3}, text={1}, kinds=kinds)


def _tasks(tasks: Sequence[Document]) -> str:
    rows = [
        (
            escape(task["task"]),
            _thousandths(said["seconds"]),
            escape(said["condition"]),
            escape(said["reason"]),
            escape(said["message"]),
        )
        for task in tasks
        for said in task["conditions"]
    ]
    return _table(("task", "s", "condition", "reason", "message"), rows, numbers={1}, text={0, 4})


def _expectations(expectations: Sequence[Document]) -> str:
    rows = [
        (_words(row["name"]), escape(row["expected"]), escape(value(row["measured"])), _yes(row["passed"]))
        for row in expectations
    ]
    kinds = ["" if row["passed"] else "bad" for row in expectations]
    return _table(("expectation", "expected", "measured", "holds"), rows, numbers={1, 2}, kinds=kinds)


def _breakdown(encounters: Sequence[Mapping[str, float | None]]) -> str:
    """One bar per encounter, divided by where the time went, and the numbers below."""
    names = list(encounters[0]) if encounters else []
    whole = max((sum(filter(None, one.values())) for one in encounters), default=0.0)
    legend = "".join(f'<span><i class="part{i % PARTS}"></i>{_words(name)}</span>' for i, name in enumerate(names))
    rows = []
    for number, one in enumerate(encounters, 1):
        total = None if None in one.values() else sum(filter(None, one.values()))
        rows.append(
            (str(number), *(_thousandths(one[name]) for name in names), _thousandths(total), _stack(one, whole))
        )
    heads = ("encounter", *map(_words, names), "total", "")
    numbers = set(range(len(names) + 2))
    return f'<p class="legend">{legend}</p>{_table(heads, rows, numbers=numbers, wide=len(heads) - 1)}'


def _thousandths(seconds: float | None) -> str:
    return value(seconds) if seconds is None else f"{seconds:.3f}"


def _stack(parts: Mapping[str, float | None], whole: float) -> str:
    cells = ""
    for number, seconds in enumerate(parts.values()):
        share = 100 * (seconds or 0.0) / (whole or 1.0)
        text = f"{seconds:.1f}" if seconds and share > 8 else ""
        space = "" if text else ";padding:0"
        cells += f'<div class="part{number % PARTS}" style="width:{share:.1f}%{space}">{text}</div>'
    return f'<div class="stack">{cells}</div>'


def _cpu(seconds: Mapping[str, float]) -> str:
    most, total = max(seconds.values(), default=0.0) or 1.0, sum(seconds.values())
    rows = [
        (
            escape(name),
            f"{spent:.1f}",
            _percent(spent / (total or 1.0)),
            f'<div class="bar" style="width:{100 * spent / most:.1f}%"></div>',
        )
        for name, spent in sorted(seconds.items(), key=lambda item: -item[1])
    ]
    rows.append(("all", f"{total:.1f}", "", ""))
    kinds = [*[""] * len(seconds), "sum"]
    return _table(("component", "core seconds", "share", ""), rows, numbers={1, 2}, wide=3, kinds=kinds)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.005 else "&lt; 1 %"


def _audit(entries: Sequence[Document]) -> str:
    rows = []
    for entry in entries:
        request = entry["pull_request"]
        what = escape(str(entry["subject"])) + _trailers(entry["trailers"], complete=not entry["missing"])
        rows.append((_code(entry["commit"]), f"#{request}" if request else "none", what, _missing(entry["missing"])))
    kinds = ["bad" if entry["missing"] else "" for entry in entries]
    return _table(("commit", "pull request", "what and why", "complete"), rows, text={2}, kinds=kinds)


def _trailers(trailers: Mapping[str, Sequence[str]], complete: bool) -> str:
    """Who asked, why, and what was deployed: the commit's trailers, folded."""
    if not trailers:
        return ' <span class="quiet">(a person\'s change, no trailers needed)</span>' if complete else ""
    lines = "".join(f"<div>{escape(name)}: {escape(text)}</div>" for name, texts in trailers.items() for text in texts)
    cause = " ".join(f"{word} {', '.join(trailers[key])}" for word, key in CAUSES if key in trailers)
    return f"<details><summary>{escape(cause) or 'trailers'}</summary>{lines}</details>"


def _evidence(entries: Sequence[Document]) -> str:
    rows = [
        (
            escape(f"{entry['chart']} {entry['version']}"),
            _short(entry["digest"]),
            _short(entry["evidence"]),
            escape(", ".join(entry["releases"])),
            _yes(entry["found"]),
        )
        for entry in entries
    ]
    kinds = ["" if entry["found"] else "bad" for entry in entries]
    heads = ("chart", "digest", "evidence named", "releases", "in the catalogue, for this digest")
    return _table(heads, rows, text={3}, kinds=kinds)


def _short(digest: object) -> str:
    return f"<code>{escape(str(digest).removeprefix('sha256:')[:12])}</code>"


def _set_up(seconds: Mapping[str, float]) -> str:
    most = max(seconds.values(), default=0.0) or 1.0
    rows = [
        (escape(name), f"{spent:.1f}", f'<div class="bar" style="width:{100 * spent / most:.1f}%"></div>')
        for name, spent in seconds.items()
    ]
    return _table(("step", "seconds", ""), rows, numbers={1}, wide=2)


def _missing(names: Sequence[str]) -> str:
    return f'<span class="no">missing: {escape(", ".join(names))}</span>' if names else _yes(True)


def _yes(holds: bool) -> str:
    return '<span class="yes">yes</span>' if holds else '<span class="no">no</span>'


def _words(name: str) -> str:
    return PROPER_NAMES.get(name) or escape(name.replace("_", " "))


def _code(commit: object) -> str:
    return f"<code>{escape(str(commit)[:10])}</code>" if commit else ""


def _table(
    heads: Iterable[str],
    rows: Iterable[Sequence[str]],
    numbers: Iterable[int] = (),
    text: Iterable[int] = (),
    wide: int | None = None,
    kinds: Sequence[str] = (),
) -> str:
    """A table of cells that are HTML already. Columns in `numbers` are set right, those in `text` may break anywhere,
    `wide` holds a picture; `kinds` are the rows' classes."""
    classes = {**dict.fromkeys(numbers, "number"), **dict.fromkeys(text, "text")}
    if wide is not None:
        classes[wide] = "wide"

    def line(tag: str, cells: Sequence[str], kind: str = "") -> str:
        marks = [f' class="{classes[i]}"' if i in classes else "" for i in range(len(cells))]
        inner = "".join(f"<{tag}{mark}>{cell}</{tag}>" for mark, cell in zip(marks, cells, strict=True))
        return f'<tr class="{kind}">{inner}</tr>' if kind else f"<tr>{inner}</tr>"

    head = line("th", [escape(text) for text in heads])
    body = "".join(line("td", row, kinds[i] if i < len(kinds) else "") for i, row in enumerate(rows))
    return f"<table><thead>{head}</thead><tbody>{body}</tbody></table>"
