"""Sources of the catalogue's entries: the platform when one answers, else the sources that lie here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robotkube.cli.main import main
from tests.stages.kubernetes.served_objects import serving
from tests.stages.paths import REPOSITORY

SERVICES = "/api/v1/namespaces/robotkube/services"
MANAGER = f"{SERVICES}/manager:8080/proxy/catalogue"
ENTRY = {"kind": "application", "name": "of-the-platform", "version": "0.1.0", "state": "verified"}
KUBECONFIG = "kubernetes.config.kube_config.KUBE_CONFIG_DEFAULT_LOCATION"
"""The client reads the environment's KUBECONFIG into this when it is imported."""
Answer = Callable[[str, dict[str, list[str]]], dict[str, object] | None]
Run = Callable[..., tuple[int, str, str]]


def platform(path: str, query: dict[str, list[str]]) -> dict[str, object] | None:
    return {"entries": [ENTRY]} if path == MANAGER else None


def platform_by_https(path: str, query: dict[str, list[str]]) -> dict[str, object] | None:
    """Asked in clear text the manager's port refuses."""
    pages: dict[str, dict[str, object]] = {
        f"{SERVICES}/manager": {"spec": {"ports": [{"name": "https", "port": 8080}]}},
        f"{SERVICES}/https:manager:8080/proxy/catalogue": {"entries": [ENTRY]},
    }
    return pages.get(path)


def cluster_without_platform(path: str, query: dict[str, list[str]]) -> None:
    return None


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs a command in the repository's folder."""
    monkeypatch.chdir(REPOSITORY)

    def _run(*words: str) -> tuple[int, str, str]:
        code = main(words)
        out, err = capsys.readouterr()
        return code, out, err

    return _run


@pytest.fixture
def reached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[Path]:
    """The cluster of the default kubeconfig, which answers as the test's parameter does."""
    answer: Answer = request.param
    with serving(answer, tmp_path) as kubeconfig:
        monkeypatch.setattr(KUBECONFIG, str(kubeconfig))
        yield kubeconfig


@pytest.mark.parametrize("reached", [platform, platform_by_https], indirect=True)
def test_the_platform_is_asked_when_it_answers(run: Run, reached: Path) -> None:
    for words in (("search", "of-the"), ("list",), ("show", "of-the-platform")):
        code, out, err = run("registry", *words)
        assert (code, "of-the-platform" in out) == (0, True)
        assert err == "robotkube: from the platform's catalogue; --local: from the sources in registry\n"
    assert run("registry", "list", "--platform")[2] == ""
    code, out, err = run("registry", "list", "--local")
    assert (code, "mqtt-bridge" in out, "of-the-platform" in out, err) == (0, True, False, "")


@pytest.mark.parametrize("reached", [cluster_without_platform], indirect=True)
def test_sources_are_read_where_no_platform_answers_and_that_is_said(
    run: Run, reached: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, err = run("registry", "list")
    assert (code, "mqtt-bridge" in out) == (0, True)
    assert "from the sources in registry, since no platform answers: no Service manager in namespace robotkube" in err
    for words in (("--platform",), ("--kubeconfig", str(reached))):
        assert run("registry", "list", *words)[:2] == (2, "")
    assert run("registry", "list", "--registry", str(REPOSITORY / "registry"))[0] == 0
    monkeypatch.chdir(tmp_path)
    assert run("registry", "list")[:2] == (2, "")


def test_nobody_listens_there(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with serving(platform, tmp_path) as kubeconfig:
        monkeypatch.setattr(KUBECONFIG, str(kubeconfig))
    code, out, err = run("registry", "list")
    assert (code, "mqtt-bridge" in out, "since no platform answers: API server" in err) == (0, True, True)
    assert run("registry", "list", "--platform")[:2] == (3, "")
    monkeypatch.setattr(KUBECONFIG, str(tmp_path / "nowhere"))
    assert "since no platform answers: no access to a cluster" in run("registry", "list")[2]
