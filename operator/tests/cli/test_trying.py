"""`robotkube registry try` where little is there: what it cannot run it says, with the reason."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli.main import main
from robotkube.cli.registry.trying import _table
from robotkube.registry.evidence.core.statements import Check, SuiteResult
from robotkube.registry.publication.loops.trying import TriedSuite
from tests.stages.kubernetes.served_objects import serving
from tests.stages.registry.publications import write_sources

Try = Callable[..., tuple[int, str, str]]
CHART = "charts/apps/delivery-order"


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One service, no helm and no cluster."""
    folder = tmp_path / "sources"
    write_sources(folder, "delivery", "--services", "order")
    monkeypatch.setenv("ROBOTKUBE_HELM", "/nowhere/helm")
    monkeypatch.setenv("KUBECONFIG", "/nowhere/kubeconfig")
    monkeypatch.setattr("kubernetes.config.kube_config.KUBE_CONFIG_DEFAULT_LOCATION", "/nowhere/kubeconfig")
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def run(sources: Path, capsys: pytest.CaptureFixture[str]) -> Try:
    capsys.readouterr()

    def _run(*words: str) -> tuple[int, str, str]:
        code = main(["registry", "try", *words])
        out, err = capsys.readouterr()
        return code, out, err

    return _run


def rows(out: str) -> dict[str, dict[str, Any]]:
    return {row["suite"]: row for row in json.loads(out)["suites"]}


def test_what_a_passed_check_has_not_shown_is_said() -> None:
    evidence = "it opened the topics of two, and its pod stayed; not shown: values.greeting"
    checks = (Check("stays", True, "as before"), Check("takes-changed-settings", True, evidence))
    result = SuiteResult("install", "3", "passed", checks, 2.0)
    table = _table([TriedSuite("order", "0.1.0", "install", result)], [], [])
    assert f"\n\ninstall of order, takes-changed-settings: {evidence}\n" in str(table.text)
    assert [row.get("reservations") for row in table.rows] == [[{"name": "takes-changed-settings", "found": evidence}]]


@pytest.mark.parametrize("words", [(), ("--quick",)])
def test_without_helm_nothing_is_proved(run: Try, words: tuple[str, ...]) -> None:
    """The static checks need nothing else: whoever asked for them learns by the exit code that they were not made."""
    code, out, err = run(*words)
    assert code == 4
    assert "nothing is proved: static of delivery-order was not run: there is no program helm; install it, or" in err
    suites = ("static", "images", "interface", "install")
    everything = "; ".join(f"{suite} of delivery-order" for suite in suites)
    assert f"not run: {everything}: there is no program helm" in out
    assert "not run: trial of delivery: made by the gate when you submit" in out


@pytest.fixture
def _helm(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that cannot be started: a suite that needs it comes to no end."""
    helm = sources.parent / "helm"
    helm.write_text("no program")
    monkeypatch.setenv("ROBOTKUBE_HELM", str(helm))


@pytest.mark.usefixtures("_helm")
def test_a_suite_that_comes_to_no_end_has_not_passed(run: Try) -> None:
    code, out, error = run(CHART, "-o", "json")
    assert (code, rows(out)["static"]["outcome"]) == (3, "unfinished")
    assert "came to no end: static of delivery-order" in error
    assert "trial" not in rows(out)


@pytest.mark.usefixtures("_helm")
def test_without_a_cluster_images_are_not_looked_at(run: Try) -> None:
    row = rows(run(CHART, "-o", "json")[1])["images"]
    assert row["outcome"] == "not run"
    words = "no platform is reached by KUBECONFIG /nowhere/kubeconfig: no access to a cluster"
    assert words in row["reason"]
    for suite in ("interface", "install"):
        reason = rows(run(CHART, "-o", "json")[1])[suite]["reason"]
        assert reason.startswith(f"needs a cluster: {words}")


@pytest.mark.usefixtures("_helm")
def test_a_quick_one_says_that_it_is(run: Try) -> None:
    assert rows(run(CHART, "--quick", "-o", "json")[1])["install"]["reason"] == "--quick runs nothing on a cluster"


@pytest.mark.usefixtures("_helm")
def test_a_forge_alone_runs_nothing(run: Try, tmp_path: Path) -> None:
    (tmp_path / "password").write_text("secret")
    forge = ("--forge-url", "http://127.0.0.1:1", "--password-file", str(tmp_path / "password"))
    row = rows(run(CHART, *forge, "-o", "json")[1])["install"]
    assert row["reason"] == "needs a cluster: --forge-url names a forge alone"


@pytest.mark.usefixtures("_helm")
def test_a_cluster_without_the_platform_is_named(run: Try, tmp_path: Path) -> None:
    with serving(lambda path, query: None, tmp_path) as kubeconfig:
        _, out, _ = run(CHART, "--kubeconfig", str(kubeconfig), "-o", "json")
    words = f"no platform is reached by --kubeconfig {kubeconfig}: no Service forge in namespace robotkube"
    assert words in rows(out)["images"]["reason"]


def test_mistakes_in_the_sources_come_before_any_suite(run: Try, sources: Path) -> None:
    entry = sources / "registry" / "charts" / "delivery-order" / "0.1.0.yaml"
    entry.write_text(entry.read_text().replace("channel: candidate", "channel: canal"))
    code, out, error = run()
    assert (code, out) == (2, "")
    assert "in the sources, nothing was tried:" in error
    assert "spec.channel" in error


def test_what_is_not_there_is_refused(run: Try) -> None:
    code, _, error = run("charts/apps/nothing")
    assert code == 2
    assert "charts/apps/nothing: neither the folder of a chart" in error
