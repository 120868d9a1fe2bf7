"""`robotkube wait`: how it ends when its time is over, and what a line is."""

from __future__ import annotations

import argparse
import io
from types import SimpleNamespace
from typing import Any

import pytest

from robotkube.cli.live.component_lines import DONE, NOT_READY, READY, ComponentLine
from robotkube.cli.live.waiting import end_unready, write_line
from robotkube.errors import RefusalError, UnavailableError

OPTIONS = argparse.Namespace(seconds=300.0, output="table")
HANGS = ComponentLine("forge", NOT_READY, 300.0, ("pod forge-0: Pending",))


def watch(*hanging: ComponentLine, complaint: str = "") -> Any:
    return SimpleNamespace(complaint=complaint, lines=SimpleNamespace(hanging=lambda: hanging))


def test_what_hangs_ends_it(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RefusalError, match=r"after 300 s not ready: forge$"):
        end_unready(watch(HANGS, HANGS), OPTIONS)
    assert capsys.readouterr().out == "forge is not ready: pod forge-0: Pending\n" * 2


def test_what_is_not_seen_is_not_said_to_hang(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UnavailableError, match="after 300 s what is ready is not known: pods: no answer"):
        end_unready(watch(HANGS, complaint="pods: no answer"), OPTIONS)
    assert capsys.readouterr().out == ""


def test_the_last_one_may_become_ready_at_the_end() -> None:
    end_unready(watch(), OPTIONS)


@pytest.mark.parametrize(
    ("form", "text"),
    [
        ("table", "forge: ready after 9.3 s\n"),
        ("json", '{"component": "forge", "reasons": [], "seconds": 9.3, "state": "ready"}\n'),
        ("yaml", "---\ncomponent: forge\nreasons: []\nseconds: 9.3\nstate: ready\n"),
    ],
)
def test_a_component_is_one_line(form: str, text: str) -> None:
    stream = io.StringIO()
    write_line(ComponentLine("forge", READY, 9.3), form, stream)
    assert stream.getvalue() == text


def test_what_others_wrote_does_not_steer_a_terminal() -> None:
    stream = io.StringIO()
    write_line(ComponentLine("forge", NOT_READY, 0.0, ("event Failed: \x1b[2J",)), "table", stream)
    assert stream.getvalue() == "forge is not ready: event Failed: ?[2J\n"
    assert ComponentLine("bootstrap", DONE, 1.0).words == "bootstrap: done after 1.0 s"
