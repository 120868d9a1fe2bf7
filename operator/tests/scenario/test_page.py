"""report.html shows what report.json says, readable and without anything that the figures do not support."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

from scenarios.runner.page import page_of

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


def test_what_a_reader_looks_for_stands_first() -> None:
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


def test_what_is_not_known_is_said_and_has_no_total() -> None:
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
