"""What the documentation names exists: files and headings behind links, targets of make, commands of robotkube."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotkube.entrypoints import cli
from scenarios.runner import looking_around

TOP = Path(__file__).resolve().parents[3]
PAGES = sorted(
    path
    for pattern in (
        "README.md",
        "docs/**/*.md",
        "gitops/**/*.md",
        "charts/**/README.md",
        "ci/**/*.md",
        "registry/README.md",
        "scenarios/**/*.md",
    )
    for path in TOP.glob(pattern)
)
LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#{1,6} +(.+?) *$", re.MULTILINE)
CODE = re.compile(r"```.*?```|`[^`\n]+`", re.DOTALL)
MAKE = re.compile(r"\bmake ([a-z][a-z-]*)")
COMMAND = re.compile(r"(?:(?<!-n )\brobotkube|robotkube\.entrypoints\.cli) ([a-z]+) ([a-z]+)\b")
MODULE = re.compile(r"-m ((?:ci|scenarios|robotkube)(?:\.\w+)+)(?![.\w])")


def name_of(path: Path) -> str:
    return str(path.relative_to(TOP))


def code(page: Path) -> Iterator[str]:
    """Code blocks and code within the text; prose may say "make sure"."""
    yield from CODE.findall(page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as forges make them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in HEADING.findall(text)}


def verbs() -> dict[str, set[str]]:
    """Noun -> verbs of the command line's own parser."""
    found: dict[str, set[str]] = {}
    for noun, parser in choices(cli.parser(cli.commands())).items():
        found[noun] = set(choices(parser))
    return found


def choices(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(actions[0].choices) if actions else {}


def broken_links(page: Path) -> Iterator[str]:
    for link in LINK.findall(CODE.sub("`code`", page.read_text(encoding="utf-8"))):
        if re.match(r"[a-z]+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if not target.exists():
            yield f"{link}: there is no such file"
        elif anchor and anchor not in anchors(target):
            yield f"{link}: no such heading; there are {', '.join(sorted(anchors(target)))}"


def test_the_pages_are_found() -> None:
    assert {"README.md", "docs/tutorials/use-case.md", "docs/decisions/README.md"} <= {name_of(page) for page in PAGES}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    assert list(broken_links(page)) == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_make_targets_exist(page: Path) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (TOP / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert {target for text in code(page) for target in MAKE.findall(text)} <= targets


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_exist(page: Path) -> None:
    known = verbs()
    named = {
        pair
        for text in code(page)
        for line in text.splitlines()
        for pair in COMMAND.findall(line)
        if "helm" not in line
    }
    assert [f"{noun} {verb}" for noun, verb in sorted(named) if verb not in known.get(noun, ())] == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_modules_that_are_run_exist(page: Path) -> None:
    for module in {module for text in code(page) for module in MODULE.findall(text)}:
        root = TOP / "operator/src" if module.startswith("robotkube") else TOP
        path = root / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module


def test_every_target_of_make_runs_a_module_that_exists() -> None:
    for module in re.findall(r"\$\(PYTHON\) -m (ci[.\w]*)", (TOP / "Makefile").read_text(encoding="utf-8")):
        path = TOP / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module


def test_every_command_is_in_the_reference() -> None:
    text = (TOP / "docs/reference/command-line.md").read_text(encoding="utf-8")
    assert [
        f"{noun} {verb}" for noun, found in verbs().items() for verb in found if f"robotkube {noun} {verb}" not in text
    ] == []


def test_every_decision_is_in_the_index_and_numbers_have_no_gap() -> None:
    folder = TOP / "docs/decisions"
    names = sorted(path.name for path in folder.glob("[0-9]*.md"))
    index = (folder / "README.md").read_text(encoding="utf-8")
    assert [int(name[:4]) for name in names] == list(range(1, len(names) + 1))
    assert [name for name in names if f"]({name})" not in index] == []
    assert [
        name for name in names if not (folder / name).read_text(encoding="utf-8").startswith(f"# {name[:4]}: ")
    ] == []


def test_the_tutorial_runs_what_the_run_prints() -> None:
    text = (TOP / "docs/tutorials/use-case.md").read_text(encoding="utf-8")
    for noun, verb in (("plan", "list"), ("release", "list"), ("task", "list"), ("recording", "list")):
        assert f"{looking_around.ROBOTKUBE} {noun} {verb}" in text


def test_a_broken_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# Here it is\n[a](#here-it-is) [b](#there) [c](nowhere.md) [d](https://example.org/x)\n", encoding="utf-8"
    )
    assert [text.partition(":")[0] for text in broken_links(page)] == ["#there", "nowhere.md"]
