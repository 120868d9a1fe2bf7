"""Words of others steer no terminal: an agent's process writes the reason of a task, and a person reads it."""

from __future__ import annotations

import io

import pytest

from robotkube.cli import main as command_line
from robotkube.cli.live.moments import Moment
from robotkube.cli.live.watch import write_moment
from robotkube.cli.output import Table, write
from robotkube.errors import RefusalError

STEERING = "near\x1b]52;c;cm0gLXJm\x07\x1b[2J\x9b1A\u202eab"
SHOWN = "near?]52;c;cm0gLXJm??[2J?1A?ab"


class Terminal(io.StringIO):
    """A stream that is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_cells_of_a_table(stream: type[io.StringIO]) -> None:
    out = stream()
    write(Table("tasks", ("reason",), [{"reason": STEERING}]), "table", out)
    assert SHOWN in out.getvalue()
    assert STEERING not in out.getvalue()


def test_text_is_what_it_is_but_on_a_terminal() -> None:
    """`bundle manifests` prints what is applied, byte by byte."""
    out = io.StringIO()
    terminal = Terminal()
    for stream in (out, terminal):
        write(Table("text", (), [{}], text=f"\ta\n{STEERING}\n"), "table", stream)
    assert (out.getvalue(), terminal.getvalue()) == (f"\ta\n{STEERING}\n", f"\ta\n{SHOWN}\n")


def test_moments_are_a_line_each() -> None:
    out = io.StringIO()
    write_moment(Moment(0, f"event: {STEERING}\nevent: another"), "table", out)
    assert out.getvalue() == f"1970-01-01T00:00:00.000000Z  event: {SHOWN} event: another\n"


def test_problems(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def refused(*_: object) -> None:
        raise RefusalError("Refused", STEERING)

    monkeypatch.setattr(type(command_line.COMMANDS[0]), "run", refused)
    assert command_line.main(["bundle", "show"]) == 1
    assert SHOWN in capsys.readouterr().err
