"""Figures of two revisions set against each other: which of them count, and when one is worse."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from benchmarks import revisions
from benchmarks.revisions import Difference, differences, measured, working_tree
from ci.errors import SetUpError

UNITS = {"receive": "us", "store": "s"}


def test_only_figures_that_every_round_has_are_compared() -> None:
    ours = [{"receive": 30.0, "store": 0.1}, {"receive": 31.0, "store": 0.2}]
    before = [{"receive": 29.0, "gone": 1.0}, {"receive": 33.0}]
    assert differences(ours, before, UNITS) == [Difference("receive", "us", (30.0, 31.0), (29.0, 33.0))]


@pytest.mark.parametrize(
    ("ours", "worse"),
    [((36.4, 40.0), True), ((36.2, 40.0), False), ((40.0, 30.0), False)],
    ids=["every round is beyond noise", "within noise", "one round is as before"],
)
def test_a_figure_is_worse_when_every_round_is_beyond_the_revisions_worst(ours: tuple[float, ...], worse: bool) -> None:
    one = Difference("receive", "us", ours, (29.0, 33.0))
    assert one.worse is worse
    assert one.ratio == min(ours) / 29.0


def test_a_benchmark_that_gives_no_result_is_not_taken_for_the_last_one(tmp_path: Path) -> None:
    (tmp_path / "ci").mkdir()
    program = tmp_path / "ci" / "python"
    program.write_text("#!/bin/sh\nexit 1\n", encoding="utf-8")
    program.chmod(0o755)
    (tmp_path / "build" / "reports").mkdir(parents=True)
    (tmp_path / revisions.RESULT).write_text("[]", encoding="utf-8")
    with pytest.raises(SetUpError, match="planning gave no result"):
        measured(tmp_path, "planning")


def test_how_many_were_measured_is_no_part_of_a_name(tmp_path: Path) -> None:
    (tmp_path / "ci").mkdir()
    program = tmp_path / "ci" / "python"
    rows = json.dumps([{"name": "message to event, p99 of 1412", "unit": "ms", "ours": 3.5}])
    program.write_text(f"#!/bin/sh\nmkdir -p build/reports\necho '{rows}' > {revisions.RESULT}\n", encoding="utf-8")
    program.chmod(0o755)
    assert measured(tmp_path, "event-detector") == (
        {"message to event, p99": 3.5},
        {"message to event, p99": "ms"},
    )


def test_a_working_tree_of_the_revision_goes_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    subprocess.run([*git, "init", "--quiet"], check=True)
    for content in ("before", "now"):
        (tmp_path / "file").write_text(content, encoding="utf-8")
        subprocess.run([*git, "add", "file"], check=True)
        subprocess.run([*git, "commit", "--quiet", "--message", content], check=True)
    monkeypatch.setattr(revisions, "PROJECT", tmp_path)
    with working_tree("HEAD~1") as tree:
        assert (tree / "file").read_text(encoding="utf-8") == "before"
    assert not tree.exists()
    with pytest.raises(SetUpError, match="revision nowhere cannot be measured"), working_tree("nowhere"):
        pass
