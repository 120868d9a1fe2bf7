"""`robotkube preflight` where helm, rights or the API server are missing: what could not be looked at is said, and is
never ok."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli.cluster.preflight import shown
from robotkube.cli.main import EXIT_REFUSED, EXIT_UNREACHABLE, EXIT_USAGE, main
from robotkube.delivery.preflight import facts
from robotkube.delivery.preflight.core.checks import CHECKS
from robotkube.delivery.preflight.core.findings import FAILED, NOT_CHECKED, OK, ClusterFinding, Problem
from robotkube.delivery.preflight.core.probing.checks import PROBE_CHECKS
from tests.stages.kubernetes.served_objects import FORBIDDEN, serving
from tests.stages.paths import CHARTS, REPOSITORY

VALUES = "agents: [{name: cloud-0, role: cloud}]\n"
EMPTY: dict[str, Any] = {"metadata": {}, "items": []}
PAGE = REPOSITORY / "docs/reference/preflight.md"


@pytest.fixture(autouse=True)
def without_helm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOTKUBE_HELM", "/nowhere/helm")


def answer(path: str, query: dict[str, list[str]]) -> dict[str, Any] | None:
    if path == "/api/v1/nodes":
        return FORBIDDEN
    return {"gitVersion": "v1.28.3"} if path == "/version" else EMPTY


def command(folder: Path, kubeconfig: Path, text: str = VALUES, *more: str) -> list[str]:
    (folder / "values.yaml").write_text(text)
    words = ["preflight", "--kubeconfig", str(kubeconfig), "--chart", str(CHARTS / "robotkube")]
    return [*words, "--values", str(folder / "values.yaml"), *more]


def test_what_could_not_be_looked_at(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with serving(answer, tmp_path) as kubeconfig:
        assert main(command(tmp_path, kubeconfig, VALUES, "-o", "json")) == EXIT_REFUSED
    out, err = capsys.readouterr()
    checks = {one["check"]: one for one in json.loads(out)["checks"]}
    assert list(checks) == [check.name for check in CHECKS]
    assert checks["version"]["result"] == FAILED
    assert (checks["agents"]["result"], "403 forbidden" in checks["agents"]["says"]) == (NOT_CHECKED, True)
    assert "there is no program helm; install it, or name it in ROBOTKUBE_HELM" in checks["rights"]["says"]
    assert "checks failed: version" in err
    assert "checks could not look: " in err


def test_a_key_that_the_chart_does_not_know_and_a_secret_that_is_not_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"{VALUES}gates: {{}}\nsecrets: {{seed: [hunter2]}}\n"
    with serving(answer, tmp_path) as kubeconfig:
        assert main(command(tmp_path, kubeconfig, text)) == EXIT_REFUSED
    out, err = capsys.readouterr()
    assert "values, top: Additional properties are not allowed ('gates' was unexpected)" in out
    assert "values, secrets.seed: this value is not of type 'string'" in out
    assert "fix: correct or remove the key; charts/robotkube/README.md lists the keys" in out
    assert "hunter2" not in out + err


def test_nobody_answers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with serving(answer, tmp_path) as kubeconfig:
        pass
    assert main(command(tmp_path, kubeconfig)) == EXIT_UNREACHABLE
    out, err = capsys.readouterr()
    assert "failed" not in out
    assert "Connection refused" in err


def test_an_api_server_that_never_answers_is_given_up(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(facts, "SECONDS_MAX", 0.3)
    ended = threading.Event()

    def never(path: str, query: dict[str, list[str]]) -> None:
        ended.wait(10)

    with serving(never, tmp_path) as kubeconfig:
        started = time.monotonic()
        try:
            assert main(command(tmp_path, kubeconfig)) == EXIT_UNREACHABLE
        finally:
            ended.set()
        assert time.monotonic() - started < 5
    assert "timed out: version was not read within 0.3 s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("--chart", "nowhere: there is no such chart; name its folder or archive with --chart"),
        ("--values", "nowhere: No such file or directory; name a file of values with --values"),
        ("--registry-ca", "nowhere: no certificate of an authority as PEM"),
    ],
)
def test_wrong_input_ends_before_anything_is_read(
    option: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with serving(answer, tmp_path) as kubeconfig:
        assert main(command(tmp_path, kubeconfig, VALUES, option, str(tmp_path / "nowhere"))) == EXIT_USAGE
    out, err = capsys.readouterr()
    assert out == ""
    assert words in err


def test_what_people_read() -> None:
    problem = Problem("no Node has the label", "agent vehicle-00", "nothing runs", "kubectl label node")
    judged = [ClusterFinding("version", OK, "v1.36.3"), ClusterFinding("agents", FAILED, "1 agent", (problem,))]
    table = shown([*judged, ClusterFinding("capacity", NOT_CHECKED, "nodes is forbidden")])
    assert table.text == (
        "ok           version   v1.36.3\n"
        "failed       agents    1 agent\n"
        "    agent vehicle-00: no Node has the label\n"
        "        why: nothing runs\n"
        "        fix: kubectl label node\n"
        "not checked  capacity  nodes is forbidden\n"
    )
    assert table.refusal == "1 of 3 checks failed: agents"
    assert table.reservation == "1 of 3 checks could not look: capacity"


def test_every_check_is_in_the_reference() -> None:
    table = PAGE.read_text(encoding="utf-8").partition("## Checks")[2].splitlines()
    rows = [line.split("|")[1].strip(" `") for line in table if line.startswith("| `")]
    assert rows == [check.name for check in (*CHECKS, *PROBE_CHECKS)]
