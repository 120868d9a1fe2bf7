"""report.html shows what report.json says, readable and without anything that the numbers do not support."""

from __future__ import annotations

import json
from copy import deepcopy
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from jinja2 import UndefinedError

from scenarios.runner.reporting.page import page_of

PAGES = Path(__file__).parent / "pages"

TRAILERS = {"RobotKube-Rule": ["lidar-proximity"], "RobotKube-Event": ["3e07"], "RobotKube-Chart": ["a@1@sha256:1"]}
QUANTILES = {"p50": 4.61, "p95": 5.0, "n": 2}
DOCUMENT: dict[str, Any] = {
    "scenario": "meeting",
    "run": "run-1",
    "provider": "embedded",
    "nodes": 17,
    "parameters": {"vehicles": 15, "pose_hz": 100, "start_distance_m": 400},
    "rates_measured": {"pose_hz_min": 98.6},
    "age_seconds": {"pose_p99": 0.1},
    "latency_quantiles": {"event_to_first_point_cloud_stored": QUANTILES, "stop_to_removed": QUANTILES},
    "latency_breakdown_seconds": [{"detection": 0.006, "argo_cd": 1.5}, {"detection": 0.006, "argo_cd": 4.5}],
    "recorded": {"poses": 6996, "point_clouds": 700, "lost": 0, "duplicates": 0},
    "cpu_core_seconds": {"kubelet": 15.0, "gate": 0.01},
    "set_up_seconds": {"cluster": 18.1},
    "audit": [
        {"commit": "f0b6c1999" * 4, "subject": "deploy <x>", "pull_request": 4, "trailers": TRAILERS, "missing": []},
        {"commit": "8a5da5b40" * 4, "subject": "policy", "pull_request": None, "trailers": {}, "missing": ["a plan"]},
    ],
    "evidence": [
        {
            "chart": "event-detector",
            "version": "0.1.0",
            "digest": "sha256:" + "d" * 64,
            "evidence": "sha256:" + "e" * 64,
            "releases": ["cloud-0/recorder", "cloud-0/event-detector"],
            "found": True,
        },
        {"chart": "<x>", "version": "", "digest": "", "evidence": "none", "releases": ["a/x"], "found": False},
    ],
    "warnings": ["nothing was verified"],
    "expectations": [{"name": "lost", "expected": "= 0", "measured": 0, "passed": True}],
    "timeline": [
        {"seconds": 0.0, "what": "players start", "pull_request": None, "commit": None},
        {"seconds": 5.0, "what": "event 1: near", "pull_request": None, "commit": None},
        {"seconds": 6.25, "what": "merged", "pull_request": 4, "commit": "f0b6c1999" * 4},
    ],
    "passed": True,
}


def changed(**values: Any) -> str:
    return page_of({**deepcopy(DOCUMENT), **values})


def test_the_key_metrics_stand_first() -> None:
    top = changed().partition("<h2>")[0]
    for text in (
        "passed",
        "1 of 1",
        "4.6 s",
        "98.6 Hz",
        "0 / 0",
        "of 6996 poses and 700 clouds",
        "nothing was verified",
    ):
        assert text in top
    assert "vehicles 15, pose 100 Hz, start distance 400 m" in top


def test_times_are_also_given_since_the_event() -> None:
    page = changed()
    assert '<td class="number">6.250</td><td class="number">+1.250</td>' in page
    assert '<td class="number">0.000</td><td class="number"></td>' in page


def test_bars_are_on_one_scale() -> None:
    page = changed()
    assert "width:33.3%" in page
    assert "width:99.9%" in page
    assert '<td class="number">1.506</td>' in page
    assert "Argo CD" in page


def test_what_is_not_known_is_named_and_has_no_total() -> None:
    nothing = {"event_to_first_point_cloud_stored": None, "stop_to_removed": {"p50": None, "p95": None, "n": 0}}
    parts = [{"detection": 0.006, "argo_cd": None}]
    page = changed(latency_quantiles=nothing, latency_breakdown_seconds=parts, rates_measured={"pose_hz_min": None})
    assert page.count("<b>not known</b>") == 3
    assert page.count('<td class="number">not known</td>') == 2


def test_the_audit_shows_causes_and_trailers_escaped() -> None:
    page = changed()
    assert "deploy &lt;x&gt;<details><summary>rule lidar-proximity event 3e07</summary>" in page
    assert "RobotKube-Chart: a@1@sha256:1" in page
    assert '<tr class="bad"><td><code>8a5da5b408</code></td><td>none</td>' in page
    assert "missing: a plan" in page
    assert "no trailers needed" not in page


def test_a_failed_expectation_is_marked() -> None:
    row = {"name": "lost", "expected": "= 0", "measured": None, "passed": False}
    page = changed(expectations=[row], passed=False)
    assert '<span class="badge no">failed</span>' in page
    assert '<tr class="bad"><td>lost</td>' in page
    assert "0 of 1" in page


def test_the_evidence_of_each_chart_is_shown() -> None:
    section = changed().partition("<h2>Evidence</h2>")[2].partition("<h2>")[0]
    for text in ("event-detector 0.1.0", "d" * 12, "e" * 12, "cloud-0/recorder, cloud-0/event-detector"):
        assert text in section
    assert "&lt;x&gt;" in section
    assert section.count('<tr class="bad">') == 1


class Read(HTMLParser):
    """A page as its tags, their attributes and its texts, however characters are escaped."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.facts: list[object] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.facts.append((tag, attrs))

    def handle_endtag(self, tag: str) -> None:
        self.facts.append(tag)

    def handle_data(self, data: str) -> None:
        self.facts += [f"text {data}"] if data.strip() else []


@pytest.mark.parametrize("name", ["healthy", "unknown", "story"])
def test_a_recorded_report_makes_its_recorded_page(name: str) -> None:
    """A run that went well, one of which little is known, and a story with steps and every character to be escaped."""
    made = page_of(json.loads((PAGES / f"{name}.json").read_text()))
    assert Read(made).facts == Read((PAGES / f"{name}.html").read_text()).facts


def test_every_text_of_a_document_is_escaped() -> None:
    page = changed(
        scenario="<b>",
        run="<b>",
        warnings=["<b>"],
        cpu_core_seconds={"<b>": 1.0},
        set_up_seconds={"<b>": 1.0},
        parameters={"<b>": "<b>"},
    )
    assert "<b>" not in page.replace('class="tile"><b>', "")
    assert page.count("&lt;b&gt;") == 8


def test_a_document_without_a_part_is_an_error_and_no_gap() -> None:
    broken = deepcopy(DOCUMENT)
    del broken["audit"][0]["subject"]
    with pytest.raises(UndefinedError, match="subject"):
        page_of(broken)
