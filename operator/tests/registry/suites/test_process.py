"""A suite's process on the real registry with the real helm: what was asked for by digest is what is judged."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from robotkube.cli import main as cli
from robotkube.foundation.runtime.settings_file import Credentials, Listen
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.evidence.core.statements import Artefact, SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites import run_process
from robotkube.registry.suites.core.requests import SuiteRequest
from robotkube.registry.suites.loops.static import StaticSuite
from robotkube.registry.suites.settings import RunnerConfiguration
from tests.stages.forge.installation import Installation
from tests.stages.paths import REPOSITORY
from tests.stages.programs import program
from tests.stages.registry import chart_images
from tests.stages.registry.publications import write_sources

pytestmark = pytest.mark.toolchain

CHART = "mqtt-bridge"
ENTRY = yaml.safe_load((REPOSITORY / "registry" / "charts" / CHART / "0.2.3.yaml").read_text(encoding="utf-8"))
IMAGES = chart_images.all_as("forge.robotkube.svc.cluster.local:3000/robotkube/image@sha256:" + "0" * 64)
RULE = SuiteRule("static", StaticSuite.version, 60)


@pytest.fixture
def configuration(installation: Installation, monkeypatch: pytest.MonkeyPatch) -> RunnerConfiguration:
    """As the chart writes it, but with this forge's address, and helm where the tests have it."""
    monkeypatch.setenv("ROBOTKUBE_HELM", program("helm"))
    account = Credentials("suite-runner", installation.passwords["suite-runner"])
    base = "oci://forge"
    urls = (f"{base}/staging", f"{base}/verified", f"{base}/robotkube")
    return RunnerConfiguration(Listen("127.0.0.1", 0), "info", installation.url, account, *urls, "token", (), "ros@x")


@pytest.fixture
def gate_registry(installation: Installation) -> Iterator[OciRegistry]:
    with OciRegistry(installation.url, "gate", installation.passwords["gate"]) as client:
        yield client


@pytest.fixture
def request_(gate_registry: OciRegistry) -> SuiteRequest:
    digest = gate_registry.push_chart(
        "staging", pack(REPOSITORY / "charts" / "apps" / CHART, IMAGES, ENTRY["spec"]), "suite"
    )
    artefact = Artefact(CHART, "0.2.3", digest, "linux/amd64")
    return SuiteRequest(artefact, f"staging/{CHART}", "sha256:" + "0" * 64, RULE, ENTRY)


def said(result: SuiteResult) -> str:
    return "\n".join(f"{check.name}: {check.found}" for check in result.failed)


def test_a_chart_of_staging_is_judged(configuration: RunnerConfiguration, request_: SuiteRequest) -> None:
    result = run_process.run(configuration, request_, "")
    assert (result.outcome, said(result)) == ("passed", "")
    assert len(result.checks) > 10


def test_charts_that_are_not_what_was_asked_for(configuration: RunnerConfiguration, request_: SuiteRequest) -> None:
    run = functools.partial(run_process.run, configuration, namespace="")
    artefact = request_.artefact
    for wrong, words in (
        (replace(request_, artefact=replace(artefact, digest="sha256:" + "1" * 64)), "1111"),
        (replace(request_, artefact=replace(artefact, version="0.9.0")), "asked for was mqtt-bridge 0.9.0"),
        (replace(request_, repository=f"verified/{CHART}"), "must be in staging"),
        (replace(request_, rule=SuiteRule("static", "9", 60)), f"this platform has {StaticSuite.version}"),
        (replace(request_, rule=SuiteRule("dynamic", "1", 60)), "there is no suite dynamic"),
    ):
        result = run(request=wrong)
        assert result.outcome == "unfinished"
        assert words in said(result)


def test_what_is_tried_before_is_judged_by_the_same_checks(
    configuration: RunnerConfiguration, gate_registry: OciRegistry, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`registry try` and the suite-runner on one chart, with a mistake: digest, checks and words are the same."""
    write_sources(tmp_path, "delivery", "--services", "plan")
    chart, entry = tmp_path / "charts" / "apps" / "delivery-plan", tmp_path / "registry" / "charts" / "delivery-plan"
    values = chart / "values.yaml"
    values.write_text(values.read_text().replace("limits: {memory: 256Mi}", "limits: {}"))
    images = tmp_path / "images.yaml"
    images.write_text(yaml.safe_dump(IMAGES))
    capsys.readouterr()
    assert cli.main(["registry", "try", str(chart), "--images", str(images), "-o", "json"]) == 1
    out = capsys.readouterr()
    assert "failed: static of delivery-plan" in out.err
    tried = json.loads(out.out)["suites"][0]
    document = yaml.safe_load((entry / "0.1.0.yaml").read_text())
    digest = gate_registry.push_chart("staging", pack(chart, IMAGES, document["spec"]), "tried")
    artefact = Artefact("delivery-plan", "0.1.0", digest, "linux/amd64")
    request = SuiteRequest(artefact, "staging/delivery-plan", "sha256:" + "0" * 64, RULE, document)
    result = run_process.run(configuration, request, "")
    assert (tried["suite"], tried["outcome"], tried["checks"]) == ("static", result.outcome, len(result.checks))
    assert tried["failures"] == [{"name": c.name, "found": c.found, "fix": c.fix} for c in result.failed]
    assert [failure["name"] for failure in tried["failures"]] == ["resources"]
