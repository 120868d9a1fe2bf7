"""report.html: one file without scripts and without anything to load, made from the document of report.json by the
template page.html.jinja, with the pictures that the package `drawings` makes. What the template cannot work out by
itself, such as shares and scales, is computed here."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from scenarios.runner.reporting.drawings.gallery import gallery
from scenarios.runner.reporting.report import Report

TEMPLATE = "page.html.jinja"
KEY_MOMENTS = ("event ", "first point cloud stored", "players start", "run ends")
COLOURS = 6  # of the parts of a bar
TEXT_SHARE_MIN = 8.0  # of a bar, in %: a narrower part has no room for its seconds
UNITS = {"_hz": "Hz", "_m": "m"}
PROPER_NAMES = {"argo_cd": "Argo CD"}
CAUSES = (
    ("cause", "RobotKube-Cause"),
    ("rule", "RobotKube-Rule"),
    ("event", "RobotKube-Event"),
    ("task", "RobotKube-Task"),
)
BETWEEN_TAGS = re.compile(r">\n+\s*<")

Document = Mapping[str, Any]


def page(done: Report) -> str:
    """The report as HTML: verdict, key metrics, drawings, timeline, expectations, latencies, CPU, audit, evidence,
    set-up."""
    return page_of(done.document)


def page_of(document: Document) -> str:
    """The same from the document of report.json."""
    encounters = document["latency_breakdown_seconds"]
    text = (
        _environment()
        .get_template(TEMPLATE)
        .render(
            document=document,
            parameters=[_parameter(name, number) for name, number in document["parameters"].items()],
            tiles=[{"value": shown, "text": text} for shown, text in _tiles(document)],
            timeline=list(_timeline(document["timeline"])),
            parts=list(encounters[0]) if encounters else [],
            breakdown=list(_breakdown(encounters)),
            cpu=sorted(_bars(document["cpu_core_seconds"]), key=lambda one: -one["seconds"]),
            set_up=list(_bars(document["set_up_seconds"])),
            colours=COLOURS,
            drawn=gallery(document),
        )
    )
    return BETWEEN_TAGS.sub("><", text).rstrip("\n") + "\n"


def value(measured: object) -> str:
    """A measured value for people; what could not be measured says so."""
    if measured is None:
        return "not known"
    if isinstance(measured, bool):
        return str(measured).lower()
    return f"{measured:.3f}".rstrip("0").rstrip(".") if isinstance(measured, float) else str(measured)


@cache
def _environment() -> Environment:
    """Everything that a document says is escaped; a name that it does not have is an error."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    filters = {"value": value, "thousandths": _thousandths, "words": _words, "percent": _percent, "cause": _cause}
    environment.filters.update(filters | {"short": _short, "measured": _measured, "reasons": _reasons})
    return environment


def _parameter(name: str, number: object) -> str:
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            return f"{_words(name.removesuffix(suffix))} {value(number)} {unit}"
    return f"{_words(name)} {value(number)}"


def _tiles(document: Document) -> Iterator[tuple[str, str]]:
    """The metrics that a reader wants first, with what they mean; latencies are the median over encounters."""
    latency, recorded = document["latency_quantiles"], document["recorded"]
    held = sum(row["passed"] for row in document["expectations"])
    yield f"{held} of {len(document['expectations'])}", "expectations hold"
    yield _seconds(latency["event_to_first_point_cloud_stored"]), "event to first cloud stored (median)"
    yield _seconds(latency["stop_to_removed"]), "end of event to last pod gone (median)"
    yield _unit(document["rates_measured"]["pose_hz_min"], "Hz"), "slowest vehicle's poses in its slowest 5 s"
    yield _unit(document["age_seconds"]["pose_p99"], "s"), "99 % of poses not older, in the cloud"
    of = f"lost / doubled of {value(recorded['poses'])} poses and {value(recorded['point_clouds'])} clouds"
    yield f"{value(recorded['lost'])} / {value(recorded['duplicates'])}", of


def _seconds(quantiles: Mapping[str, float | None] | None) -> str:
    middle = (quantiles or {}).get("p50")
    return "not known" if middle is None else f"{middle:.1f} s"


def _unit(number: float | None, unit: str) -> str:
    return value(number) if number is None else f"{value(number)} {unit}"


def _timeline(moments: Sequence[Document]) -> Iterator[Document]:
    """The moments, each with its distance to the last event; the ones that matter most are of kind `key`."""
    event: float | None = None
    for moment in moments:
        what = str(moment["what"])
        if what.startswith("event "):
            event = moment["seconds"]
        since = "" if event is None or what == "run ends" else f"+{moment['seconds'] - event:.3f}"
        yield {**moment, "since": since, "kind": "key" if what.startswith(KEY_MOMENTS) else ""}


def _breakdown(encounters: Sequence[Mapping[str, float | None]]) -> Iterator[Document]:
    """Per encounter its total, and its parts with their shares of the longest one's total."""
    whole = max((sum(filter(None, encounter.values())) for encounter in encounters), default=0.0) or 1.0
    for one in encounters:
        total = None if None in one.values() else sum(filter(None, one.values()))
        yield {"total": total, "parts": [_part(seconds, whole) for seconds in one.values()]}


def _part(seconds: float | None, whole: float) -> Document:
    share = 100 * (seconds or 0.0) / whole
    return {"seconds": seconds, "share": share, "text": f"{seconds:.1f}" if seconds and share > TEXT_SHARE_MIN else ""}


def _bars(seconds: Mapping[str, float]) -> Iterator[Document]:
    """Names with their seconds, their share of the sum, and the width in % of a bar on the scale of the longest."""
    most, total = max(seconds.values(), default=0.0) or 1.0, sum(seconds.values()) or 1.0
    for name, spent in seconds.items():
        yield {"name": name, "seconds": spent, "share": spent / total, "width": 100 * spent / most}


def _thousandths(seconds: float | None) -> str:
    return value(seconds) if seconds is None else f"{seconds:.3f}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.005 else "< 1 %"


def _cause(trailers: Mapping[str, Sequence[str]]) -> str:
    """Who asked, and why."""
    return " ".join(f"{word} {', '.join(trailers[key])}" for word, key in CAUSES if key in trailers)


def _measured(measured: Document | None) -> Iterator[str]:
    """What the probe of a cable measured, a line for each."""
    if measured is None:
        yield "nothing"
        return
    trip = measured["round_trip_ms"]
    yield (
        f"round trip {value(trip['median'])} ms ({value(trip['least'])} to {value(trip['greatest'])})"
        if trip
        else ("no round trip")
    )
    yield from (
        f"{_words(key)} {value(measured[key])}" for key in ("up_mbit", "down_mbit") if measured[key] is not None
    )
    yield f"{measured['lost']} of {measured['sent']} packets of the probe lost"


def _reasons(gaps: Sequence[Document]) -> Iterator[str]:
    """Places and reasons that audits name, each with the sum of its gaps."""
    places = dict.fromkeys((str(gap["where"]), str(gap["why"])) for gap in gaps)
    for where, why in places:
        counts = [gap["count"] for gap in gaps if (gap["where"], gap["why"]) == (where, why)]
        total = "not known how many" if None in counts else sum(counts)
        yield f"{where}: {why}: {total} in {len(counts)} gaps"


def _short(digest: object) -> str:
    return str(digest).removeprefix("sha256:")[:12]


def _words(name: str) -> str:
    return PROPER_NAMES.get(name) or name.replace("_", " ")
