"""`robotkube watch`: lines in a pipe, a view above which they go by on a terminal, and how it ends."""

from __future__ import annotations

import io
import json
from types import SimpleNamespace

import pytest
from rich.console import Console

from robotkube.cli import main as cli
from robotkube.cli.live import watch
from robotkube.cli.live.moments import Moment
from robotkube.cli.terminal import screen
from tests.stages.live_platform import NOW, LivePlatformInMemory, node, task

MOMENT = Moment(NOW, "deployment merged: releases: 1 new", 4, "07a9365612abcdef")


@pytest.fixture
def platform(monkeypatch: pytest.MonkeyPatch) -> LivePlatformInMemory:
    platform = LivePlatformInMemory()
    monkeypatch.setattr(watch, "Platform", lambda options: _filled(platform))
    monkeypatch.setattr(watch, "STEP_SECONDS", 0.01)
    return platform


def _filled(platform: LivePlatformInMemory) -> SimpleNamespace:
    """Its watches are made by the feed; what is there is put before they start."""

    def watch_tasks(changed: object) -> object:
        started = platform.watch_tasks(changed)  # type: ignore[arg-type]
        started.put(task("one"))
        return started

    def watch_of_agents(kind: str, reduce: object, changed: object) -> object:
        started = platform.watch_of_agents(kind, reduce, changed)  # type: ignore[arg-type]
        if kind == "nodes":
            started.put(node("vehicle-00"))
        return started

    return SimpleNamespace(
        watch_tasks=watch_tasks, watch_of_agents=watch_of_agents, page=platform.page, detector_metrics=dict
    )


@pytest.mark.parametrize(
    ("form", "text"),
    [
        ("table", "2026-11-18T11:06:40.000000Z  deployment merged: releases: 1 new  #4  07a9365612\n"),
        (
            "json",
            '{"commit": "07a9365612abcdef", "pull_request": 4, "time": "2026-11-18T11:06:40.000000Z", '
            '"trouble": false, "what": "deployment merged: releases: 1 new"}\n',
        ),
    ],
)
def test_a_moment_is_one_line(form: str, text: str) -> None:
    stream = io.StringIO()
    watch.write_moment(MOMENT, form, stream)
    assert stream.getvalue() == text


def test_in_a_pipe_it_is_lines_alone(platform: LivePlatformInMemory, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["watch", "--seconds", "0.05", "-o", "json"]) == cli.EXIT_DONE
    out, err = capsys.readouterr()
    assert json.loads(out)["what"] == "task cloud-0/one stands: New"
    assert err == ""


@pytest.mark.parametrize(("words", "drawn"), [([], True), (["--lines"], False), (["-o", "json"], False)])
def test_on_a_terminal_the_view_is_drawn_unless_lines_are_asked_for(
    platform: LivePlatformInMemory, monkeypatch: pytest.MonkeyPatch, words: list[str], drawn: bool
) -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=100, height=30)
    shown = screen.Screen(console)
    monkeypatch.setattr(screen, "screen", lambda: shown)
    assert cli.main(["watch", "--seconds", "0.05", *words]) == cli.EXIT_DONE
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert ("1 of 1 agents ready, 1 task" in text) == drawn


def test_an_api_server_that_does_not_answer(
    platform: LivePlatformInMemory, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = _filled(platform)

    def silent(changed: object) -> object:
        started = platform.watch_tasks(changed)  # type: ignore[arg-type]
        started.answers = False
        return started

    made.watch_tasks = silent
    monkeypatch.setattr(watch, "Platform", lambda options: made)
    assert cli.main(["watch", "--seconds", "1"]) == cli.EXIT_UNREACHABLE
    assert "tasks cannot be watched: nobody answers" in capsys.readouterr().err


@pytest.mark.parametrize("seconds", ["0", "-1", "86401"])
def test_seconds_have_bounds(seconds: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["watch", "--seconds", seconds]) == cli.EXIT_USAGE
    assert "give seconds above 0, at most 86400" in capsys.readouterr().err
