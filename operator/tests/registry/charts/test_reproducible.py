"""Every chart packed twice, in two folders by two processes that differ in all that must not matter, has one digest."""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from robotkube.foundation.documents.core.yaml_codec import read_mapping
from tests.stages.paths import REPOSITORY
from tests.stages.registry.wrong_interfaces import write_chart

pytestmark = pytest.mark.processes

APPS = REPOSITORY / "charts" / "apps"
CHARTS = sorted(path.parent.name for path in APPS.glob("*/values.yaml"))
SECONDS_MAX = 60
CODE = """
import json, sys
from pathlib import Path
from robotkube.registry.charts.adapters.chart_folders import pack
services = "bag-player event-detector mqtt-bridge object-detection object-tracking"
images = {name: f"host/{name}@sha256:1" for name in ("ros", "platform", *services.split())}
packed = [pack(Path(folder), images, json.loads(sys.argv[1])) for folder in sys.argv[2:]]
print(json.dumps({one.name: one.digest for one in packed}))
"""
HERE = {"TZ": "UTC", "LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "1"}
THERE = {"TZ": "Asia/Tokyo", "LC_ALL": "POSIX", "PYTHONHASHSEED": "2", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}


def digests(folders: list[Path], environment: Mapping[str, str], cwd: Path, umask: int) -> dict[str, str]:
    spec = {"version": "0.1.0", "resources": {"memory": "64Mi", "cpu": "30m"}}
    words = dict(reversed(spec.items())) if umask else spec
    command = [sys.executable, "-c", CODE, json.dumps(words), *map(str, folders)]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        timeout=SECONDS_MAX,
        cwd=cwd,
        env={**os.environ, **environment},
        umask=umask,
    )
    by_chart: dict[str, str] = json.loads(done.stdout)
    return by_chart


def copied(source: Path, target: Path) -> Path:
    """The folder once more: made in another order, by names that differ, with other times and modes."""
    for path in sorted(source.rglob("*"), reverse=True):
        place = target / path.relative_to(source)
        place.parent.mkdir(parents=True, exist_ok=True)
        if path.is_symlink():
            place.symlink_to(path.readlink())
        elif path.is_file():
            shutil.copyfile(path, place)
            place.chmod(stat.S_IRUSR | stat.S_IXUSR)
            os.utime(place, (1, 1))
    return target


def test_there_are_charts() -> None:
    assert {"bag-player", "event-detector", "mqtt-bridge"} <= set(CHARTS)


def test_packaged_charts_have_one_digest_wherever_they_are_packed(tmp_path: Path) -> None:
    first = digests([APPS / name for name in CHARTS], HERE, REPOSITORY, 0)
    elsewhere = copied(APPS, tmp_path / "a folder" / "ä")
    second = digests([elsewhere / name for name in CHARTS], THERE, tmp_path, 0o077)
    assert set(first) == set(CHARTS)
    assert first == second


def test_a_new_application_has_one_digest_wherever_it_is_made(tmp_path: Path) -> None:
    charts = [write_chart("text-relay", {}, tmp_path / place)[0] for place in ("one", "two")]
    os.utime(charts[1] / "values.yaml", (1, 1))
    assert digests(charts[:1], HERE, tmp_path, 0) == digests(charts[1:], THERE, REPOSITORY, 0o077)


@pytest.mark.parametrize("name", CHARTS)
def test_the_entry_belongs_to_the_chart_that_is_packed(name: str) -> None:
    version = read_mapping((APPS / name / "Chart.yaml").read_text(encoding="utf-8"), name)["version"]
    assert (REPOSITORY / "registry" / "charts" / name / f"{version}.yaml").is_file()
