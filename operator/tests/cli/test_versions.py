"""The versions of the program and of what it talks to."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from robotkube import VERSION
from robotkube.cli.main import main
from tests.stages.kubernetes.served_objects import serving
from tests.stages.paths import REPOSITORY

DEPLOYMENT = "/apis/apps/v1/namespaces/robotkube/deployments/manager"
MANAGER = {
    "metadata": {"labels": {"helm.sh/chart": "robotkube-0.1.0"}},
    "spec": {"template": {"spec": {"containers": [{"image": "forge.example/robotkube/platform@sha256:12"}]}}},
}


def answer(path: str, query: dict[str, list[str]]) -> dict[str, object] | None:
    return {"/version": {"gitVersion": "v1.34.1"}, DEPLOYMENT: MANAGER}.get(path)


def test_program_and_platform(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with serving(answer, tmp_path) as kubeconfig:
        words = ["version", "--kubeconfig", str(kubeconfig), "--output", "json"]
        assert main(words) == 0
        rows = json.loads(capsys.readouterr().out)["versions"]
        assert {row["program"]: row["version"] for row in rows} == {
            "robotkube": VERSION,
            "kubernetes": "v1.34.1",
            "platform": "robotkube-0.1.0",
            "manager": "forge.example/robotkube/platform@sha256:12",
        }
        assert main([*words, "--manager", "north"]) == 3
        assert "no Deployment north in namespace robotkube" in capsys.readouterr().err


def test_the_program_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["version", "--client"]) == 0
    assert capsys.readouterr().out.split() == ["PROGRAM", "VERSION", "robotkube", VERSION]
    assert main(["version", "--kubeconfig", str(tmp_path / "nowhere")]) == 3
    out, err = capsys.readouterr()
    why = f"the platform's version is not known: no access to a cluster: there is no file {tmp_path / 'nowhere'}"
    assert (out.split()[-1], why in err) == (VERSION, True)


def test_the_chart_has_the_version_of_the_program() -> None:
    chart = yaml.safe_load((REPOSITORY / "charts" / "robotkube" / "Chart.yaml").read_text(encoding="utf-8"))
    assert chart["appVersion"] == VERSION
