"""What a person types: the list of targets, and wrong input to `make demo` and `make cluster`, which ends with one
sentence and exit code 1 before anything is started.

Wrong values of a chart: tests/charts/test_refusals.py. A wrong rule: tests/robots/detector/test_settings.py. A wrong
bag: tests/robots/bags/test_player.py and tests/ci/scenarios/test_generator.py. A wrong catalogue file:
tests/registry/catalogue/test_catalogue.py. Every key of a scenario: tests/ci/scenarios/test_definition.py.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from ci import folders
from ci.cluster.k3s import provider as k3s
from scenarios import demo

pytestmark = pytest.mark.processes

SCENARIO = folders.PROJECT / "scenarios" / "pose-point-cloud-db-recording"
SECONDS_MAX = 60


def command(*words: str, home: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run in the project's folder; with `home` everything that would be cached is missing."""
    made_by_make = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")  # a make inside a make says which folder it enters
    environment = {name: value for name, value in os.environ.items() if name not in made_by_make}
    if home is not None:
        environment |= {"HOME": str(home), "XDG_CACHE_HOME": str(home)}
    return subprocess.run(
        words,
        cwd=folders.PROJECT,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=SECONDS_MAX,
        check=False,
    )


def refused(home: Path, *words: str) -> str:
    """The one sentence of a command that refuses its input; nothing was printed besides, and nothing was begun."""
    done = command(sys.executable, "-m", *words, home=home)
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stdout == ""
    [line] = done.stderr.splitlines()
    assert list(home.iterdir()) == []
    return line.removeprefix("error: ")


@pytest.fixture
def home(tmp_path: Path) -> Path:
    folder = tmp_path / "home"
    folder.mkdir()
    return folder


def test_help_lists_every_target() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (folders.PROJECT / "Makefile").read_text(), re.MULTILINE))
    assert {"demo", "test", "test-fast", "test-thorough", "check", "bench", "cluster", "status", "down"} <= targets
    for words in (("make",), ("make", "help")):
        lines = [line.split(maxsplit=2) for line in command(*words).stdout.splitlines()]
        assert {line[1] for line in lines} == targets
        assert all(len(line) == 3 for line in lines), "a target without a word about it"


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("vehicles", "--set vehicles: must be PARAMETER=VALUE, for example vehicles=3"),
        ("wheels=4", "has no parameter 'wheels'; it has: vehicles, "),
        ("vehicles=one", "scenario.yaml: parameters.vehicles: 'one' is not of type 'integer'"),
        ("vehicles=[", "--set vehicles=[: [ is no number"),
        ("encounters=0", "scenario.yaml: parameters.encounters: 0 is less than the minimum of 1"),
        ("stop_distance_m=300", "scenario.yaml: parameters.stop_distance_m: 300 must be greater than start_distance_m"),
        ("speed_mps=40", "speed_mps: 40: an encounter would last"),
    ],
)
def test_a_wrong_parameter_ends_the_demo_before_its_beginning(
    home: Path, setting: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(home))
    monkeypatch.setattr(sys, "argv", ["demo", str(SCENARIO), "--set", setting])
    assert demo.main() == 1
    printed = capsys.readouterr()
    assert (printed.out, list(home.iterdir())) == ("", [])
    [line] = printed.err.splitlines()
    assert message in line.removeprefix("error: ")


@pytest.mark.parametrize(
    ("kind", "first"),
    [
        ("k3d", "CLUSTER=k3d: there is no such kind of cluster; there is embedded: "),
        ("k3s", "{home}/k3s.yaml: is not there, so no server of k3s runs on this machine"),
        ("existing", "kubectl's kubeconfig: Invalid kube-config"),
    ],
)
def test_a_cluster_that_cannot_run_it_ends_the_demo_before_its_beginning(
    home: Path, kind: str, first: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(home))
    monkeypatch.delenv("KUBECONFIG", raising=False)
    monkeypatch.setattr(k3s, "KUBECONFIG", home / "k3s.yaml")
    monkeypatch.setattr(sys, "argv", ["demo", str(SCENARIO), "--cluster", kind])
    assert demo.main() == 1
    printed = capsys.readouterr()
    assert (printed.out, list(home.iterdir())) == ("", [])
    assert printed.err.removeprefix("error: ").startswith(first.format(home=home))


def test_a_wrong_scenario_ends_the_demo_before_its_beginning(home: Path, tmp_path: Path) -> None:
    assert "there is no such file; give the folder of a scenario" in refused(
        home, "scenarios.demo", str(tmp_path / "none")
    )
    document = yaml.safe_load((SCENARIO / "scenario.yaml").read_text())
    document["story"]["rules"] = document["story"].pop("rule")
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(document))
    said = refused(home, "scenarios.demo", str(tmp_path))
    assert said.startswith(f"{tmp_path}/scenario.yaml: story: ")
    assert "allowed: the keys application, " in said


def test_a_wrong_topology_ends_the_cluster_before_its_beginning(home: Path, tmp_path: Path) -> None:
    (tmp_path / "scenario.yaml").write_text("topology: {nodes: [{name: a, role: vehicle, agent: a}]}\n")
    said = refused(home, "ci.cluster", "up", "--topology", str(tmp_path / "scenario.yaml"))
    assert said.startswith(f"{tmp_path}/scenario.yaml: topology.nodes[0].capacity: is missing; add")


def test_another_name_of_a_cluster_is_a_matter_of_usage() -> None:
    done = command(sys.executable, "-m", "scenarios.demo", str(SCENARIO), "--name", "mine")
    assert done.returncode == 2
    assert "argument --name: invalid choice: 'mine'" in done.stderr
