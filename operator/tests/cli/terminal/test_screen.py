"""What is drawn on a terminal: parts below lines that stay, gone when they end; bars that promise nothing they cannot
know."""

from __future__ import annotations

import io
import sys

import pytest
from rich.console import Console
from rich.text import Text

from robotkube.cli.terminal import screen
from robotkube.cli.terminal.bars import bar, estimate, working


def recorded() -> screen.Screen:
    return screen.Screen(Console(file=io.StringIO(), force_terminal=True, width=80, height=20))


def text(shown: screen.Screen) -> str:
    return shown.console.file.getvalue()  # type: ignore[attr-defined,no-any-return]


def test_parts_are_drawn_below_each_other_and_then_gone() -> None:
    shown = recorded()
    with shown.showing(lambda: Text("the fleet")), shown.showing(lambda: Text("waiting")):
        assert [line.rstrip() for line in _rows(shown)] == ["the fleet", "waiting"]
        print("a line that stays", file=sys.stderr)
    assert "a line that stays" in text(shown)
    assert text(shown).rindex("a line that stays") < text(shown).rindex("\x1b[?25h"), "the cursor is shown again"


def test_a_long_line_is_not_broken_and_one_without_an_end_is_not_lost() -> None:
    """Commands that are printed are there to be copied."""
    shown = recorded()
    command = f"git clone {'x' * 200} deployment"
    with shown.showing(lambda: Text("the fleet")):
        print(command, file=sys.stderr)
        sys.stderr.write("half")
        sys.stderr.write(" a line")
    assert command in text(shown)
    assert "half a line" in text(shown)
    assert not isinstance(sys.stderr, screen.LinesAbove)


def test_a_thousand_lines_cost_one_redraw(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is drawn costs a demo nothing, however much goes by above it: it is drawn when it begins, with the lines
    when it ends, and not for each of them."""
    monkeypatch.setattr(screen, "REDRAWS_PER_SECOND", 0.01)
    redraws = 0

    def part() -> Text:
        nonlocal redraws
        redraws += 1
        return Text("the fleet")

    shown = recorded()
    with shown.showing(part):
        for number in range(1000):
            print(f"line {number}", file=sys.stderr)
    assert redraws <= 2
    assert [f"line {number}\n" in text(shown) for number in (0, 500, 999)] == [True] * 3


def _rows(shown: screen.Screen) -> list[str]:
    console = Console(file=io.StringIO(), width=80)
    console.print(shown.drawn())
    return console.file.getvalue().splitlines()  # type: ignore[attr-defined,no-any-return]


def test_a_failure_takes_the_part_away() -> None:
    shown = recorded()
    with pytest.raises(ValueError, match="broken"), shown.showing(lambda: Text("x")):
        raise ValueError("broken")
    assert shown._drawing is None


def test_without_a_terminal_there_is_no_screen() -> None:
    screen.screen.cache_clear()
    assert screen.screen() is None
    with screen.showing(lambda: pytest.fail("it is drawn")):
        pass


@pytest.mark.parametrize(
    ("taken", "last", "words"),
    [
        (3, None, "3 s; how long it takes is not known yet"),
        (3, 94, "3 of about 94 s, as long as it took the last time"),
        (120, 94, "120 s, longer than the 94 s of the last time"),
    ],
)
def test_an_estimate_is_what_the_last_time_took_or_none(taken: float, last: float | None, words: str) -> None:
    assert estimate(taken, last) == words


def test_a_bar_and_a_command_at_work() -> None:
    console = Console(file=io.StringIO(), width=100)
    console.print(bar("[8/15] image platform", 0.0, None)())
    console.print(working("robotkube audit", 0.0)())
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert "[8/15] image platform" in shown
    assert "how long it takes is not known yet" in shown
    assert "robotkube audit: " in shown
