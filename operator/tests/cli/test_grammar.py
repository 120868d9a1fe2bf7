"""The command line's grammar: every command is there, and a command reads only what it needs."""

from __future__ import annotations

import subprocess
import sys

import pytest

from robotkube.cli import main as cli

SEEN = "import sys; from robotkube.cli.main import grammar_of; grammar_of(sys.argv[1:]); print(*sys.modules)"


@pytest.mark.parametrize("command", cli.COMMANDS, ids=lambda command: "-".join(command.words))
def test_a_command_is_what_its_row_says(command: cli.Command) -> None:
    parser = cli.grammar_of(command.words)
    assert parser.format_usage().startswith("usage: ")
    assert callable(getattr(command._imported(), command.function))


def test_every_command_is_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["--help"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert {command.noun for command in cli.COMMANDS} <= set(out.split())


@pytest.mark.parametrize("words", [["task", "lsit"], ["tsak"], ["task"], []])
def test_what_is_no_command_is_refused_with_what_there_is(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(words)
    assert ended.value.code == cli.EXIT_USAGE
    assert "usage: robotkube" in capsys.readouterr().err


def test_a_command_imports_no_other_and_no_cluster_that_it_does_not_need() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SEEN, "registry", "new"], capture_output=True, text=True, timeout=60, check=True
    )
    modules = set(done.stdout.split())
    assert "robotkube.cli.registry.new" in modules
    assert not {"robotkube.cli.audit", "robotkube.cli.platform", "kubernetes"} & modules
