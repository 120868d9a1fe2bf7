"""Steps: lines in a log, bars on a terminal, and what the last time took, of work that was done and not of a cache."""

from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from ci import durations, steps
from ci.durations import Durations
from ci.steps import Steps
from robotkube.cli.terminal import bars, screen


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A clock that a test moves."""
    clock = SimpleNamespace(now=100.0)
    for module in (steps, bars):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: clock.now))
    return clock


@pytest.fixture
def kept(tmp_path: Path) -> Durations:
    return Durations(tmp_path)


def test_in_a_log_a_step_has_a_line_when_it_starts_and_one_when_it_ends(
    clock: SimpleNamespace, kept: Durations, capsys: pytest.CaptureFixture[str]
) -> None:
    made = Steps(2, began=clock.now, durations=kept)
    with made.step("image base") as step:
        clock.now += 12.3
        step.note = "cached"
    with pytest.raises(OSError, match="full"), made.step("image pause"):
        raise OSError("full")
    assert capsys.readouterr().err.splitlines() == [
        "[1/2] image base ...",
        "[1/2] image base: 12.3 s (cached), 12 s in all",
        "[2/2] image pause ...",
        "[2/2] image pause: failed after 0.0 s",
    ]
    assert made.seconds == {"image base": 12.3}


def test_what_was_done_anew_is_kept_and_what_came_from_the_cache_is_not(
    clock: SimpleNamespace, kept: Durations
) -> None:
    for seconds, note in ((94, ""), (3, "cached"), (0.2, "")):
        with Steps(1, durations=kept).step("image base") as step:
            clock.now += seconds
            step.note = note
    assert kept.last("image base") == 94
    assert kept.last("image pause") is None


@pytest.mark.parametrize(("notes", "expected"), [(["cached", "cached"], None), (["cached", ""], 12)])
def test_a_step_of_steps_was_done_anew_when_one_of_them_was(
    clock: SimpleNamespace, kept: Durations, notes: list[str], expected: float | None
) -> None:
    with Steps(1, durations=kept).step("images"):
        inner = Steps(len(notes), durations=kept)
        for number, note in enumerate(notes):
            with inner.step(f"image {number}") as step:
                clock.now += 6
                step.note = note
    assert kept.last("images") == expected


def test_a_step_that_fails_says_nothing_of_how_long_it_takes(clock: SimpleNamespace, kept: Durations) -> None:
    def fails() -> None:
        with Steps(1, durations=kept).step("platform"):
            clock.now += 5
            raise OSError("full")

    with pytest.raises(OSError, match="full"):
        fails()
    assert kept.last("platform") is None
    assert steps._running == []


def test_runs_of_different_scenarios_are_not_compared(clock: SimpleNamespace, kept: Durations) -> None:
    with Steps(1, durations=kept).step("scenario", of="three-vehicles"):
        clock.now += 135
    assert kept.last("scenario of three-vehicles") == 135
    assert kept.last("scenario of pose-point-cloud-db-recording") is None


def test_on_a_terminal_a_bar_stands_for_the_line_of_the_start(
    clock: SimpleNamespace, kept: Durations, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=120, height=20)
    shown = screen.Screen(console)
    monkeypatch.setattr(screen, "screen", lambda: shown)
    kept.note("images", 40)
    with Steps(1, began=clock.now, durations=kept).step("images"):
        clock.now += 10
        console.print(shown.drawn())
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "10 of about 40 s, as long as it took the last time" in text
    assert capsys.readouterr().err == "[1/1] images: 10.0 s, 10 s in all\n"


@pytest.mark.parametrize("content", ["", "[]", "{", '{"a": "long"}'])
def test_a_file_that_cannot_be_read_costs_the_estimates_alone(kept: Durations, tmp_path: Path, content: str) -> None:
    (tmp_path / durations.FILE).write_text(content)
    assert kept.last("a") is None
    kept.note("b", 5)
    assert kept.last("b") == 5


def test_the_file_stays_small(kept: Durations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durations, "STEPS_MAX", 3)
    for number in range(5):
        kept.note(f"step {number}", 10 + number)
    assert [kept.last(f"step {number}") for number in range(5)] == [None, None, 12, 13, 14]
    assert [path.name for path in tmp_path.iterdir()] == [durations.FILE]
