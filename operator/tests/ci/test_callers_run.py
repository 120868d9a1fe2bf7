"""The ready callers of CI systems, run as their runners run them: their own shell lines, this project installed."""

from __future__ import annotations

import os
import re
import secrets
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.stages.forge.installation import Installation
from tests.stages.paths import REPOSITORY
from tests.stages.registry.publications import write_sources
from tests.stages.registry.submissions import IMAGE

pytestmark = pytest.mark.toolchain

CALLERS = sorted((REPOSITORY / "ci" / "callers").glob("*.yaml"))
INSTALLING = re.compile(r"^(?:apt-get|pip) ")
EXPRESSION = re.compile(r"\$\{\{ *(vars|secrets)\.(\w+) *\}\}")
SECONDS_MAX = 60


def job(document: Mapping[str, Any]) -> tuple[list[str], dict[str, str]]:
    """The shell lines of the one job, without those that install something, and its environment."""
    jobs = document.get("jobs") or {name: value for name, value in document.items() if "script" in value}
    (single,) = jobs.values()
    lines = [step["run"] for step in single["steps"] if "run" in step] if "steps" in single else single["script"]
    return [line for line in lines if not INSTALLING.match(line)], dict(single.get("env", {}))


def installed(folder: Path) -> str:
    """A PATH that begins with the program `robotkube`, as pip would have made it."""
    program = folder / "bin" / "robotkube"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m robotkube.cli "$@"\n')
    program.chmod(0o755)
    return f"{program.parent}{os.pathsep}{os.environ['PATH']}"


@pytest.mark.parametrize("path", CALLERS, ids=lambda path: path.stem)
def test_a_caller_submits_everything_there_is(installation: Installation, tmp_path: Path, path: Path) -> None:
    name = f"text-{secrets.token_hex(3)}"
    write_sources(tmp_path, name)
    (tmp_path / "registry" / "images.yaml").write_text(f"ros: {IMAGE}\n")
    password = tmp_path / "password"
    password.write_text(installation.passwords["publisher"])
    given = {"FORGE_URL": installation.url, "PUBLISHER_PASSWORD": password.read_text()}
    lines, variables = job(yaml.safe_load(path.read_text()))
    environment = {key: EXPRESSION.sub(lambda found: given[found[2]], value) for key, value in variables.items()}
    script = "\n".join([*lines[:-1], f"{lines[-1]} --dry-run --output yaml"]).replace("/tmp/", f"{tmp_path}/")  # noqa: S108
    done = subprocess.run(
        ["sh", "-euc", script],
        cwd=tmp_path,
        env={
            **environment,
            "FORGE_URL": installation.url,
            "PATH": installed(tmp_path),
            "PYTHONPATH": str(REPOSITORY / "operator" / "src"),
            "RUNNER_TEMP": str(tmp_path),
            "PUBLISHER_PASSWORD_FILE": str(password),
        },
        capture_output=True,
        text=True,
        timeout=SECONDS_MAX,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    rows = yaml.safe_load(done.stdout)["submitted"]
    assert [(row["kind"], row["name"], row["verdict"]) for row in rows] == [
        ("chart", f"{name} 0.1.0", "planned"),
        ("application", name, "planned"),
    ]
    assert installation.passwords["publisher"] not in done.stdout + done.stderr
