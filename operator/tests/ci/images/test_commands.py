"""Every command that a chart of ours starts is a program of an image of ours: a process that is new in a chart is not
forgotten in the image that it runs in."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from robotkube.delivery.preflight.core.probing.objects import COMMAND as PROBE
from tests.stages.paths import CHARTS, REPOSITORY

IMAGES = REPOSITORY / "operator" / "images"
OURS = re.compile(r"\brobotkube(?:-[a-z]+)+\b")
INSTALL = re.compile(r"&& \S*/install-commands \S+ \S+((?: robotkube[a-z-]*)*)")
CONTINUED = re.compile(r"\s*\\\n\s*")


def _commands_of_charts() -> Iterator[tuple[str, str]]:
    for path in sorted(CHARTS.glob("**/templates/**/*")):
        if path.is_file():
            text = path.read_text(encoding="utf-8")
            for line in text.splitlines():
                if "command" in line:
                    yield from ((word, str(path)) for word in OURS.findall(line) if word in _scripts())


def _scripts() -> set[str]:
    text = (REPOSITORY / "operator" / "pyproject.toml").read_text(encoding="utf-8")
    return set(tomllib.loads(text)["project"]["scripts"])


def _installed() -> set[str]:
    """Commands that some image has; an image that names none has all."""
    names: set[str] = set()
    for path in sorted(IMAGES.glob("*/Dockerfile")):
        for words in _words_of(path):
            names |= set(words.split()) or _scripts()
    return names


def _words_of(path: Path) -> list[str]:
    """The commands that an image's file installs, in one text for each time it does."""
    return INSTALL.findall(CONTINUED.sub(" ", path.read_text(encoding="utf-8")))


def test_every_command_of_a_chart_is_in_an_image() -> None:
    commands = dict(_commands_of_charts())
    assert {"robotkube-gate", "robotkube-inspector", "robotkube-event-detector"} <= commands.keys()
    assert {name: place for name, place in commands.items() if name not in _installed()} == {}


def test_the_platforms_image_has_the_commands_of_its_own_processes() -> None:
    """A process of the platform runs in its image, or in the suites', which stands on that."""
    (words,) = _words_of(IMAGES / "platform" / "Dockerfile")
    own = {word for word, place in _commands_of_charts() if "charts/robotkube/templates/" in place}
    own.add(PROBE)  # of pods that `robotkube preflight --probe` starts
    assert own - set(words.split()) == set()


def test_every_command_that_an_image_names_is_one() -> None:
    assert _installed() - _scripts() == set()
