"""Lines of `registry submit --watch`, and its end."""

from __future__ import annotations

import argparse
import io
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.cli import main
from robotkube.cli.registry import submit
from robotkube.cli.registry.result_lines import ResultLines
from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.times import second_text, time_ns
from robotkube.registry.publication.core.report_results import ReportedResult
from robotkube.registry.publication.loops.submitting import PUBLISHED, REFUSED, SubmissionOutcome
from tests.stages.paths import REPOSITORY

PASSED = ReportedResult("relay 0.1.0", "static 2", "passed", 2.13, "2026-11-26T06:13:26Z")
FAILED = ReportedResult("relay 0.1.0", "install 2", "failed", None, "", ("stops", "upgrades"))
PAGE = REPOSITORY / "docs" / "reference" / "publication.md"
SEEN = "2026-11-26T06:14:00Z"


def written(form: str) -> str:
    stream = io.StringIO()
    lines = ResultLines(form, stream, lambda: SEEN)
    for result in (PASSED, FAILED):
        lines.result(result)
    lines.verdict(REFUSED, "http://forge/pulls/1")
    return stream.getvalue()


def test_one_line_for_each_result_with_its_own_time() -> None:
    assert written("table").splitlines() == [
        "2026-11-26T06:13:26Z  relay 0.1.0  static 2  passed  2.1 s",
        "2026-11-26T06:14:00Z  relay 0.1.0  install 2  failed  -  stops, upgrades",
        "2026-11-26T06:14:00Z  http://forge/pulls/1  refused",
    ]


def test_the_manual_shows_what_the_command_writes() -> None:
    [example] = re.findall(r"### Results as they come\n.*?```text\n(.*?)```", PAGE.read_text(), re.DOTALL)
    stream = io.StringIO()
    start = time_ns("2026-11-26T06:14:13.482913Z")
    lines = ResultLines("table", stream, lambda: second_text(start))
    for suite, result, seconds, ended, checks in (
        ("static 2", "passed", 2.13, "2026-11-26T06:13:26Z", ()),
        ("images 2", "passed", 3.41, "2026-11-26T06:13:31Z", ()),
        ("install 2", "failed", 38.04, "2026-11-26T06:14:12Z", ("keeps-running",)),
    ):
        lines.result(ReportedResult("text-relay 0.1.0", suite, result, seconds, ended, checks))
    lines.verdict(REFUSED, "http://forge/robotkube/catalogue/pulls/7")
    assert example == stream.getvalue()


def test_programs_get_one_document_for_each() -> None:
    documents = [json.loads(line) for line in written("json").splitlines()]
    assert [one["time"] for one in documents] == [
        one["time"] for one in yaml.load_all(written("yaml"), yaml.BaseLoader)
    ]
    assert [document["result"] for document in documents] == ["passed", "failed", "refused"]
    assert documents[1]["failed"] == ["stops", "upgrades"]


@pytest.mark.parametrize(("verdict", "code"), [(PUBLISHED, 0), (REFUSED, 1), ("late", 3)])
def test_the_command_writes_results_and_ends_as_without(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, verdict: str, code: int
) -> None:
    def submitted(*_: Any, report_result: Callable[[ReportedResult], None], **__: Any) -> SubmissionOutcome:
        report_result(PASSED)
        if verdict == "late":
            raise UnavailableError("not decided within the given time")
        return SubmissionOutcome(verdict, text="the report", url="http://forge/pulls/1")

    monkeypatch.setattr(submit, "submit_sources", submitted)
    monkeypatch.setattr(submit, "_access", lambda options: (None, {}))
    words = ["registry", "submit", "--all", "--watch", "--charts", str(tmp_path), "--registry", str(tmp_path)]
    monkeypatch.setattr(submit, "check_sources", lambda *_: None)
    monkeypatch.setattr(submit.folders, "read_sources", lambda *_: None)
    monkeypatch.setattr(submit.folders, "all_charts", lambda *_: [])
    monkeypatch.setattr(submit.folders, "all_applications", lambda *_: [])
    assert main.main(words) == code
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert lines[0] == "2026-11-26T06:13:26Z  relay 0.1.0  static 2  passed  2.1 s"
    assert [line.split()[-1] for line in lines[1:]] == ([] if verdict == "late" else [verdict])
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", line.split()[0]) for line in lines)  # one column
    assert ("refused by the gate, see its report above and at http://forge/pulls/1" in err) == (verdict == REFUSED)


def test_without_it_a_table_is_written() -> None:
    parser = argparse.ArgumentParser()
    submit.submitting(parser)
    assert parser.parse_args(["--all"]).watch is False
