"""`robotkube registry new` and then `try`, with the real helm: an application of three services, in seconds."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from robotkube.cli.main import main
from tests.stages.programs import program
from tests.stages.registry.publications import write_sources

pytestmark = pytest.mark.toolchain

SERVICES = ("order", "plan", "drive")
PROCESSOR_SECONDS_MAX = 10.0  # demanded of three charts; it takes 3


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_sources(tmp_path, "delivery", "--services", ",".join(SERVICES))
    monkeypatch.setenv("ROBOTKUBE_HELM", program("helm"))
    monkeypatch.setattr("kubernetes.config.kube_config.KUBE_CONFIG_DEFAULT_LOCATION", "/nowhere/kubeconfig")
    return tmp_path


def processor_seconds() -> float:
    """Of this process and of those that it waited for."""
    return sum(os.times()[:4])


def test_a_new_application_passes_as_it_is(sources: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    began = processor_seconds()
    assert main(["registry", "try", str(sources), "-o", "json"]) == 0
    assert processor_seconds() - began < PROCESSOR_SECONDS_MAX
    rows = json.loads(capsys.readouterr().out)["suites"]
    static = {row["name"]: (row["outcome"], row["failures"]) for row in rows if row["suite"] == "static"}
    assert static == {f"delivery-{service}": ("passed", []) for service in SERVICES}
    assert all(row["reason"] for row in rows if row["suite"] != "static")


def test_a_failed_suite_says_what_and_what_to_do(sources: Path, capsys: pytest.CaptureFixture[str]) -> None:
    template = sources / "charts" / "apps" / "delivery-plan" / "templates" / "_app.tpl"
    template.write_text(template.read_text().replace("serviceAccount: application", "serviceAccount: admin"))
    capsys.readouterr()
    assert main(["registry", "try", str(sources / "registry" / "applications" / "delivery.yaml")]) == 1
    out, error = capsys.readouterr()
    assert "static of delivery-plan failed:\n- service-account\n  found: " in out
    assert "  do: " in out
    assert "robotkube: failed: static of delivery-plan\n" in error
    assert "not run: interface of every chart; install of every chart: needs a cluster: no platform is reached" in out
    assert "not run: trial of delivery: made by the gate when you submit" in out
