"""What the documentation names exists: targets of make, modules, commands of robotkube. Links: test_links.py."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from robotkube.cli import main as cli
from scenarios.runner.platform import inspection
from tests.stages.paths import REPOSITORY

PAGES = sorted(
    path
    for pattern in (
        "*.md",
        "docs/**/*.md",
        "gitops/**/*.md",
        "charts/**/README.md",
        "ci/**/*.md",
        "registry/README.md",
        "scenarios/**/*.md",
    )
    for path in REPOSITORY.glob(pattern)
)
CODE = re.compile(r"```.*?```|`[^`\n]+`", re.DOTALL)
MAKE = re.compile(r"\bmake ([a-z][a-z0-9-]*)")
COMMAND = re.compile(r"(?:(?<!-n )\brobotkube|robotkube\.cli) ([a-z]+) ([a-z]+)\b")
MODULE = re.compile(r"-m ((?:ci|scenarios|robotkube)(?:\.\w+)+)(?![.\w])")


def name_of(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def code(page: Path) -> Iterator[str]:
    """Code blocks and code within the text; prose may say "make sure"."""
    yield from CODE.findall(page.read_text(encoding="utf-8"))


@cache
def verbs() -> dict[str, set[str]]:
    """Noun -> verbs of the command line's own parser."""
    of_nouns: dict[str, set[str]] = {}
    for noun, parser in nouns().items():
        of_nouns[noun] = set(choices(parser))
    return of_nouns


@cache
def nouns() -> dict[str, argparse.ArgumentParser]:
    """Noun -> its parser, of the command line's own parser."""
    return choices(cli.parser())


def words_of(noun: str) -> set[str]:
    """The words that may follow a noun: its verbs, or what its first argument may be."""
    parser = nouns().get(noun, argparse.ArgumentParser())
    return {word for action in parser._actions if not action.option_strings for word in action.choices or ()}


def choices(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(actions[0].choices) if actions else {}


def test_the_pages_are_found() -> None:
    assert {"README.md", "docs/tutorials/use-case.md", "docs/decisions/README.md"} <= {name_of(page) for page in PAGES}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_make_targets_exist(page: Path) -> None:
    targets = set(re.findall(r"^([a-z0-9-]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert {target for text in code(page) for target in MAKE.findall(text)} <= targets


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_exist(page: Path) -> None:
    named = {
        pair
        for text in code(page)
        for line in text.splitlines()
        for pair in COMMAND.findall(line)
        if "helm" not in line
    }
    assert [f"{noun} {verb}" for noun, verb in sorted(named) if verb not in words_of(noun)] == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_modules_that_are_run_exist(page: Path) -> None:
    for module in {module for text in code(page) for module in MODULE.findall(text)}:
        root = REPOSITORY / "operator/src" if module.startswith("robotkube") else REPOSITORY
        path = root / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module


def test_every_target_of_make_runs_a_module_that_exists() -> None:
    for module in re.findall(r"\$\(PYTHON\) -m (ci[.\w]*)", (REPOSITORY / "Makefile").read_text(encoding="utf-8")):
        path = REPOSITORY / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module


def test_every_command_is_in_the_reference() -> None:
    text = (REPOSITORY / "docs/reference/command-line.md").read_text(encoding="utf-8")
    assert [
        f"{noun} {verb}" for noun, known in verbs().items() for verb in known if f"robotkube {noun} {verb}" not in text
    ] == []


def test_every_decision_is_in_the_index_and_numbers_have_no_gap() -> None:
    folder = REPOSITORY / "docs/decisions"
    names = sorted(path.name for path in folder.glob("[0-9]*.md"))
    index = (folder / "README.md").read_text(encoding="utf-8")
    assert [int(name[:4]) for name in names] == list(range(1, len(names) + 1))
    assert [name for name in names if f"]({name})" not in index] == []
    assert [
        name for name in names if not (folder / name).read_text(encoding="utf-8").startswith(f"# {name[:4]}: ")
    ] == []


def test_the_tutorial_runs_what_the_run_prints() -> None:
    text = (REPOSITORY / "docs/tutorials/use-case.md").read_text(encoding="utf-8")
    for noun, verb in (("plan", "list"), ("release", "list"), ("task", "list"), ("recording", "list")):
        assert f"{inspection.ROBOTKUBE} {noun} {verb}" in text
