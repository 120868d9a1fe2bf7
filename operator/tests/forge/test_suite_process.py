"""A suite's process on the real registry with the real helm: what was asked for by digest is what is judged."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from installation import Installation
from programs import program

from robotkube.adapters.chart_folders import pack
from robotkube.adapters.oci_registry import Registry
from robotkube.domain.evidence import Artefact, SuiteResult
from robotkube.domain.suite_requests import SuiteRequest
from robotkube.domain.verification import SuiteRule
from robotkube.entrypoints import suite_process
from robotkube.entrypoints.settings import Credentials, Listen
from robotkube.entrypoints.suite_settings import RunnerConfiguration
from robotkube.services.suite_static import StaticSuite

TOP = Path(__file__).resolve().parents[3]
CHART = "mqtt-bridge"
ENTRY = yaml.safe_load((TOP / "registry" / "charts" / CHART / "0.2.0.yaml").read_text(encoding="utf-8"))
IMAGES = {"ros": "forge.robotkube.svc.cluster.local:3000/robotkube/ros@sha256:" + "0" * 64}
RULE = SuiteRule("static", StaticSuite.version, 60)


@pytest.fixture
def configuration(installation: Installation, monkeypatch: pytest.MonkeyPatch) -> RunnerConfiguration:
    """As the chart writes it, but with this forge's address, and helm where the tests have it."""
    monkeypatch.setenv("ROBOTKUBE_HELM", program("helm"))
    account, base = Credentials("suite-runner", installation.passwords["suite-runner"]), "oci://forge"
    urls = (f"{base}/staging", f"{base}/verified", f"{base}/robotkube")
    return RunnerConfiguration(Listen("127.0.0.1", 0), "info", installation.url, account, *urls, "token", (), "ros@x")


@pytest.fixture
def publisher(installation: Installation) -> Iterator[Registry]:
    with Registry(installation.url, "publisher", installation.passwords["publisher"]) as found:
        yield found


@pytest.fixture
def request_(publisher: Registry) -> SuiteRequest:
    digest = publisher.push_chart("staging", pack(TOP / "charts" / "apps" / CHART, IMAGES, ENTRY["spec"]), "suite")
    artefact = Artefact(CHART, "0.2.0", digest, "linux/amd64")
    return SuiteRequest(artefact, f"staging/{CHART}", "sha256:" + "0" * 64, RULE, ENTRY)


def said(result: SuiteResult) -> str:
    return "\n".join(f"{check.name}: {check.found}" for check in result.failed)


def test_a_chart_of_staging_is_judged(configuration: RunnerConfiguration, request_: SuiteRequest) -> None:
    result = suite_process.run(configuration, request_, "")
    assert (result.outcome, said(result)) == ("passed", "")
    assert len(result.checks) > 10


def test_charts_that_are_not_what_was_asked_for(configuration: RunnerConfiguration, request_: SuiteRequest) -> None:
    run = functools.partial(suite_process.run, configuration, room_name="")
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
