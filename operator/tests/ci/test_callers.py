"""The ready callers for CI systems: YAML whose one command the command line understands."""

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.cli import main as cli
from tests.stages.paths import REPOSITORY

CALLERS = sorted((REPOSITORY / "ci" / "callers").glob("*.yaml"))


def texts(value: Any) -> Iterator[str]:
    """Every text in a document."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from texts(item)
    elif isinstance(value, list):
        for item in value:
            yield from texts(item)


def test_there_is_one_for_each_system() -> None:
    assert [path.stem for path in CALLERS] == ["gitea-actions", "github-actions", "gitlab-ci"]


@pytest.mark.parametrize("path", CALLERS, ids=lambda path: path.stem)
def test_a_caller_is_one_call_of_the_command(path: Path) -> None:
    commands = [text for text in texts(yaml.safe_load(path.read_text())) if "robotkube registry" in text]
    assert len(commands) == 1
    program, *arguments = shlex.split(commands[0])
    assert program == "robotkube"
    options = cli.parser().parse_args(arguments)
    assert options.command.words == ["registry", "submit"]
    assert options.all
    assert options.forge_url == "$FORGE_URL"
    assert str(options.images) == "registry/images.yaml"


@pytest.mark.parametrize("path", CALLERS, ids=lambda path: path.stem)
def test_a_caller_never_shows_the_password(path: Path) -> None:
    for text in texts(yaml.safe_load(path.read_text())):
        assert "--password " not in text
        assert "echo" not in text
