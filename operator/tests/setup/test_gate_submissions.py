"""Submissions to the gate as a process, by the command, on a real forge: published, refused, and told before."""

import json
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.cli import main as cli
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.adapters.runner_protocol import RunsEndpoint
from robotkube.testing.publishing import ScriptedRunner
from tests.stages import http_calls
from tests.stages.forge.catalogue_evidence import trusted_keys
from tests.stages.forge.gate_process import (
    PROCESS_SECONDS_MAX,
    answers,
    gate_settings,
    lines,
    secret_file,
    write_settings,
)
from tests.stages.forge.installation import ApplicationSetController, Installation
from tests.stages.forge.real_charts import PACKED_IMAGE
from tests.stages.handshakes import certified, written
from tests.stages.programs import program
from tests.stages.registry.publications import Publishing, look_often, write_sources
from tests.stages.registry.submissions import IMAGE
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

SUITES_TOKEN = "suites token"  # noqa: S105


@pytest.fixture(autouse=True)
def _prompt(monkeypatch: pytest.MonkeyPatch) -> None:
    look_often(monkeypatch)


@pytest.fixture
def authorities(tmp_path: Path) -> Path:
    """The file of who signed the suite-runner's certificate."""
    authority = new_authority("ours", time.time())
    certified(tmp_path / "certificate", authority, "127.0.0.1")
    return written(tmp_path / "authorities", authority)


@pytest.fixture
def runner(authorities: Path, tmp_path: Path) -> Iterator[tuple[ScriptedRunner, str]]:
    """A suite-runner's side by HTTPS whose verdicts the test gives, and its URL."""
    scripted = ScriptedRunner()
    put = RunsEndpoint(SUITES_TOKEN, scripted.run).put
    server = WebServer("127.0.0.1", 0, list, str, put=put, certificate=tmp_path / "certificate")
    server.start()
    yield scripted, f"https://127.0.0.1:{server.port}"
    server.stop()


@pytest.fixture
def gate_url(
    installation: Installation,
    controller: ApplicationSetController,
    runner: tuple[ScriptedRunner, str],
    authorities: Path,
    tmp_path: Path,
) -> Iterator[str]:
    """The gate as a process, with that suite-runner."""
    token = secret_file(tmp_path, "suites/token", SUITES_TOKEN)
    asking = {"suites": {"url": runner[1], "token": token}, "authorities": str(authorities)}
    settings = gate_settings(installation, tmp_path, controller.url) | asking
    command = [sys.executable, "-m", "robotkube.delivery.gate"]
    environment = {**write_settings(tmp_path, settings), "ROBOTKUBE_RENDERER": program("chart-renderer")}
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(command, env=environment, stderr=log)
    try:
        url = f"http://127.0.0.1:{installation.gate_port}"
        until(lambda: answers(f"{url}/readyz") == 200, "ready")
        yield url
        process.send_signal(signal.SIGTERM)
        assert process.wait(PROCESS_SECONDS_MAX) == 0
    finally:
        process.kill()
        process.wait(PROCESS_SECONDS_MAX)


def submit(installation: Installation, folder: Path, *more: str) -> int:
    """The command's exit code."""
    password = secret_file(folder, "publisher", installation.passwords["publisher"])
    images = secret_file(folder, "images.yaml", f"ros: {IMAGE}\n")
    where = ["--charts", str(folder / "charts" / "apps"), "--registry", str(folder / "registry"), "--images", images]
    account = [
        "--forge-url",
        installation.url,
        "--password-file",
        password,
        "--kept",
        str(folder / "kept"),
        "--wait",
        "60",
    ]
    return cli.main(["registry", "submit", *where, *account, *more])


def test_the_gate_process_publishes_what_the_command_submits(
    installation: Installation,
    gate_url: str,
    runner: tuple[ScriptedRunner, str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    name = f"text-{secrets.token_hex(3)}"
    scripted = runner[0]
    write_sources(tmp_path, name)
    scripted.checks["static"] = (Check("probes", False, "no readinessProbe", "add one"),)
    capsys.readouterr()
    assert submit(installation, tmp_path, name, "--application", name) == 1
    printed = capsys.readouterr()
    assert f"static of {name} failed" in printed.err
    assert "found: `no readinessProbe`" in printed.err
    assert "do: add one" in printed.err
    scripted.checks.clear()
    assert submit(installation, tmp_path, name, "--application", name, "--output", "json") == 0
    printed = capsys.readouterr()
    rows = json.loads(printed.out)["submitted"]
    assert [(row["kind"], row["verdict"]) for row in rows] == [("chart", "published"), ("application", "published")]
    assert rows[0]["evidence"].startswith(f"evidence/{name}/0.1.0_")
    assert (tmp_path / "kept" / rows[0]["evidence"]).is_file()
    published_application = catalogue_of(installation).applications[name]
    assert (published_application.assured, published_application.evidence_problem) == (True, "")
    assert submit(installation, tmp_path, name, "--application", name) == 0
    assert f"{name} 0.1.0: published already with this digest" in capsys.readouterr().err
    published = 'robotkube_gate_publications_total{verdict="published"} 1'
    until(
        lambda: published in http_calls.get(f"{gate_url}/metrics").text, "counted, which comes after the push to main"
    )
    metrics = http_calls.get(f"{gate_url}/metrics").text
    assert 'robotkube_gate_publications_total{verdict="refused"} 1' in metrics
    assert 'robotkube_gate_suite_runs_total{suite="static"} 2' in metrics

    def submissions() -> list[dict[str, Any]]:
        return [line for line in lines((tmp_path / "log").read_text()) if line["event"] == "submission"]

    until(lambda: len(submissions()) == 2, "the second submission logged")
    logged = submissions()
    assert [line["verdict"] for line in logged] == ["refused", "published"]
    assert f"{name} 0.1.0" in logged[1]["subject"]


def catalogue_of(installation: Installation) -> Catalogue:
    """The catalogue as managers see it."""
    return EvidenceReader(trusted_keys()).read(Publishing(installation, Path()).main())


def test_the_gate_process_refuses_an_application_whose_parameter_leads_to_a_foreign_image(
    installation: Installation,
    gate_url: str,
    runner: tuple[ScriptedRunner, str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    name = f"text-{secrets.token_hex(3)}"
    foreign = "docker.io/library/busybox@sha256:" + "2" * 64
    write_sources(tmp_path, name)
    image_by_value(tmp_path / "charts" / "apps", name)
    path = tmp_path / "registry" / "applications" / f"{name}.yaml"
    document = yaml.safe_load(path.read_text())
    choices = {"type": "string", "enum": [IMAGE, foreign], "default": IMAGE}
    document["spec"]["parameters"]["properties"]["image"] = choices
    document["spec"]["services"][0]["values"]["image"] = {"reference": "{{ parameters.image }}"}
    path.write_text(yaml.safe_dump(document))
    capsys.readouterr()
    assert submit(installation, tmp_path, name, "--application", name) == 1
    printed = capsys.readouterr().err
    assert f"applications/{name}.yaml: spec.services[0]: with parameters {{'" in printed
    assert f"'image': '{foreign}'" in printed
    assert f": a pod would run image {foreign}, which was not verified with chart" in printed
    assert runner[0].runs == []
    assert name not in catalogue_of(installation).applications


def image_by_value(charts: Path, name: str) -> None:
    """Let the value `image.reference` of a chart name its image, by its library chart."""
    library = charts / "robotkube-app" / "templates" / "_app.tpl"
    text = library.read_text()
    assert PACKED_IMAGE in text
    library.write_text(text.replace(PACKED_IMAGE, f"(.root.Values.image).reference | default ({PACKED_IMAGE})"))
    schema = json.loads((charts / name / "values.schema.json").read_text())
    reference = {"type": "string", "description": "The image."}
    schema["properties"]["image"] = {
        "type": "object",
        "description": "The image.",
        "additionalProperties": False,
        "properties": {"reference": reference},
    }
    (charts / name / "values.schema.json").write_text(json.dumps(schema))


def test_wrong_sources_are_told_before_anything_is_sent(
    installation: Installation, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"text-{secrets.token_hex(3)}"
    write_sources(tmp_path, name)
    path = tmp_path / "registry" / "charts" / name / "0.1.0.yaml"
    path.write_text(path.read_text().replace("  channel: ", "  chanel: "))
    assert submit(installation, tmp_path, name) == 2
    printed = capsys.readouterr().err
    assert f"{path}: spec.chanel: unknown key; remove it" in printed
    assert f"{path}: spec.channel: missing" in printed
    assert "nothing was submitted" in printed
    assert submit(installation, tmp_path) == 2
    assert "name charts, applications (--application NAME), or --all" in capsys.readouterr().err
