"""Every chart version that the application registry lists, and the platform's chart, start programs that exist: each
command is in the image it runs in, leads to a function of today's package, and its process begins.

Versions stay listed for years, so a console script that is renamed would break those that were published before.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci.images.services import GROUND, SERVICES
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.suites.loops.installation import filled_sets
from tests.stages.commands import local_command, scripts
from tests.stages.paths import CHARTS, REGISTRY, REPOSITORY
from tests.stages.registry import chart_images
from tests.stages.registry.charts_under_test import subject_of

pytestmark = pytest.mark.toolchain

ENTRIES = sorted((REGISTRY / "charts").glob("*/*.yaml"))
APPLICATIONS = [path for path in CHARTS.glob("*/*/Chart.yaml") if (path.parent / "values.yaml").exists()]
IMAGES = {name: f"registry.example/robotkube/{name}@sha256:{'5' * 64}" for name in chart_images.NAMES}
INSTALLED = re.compile(r"install-commands \S+ \S+((?:[ \\\n]+robotkube[a-z-]*)+)")
PROBES = ("startupProbe", "readinessProbe", "livenessProbe")
USAGE = 2  # the exit code of a process whose settings or arguments are wrong
START_SECONDS_MAX = 60


@dataclass(frozen=True)
class Start:
    """What a container starts: `place` says which one, `image` is the name of its image."""

    place: str
    image: str
    command: tuple[str, ...]


@cache
def commands_of_images() -> Mapping[str, frozenset[str]]:
    """Image with the package in it -> the console scripts that it has."""
    own = {service.name: frozenset(service.commands) for service in SERVICES}
    for name in (GROUND, "platform"):
        text = (REPOSITORY / "operator" / "images" / name / "Dockerfile").read_text(encoding="utf-8")
        [words] = INSTALLED.findall(text)
        own[name] = frozenset(words.replace("\\", " ").split())
    return own


def folder_of(entry: Path) -> Path:
    """The chart's folder of a registry entry."""
    folders = [path.parent for path in APPLICATIONS if version_of(path) == (entry.parent.name, entry.stem)]
    assert len(folders) == 1, f"{entry}: the folders of this version below charts are {folders}; there must be one"
    return folders[0]


def version_of(chart_file: Path) -> tuple[str, str]:
    metadata = yaml.safe_load(chart_file.read_text(encoding="utf-8"))
    return metadata["name"], metadata["version"]


def starts_of_version(chart: Path, entry: Path, work: Path) -> list[Start]:
    """What a version starts with each of its test sets, and what prepares them."""
    subject = subject_of(chart, entry, work, IMAGES)
    starts: list[Start] = []
    for test_set in filled_sets(subject.entry, "vehicle-00", 1, Jinja2Templates().render):
        place = f"{chart.name} {subject.artefact.version}, set {test_set.name}"
        starts += starts_in(place, subject.render(test_set.values, chart.name))
        if test_set.prepare_image:
            starts.append(Start(f"{place}: prepare", test_set.prepare_image, test_set.prepare_command))
    return starts


def starts_in(place: str, objects: list[dict[str, Any]]) -> Iterator[Start]:
    """What the containers of all pod templates start, and what the kubelet starts in them."""
    for item in objects:
        pod = item.get("spec", {}).get("template", {}).get("spec", {}) if item["kind"] != "Pod" else item["spec"]
        for container in [*pod.get("initContainers", ()), *pod.get("containers", ())]:
            name = f"{place}: {item['kind']} {item['metadata']['name']}, container {container['name']}"
            image = container["image"].partition("@")[0].rpartition("/")[2].partition(":")[0]
            yield Start(name, image, (*container.get("command", ()), *container.get("args", ())))
            hooks = [container.get(probe) for probe in PROBES] + [*container.get("lifecycle", {}).values()]
            for hook in hooks:
                if hook and "exec" in hook:
                    yield Start(name, image, tuple(hook["exec"]["command"]))


def problem(start: Start, targets: Mapping[str, str]) -> str:
    """Why what is started does not exist, in one sentence; empty when it does, or when the image is none of ours."""
    known = commands_of_images().get(start.image)
    if known is None:
        return ""
    program = start.command[0] if start.command else "nothing"
    if program not in known:
        return f"{start.place} starts {program}; image {start.image} has {', '.join(sorted(known))}"
    if program not in targets:
        return f"{start.place} starts {program}, which is not in [project.scripts] of operator/pyproject.toml"
    module, _, function = targets[program].partition(":")
    try:
        target = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        return f"{start.place} starts {program}, that is {targets[program]}: {error}"
    return "" if callable(target) else f"{start.place} starts {program}: {targets[program]} cannot be called"


def problems(starts: list[Start]) -> list[str]:
    """A sentence for each command that does not exist."""
    return [sentence for start in starts if (sentence := problem(start, scripts()))]


@cache
def first_words(program: str) -> Mapping[str, Any]:
    """What a program logs that gets neither arguments nor settings. It has imported all that it needs by then."""
    done = subprocess.run(
        local_command([program]),
        env={**os.environ, "ROBOTKUBE_CONFIG": "/nowhere/config.yaml"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=START_SECONDS_MAX,
        check=False,
    )
    assert done.returncode == USAGE, f"{program} ended with {done.returncode}: {done.stderr}"
    [line] = done.stderr.splitlines()
    return dict(json.loads(line))


def programs_begin(starts: list[Start]) -> bool:
    """Assert that what is started exists, and that programs of ours refuse to go on without settings or arguments."""
    assert "\n".join(problems(starts)) == ""
    programs = {start.command[0] for start in starts if start.image in commands_of_images()}
    for program in programs:
        said = first_words(program)
        assert said["event"] == "refused", said
        assert re.match(r"/nowhere/config\.yaml: |usage: |give two arguments: ", said["error"]), said
    return bool(programs)


def test_every_version_of_a_chart_is_listed_and_every_listed_one_is_there() -> None:
    listed = [(entry.parent.name, entry.stem) for entry in ENTRIES]
    assert sorted(map(version_of, APPLICATIONS)) == sorted(listed)
    assert len(listed) >= 9


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: f"{entry.parent.name}-{entry.stem}")
def test_a_listed_version_starts_programs_that_exist(entry: Path, tmp_path: Path) -> None:
    assert programs_begin(starts_of_version(folder_of(entry), entry, tmp_path))


@pytest.mark.parametrize("profile", ["official", "embedded"])
def test_the_platform_starts_programs_that_exist(request: pytest.FixtureRequest, profile: str) -> None:
    rendered = request.getfixturevalue(profile)
    starts = list(starts_in("robotkube", rendered.objects))
    assert len(starts) >= len(rendered.pods)
    assert programs_begin(starts)


def test_a_version_that_starts_what_is_not_there_is_named(tmp_path: Path) -> None:
    chart, entry = tmp_path / "bag-player", REGISTRY / "charts" / "bag-player" / "0.1.3.yaml"
    for name in ("bag-player", "robotkube-app"):
        shutil.copytree(CHARTS / "apps" / name, tmp_path / name, symlinks=True)
    template = chart / "templates" / "_app.tpl"
    text = template.read_text(encoding="utf-8")
    template.write_text(text.replace("[robotkube-player]", "[robotkube-play]"), encoding="utf-8")
    starts = starts_of_version(chart, entry, tmp_path)
    assert problems(starts) == [
        f"bag-player 0.1.3, set {name}: Deployment bag-player, container bag-player starts robotkube-play; "
        "image bag-player has robotkube-player, robotkube-sample-bag"
        for name in ("first", "second")
    ]


@pytest.mark.parametrize(
    ("image", "command", "target", "sentence"),
    [
        ("ros", "robotkube-player", "", ", which is not in [project.scripts] of operator/pyproject.toml"),
        ("ros", "robotkube-gate", "", "; image ros has robotkube-bridge, "),
        (
            "ros",
            "robotkube-player",
            "robotkube.robots.bags.entry:main",
            "No module named 'robotkube.robots.bags.entry'",
        ),
        ("ros", "robotkube-player", "robotkube.robots.bags.__main__:start", "has no attribute 'start'"),
        ("ros", "robotkube-player", "robotkube.robots.bags.__main__:GRACE_SECONDS", " cannot be called"),
        ("bag-player", "robotkube-bridge", "", "; image bag-player has robotkube-player, robotkube-sample-bag"),
        ("bag-player", "", "", "starts nothing; image bag-player has "),
    ],
)
def test_what_is_not_there_is_said(image: str, command: str, target: str, sentence: str) -> None:
    start = Start("a container", image, (command,) if command else ())
    assert sentence in problem(start, {command: target} if target else {})
