"""Every import contract is broken once, in a copy of the sources, and said to be."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib

import pytest

from ci.check import tools
from tests.stages.paths import REPOSITORY

LINT = "import sys; from importlinter.cli import lint_imports_command as lint; sys.argv.append('--no-cache'); lint()"
VIOLATIONS = {  # what a contract's name begins with -> file below operator/src or the repository, import that breaks it
    "Floors": ("robotkube/foundation/documents/core/times.py", "import robotkube.delivery.gate.core.verdict_comments"),
    "Subjects form no circle": (
        "robotkube/registry/charts/core/packing.py",
        "import robotkube.registry.suites.core.requests",
    ),
    "Inside a subject": (
        "robotkube/delivery/gate/loops/gate.py",
        "import robotkube.delivery.gate.adapters.merge_journal",
    ),
    "A core is pure": ("robotkube/robots/rules/core/conditions/levels.py", "import time"),
    "Ports and loops": ("robotkube/delivery/manager/loops/planner.py", "import kubernetes"),
    "ROS is known": ("robotkube/robots/bridge/loops/bridge.py", "import rclpy"),
    "Nothing that runs": ("robotkube/delivery/manager/loops/planner.py", "import robotkube.testing.clusters"),
    "Benchmarks know": ("ci/errors.py", "import scenarios.steps"),
    "Layers of ci": ("ci/evidence.py", "import ci.toolchain.go"),
    "Packages of ci form no circle": (
        "ci/cluster/embedded/network/pod_links.py",
        "import ci.cluster.embedded.network_policies.controller",
    ),
    "Layers of benchmarks": ("benchmarks/files.py", "import benchmarks.registry.catalogue"),
    "Packages of benchmarks form no circle": (
        "benchmarks/delivery/decisions.py",
        "import benchmarks.delivery.application_manager",
    ),
    "Layers of scenarios": ("scenarios/network.py", "import scenarios.steps"),
    "Layers of the runner": ("scenarios/runner/inputs.py", "import scenarios.runner.waiting"),
    "Packages of scenarios form no circle": (
        "scenarios/runner/judging/encounters.py",
        "import scenarios.runner.judging.measures",
    ),
}


def contracts() -> list[str]:
    files = [(REPOSITORY / "operator" / name).read_text(encoding="utf-8") for name in tools.CONTRACTS]
    documents = [tomllib.loads(text)["tool"]["importlinter"] for text in files]
    return [contract["name"] for document in documents for contract in document["contracts"]]


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Contract -> KEPT or BROKEN, of a copy in which every violation stands."""
    top = tmp_path_factory.mktemp("copy")
    for folder in ("benchmarks", "ci", "scenarios"):
        shutil.copytree(REPOSITORY / folder, top / folder, ignore=shutil.ignore_patterns("__pycache__", "*.mcap"))
    source = REPOSITORY / "operator/src/robotkube"
    shutil.copytree(source, top / "operator/src/robotkube", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copyfile(REPOSITORY / "operator/pyproject.toml", top / "operator/pyproject.toml")
    for file, line in VIOLATIONS.values():
        place = top / ("operator/src" if file.startswith("robotkube/") else "") / file
        place.write_text(f"{place.read_text(encoding='utf-8')}\n{line}\n", encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": f"{top / 'operator/src'}{os.pathsep}{top}", "COLUMNS": "500"}
    said = ""
    for name in tools.CONTRACTS:
        command = [sys.executable, "-c", LINT, "--config", name]
        said += subprocess.run(
            command, cwd=top / "operator", env=environment, capture_output=True, text=True, timeout=120, check=False
        ).stdout
    return dict(re.findall(r"^(.+) (KEPT|BROKEN)$", said, re.MULTILINE))


@pytest.mark.parametrize("contract", contracts())
def test_a_violation_is_found(verdicts: dict[str, str], contract: str) -> None:
    assert verdicts[contract] == "BROKEN"


def test_every_contract_is_broken_on_purpose() -> None:
    assert [name for name in contracts() if not name.startswith(tuple(VIOLATIONS))] == []
