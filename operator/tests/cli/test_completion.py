"""Completion of the command line, by a real shell."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from robotkube.cli.main import main

pytestmark = pytest.mark.processes
ASKED = """
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(( $# - 1 )); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
complete -p robotkube >/dev/null && _shtab_robotkube && echo "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("completion") / "robotkube.bash"


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        (("ver",), {"version"}),
        (("registry", "s"), {"search", "show", "submit"}),
        (("registry", "search", "--chan"), {"--channel"}),
        (("task", "list", "--output", "y"), {"yaml"}),
    ],
)
def test_bash(script: Path, words: tuple[str, ...], completed: set[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    script.write_text(capsys.readouterr().out)
    command = ["bash", "--norc", "-c", ASKED, "bash", str(script), "robotkube", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    assert set(done.stdout.split()) == completed


@pytest.mark.parametrize("shell", ["fish", "zsh"])
def test_other_shells_get_every_noun(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither is at hand: what they make of it is not tried."""
    assert main(["completion", shell]) == 0
    out = capsys.readouterr().out
    assert all(noun in out for noun in ("registry", "task", "recording", "completion"))
