"""The small scenario end to end on the real platform, and what a person can look at afterwards."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from ci.folders import PROJECT
from robotkube.cli import main as cli
from scenarios.runner.platform import inspection
from tests.stages.platform.running_platform import Platform
from tests.stages.platform.story import Story

COMMANDS_SECONDS_MAX = 120
TRAILERS = ("Task", "Event", "Rule", "Trace", "Plan", "Chart", "Evidence")
ENFORCE = "pod-security.kubernetes.io/enforce"


def test_every_expectation_holds(story: Story) -> None:
    """With the bounds of time of the small variant; the scenario's own are the demo's to prove."""
    rows = story.report["expectations"]
    failed = [row for row in rows if not row["passed"]]
    assert failed == [], f"{story.talk[-3000:]}\n{story.output[-3000:]}"
    assert [row["name"] for row in rows if row["measured"] is None] == []
    assert len(rows) >= 14
    assert story.report["passed"]
    assert story.code == 0
    assert story.report["nodes"] == 5


def test_the_timeline_shows_the_way_from_event_to_removal(story: Story) -> None:
    for step in ("players start", "proposed", "merged", "first point cloud stored", "Applications and pods gone"):
        assert step in story.output


def test_every_change_on_main_has_its_pull_request_and_trailers(story: Story) -> None:
    events = [entry for entry in story.report["audit"] if entry["event"]]
    assert len(events) == 2
    for entry in events:
        assert entry["pull_request"]
        assert {f"RobotKube-{name}" for name in TRAILERS} <= set(entry["trailers"])


def test_everything_that_ran_had_evidence(story: Story) -> None:
    entries = story.report["evidence"]
    assert {entry["chart"] for entry in entries} == {"mqtt-bridge", "event-detector", "bag-player"}
    assert all(re.fullmatch("sha256:[0-9a-f]{64}", entry["evidence"]) for entry in entries)
    assert not any("assurance" in text for text in story.report["warnings"])


def test_the_gate_has_signed_for_what_the_story_brought_to_main(
    platform: Platform, story: Story, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cluster that was kept may have others: tests of refusals bring some to main past the gate."""
    commits = {entry["commit"] for entry in story.report["audit"] if entry["event"]}
    code = cli.main(["status", "--kubeconfig", str(platform.installer.kubeconfig), "-o", "json"])
    said = capsys.readouterr()
    rows = json.loads(said.out)["unchecked"]
    assert code == (1 if rows else 0), said.err
    assert commits
    assert {row["commit"] for row in rows} & commits == set()


def test_the_commands_to_look_around_work(platform: Platform, story: Story, tmp_path: Path) -> None:
    """In one shell, as pasted; in a folder that looks like the project's, since one of them makes a clone."""
    for entry in PROJECT.iterdir():
        if not entry.name.startswith("."):
            (tmp_path / entry.name).symlink_to(entry)
    forge = platform.access.endpoint("forge")  # as a person reaches it, not this process
    commands = list(inspection.commands(platform.scenario, platform.installer.kubeconfig, forge))
    assert all(command in story.output for _, command in commands)
    script = "\n".join(f"echo '== {number}'\n{command}" for number, (_, command) in enumerate(commands))
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        cwd=tmp_path, capture_output=True, text=True, timeout=COMMANDS_SECONDS_MAX, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    answers = [part.partition("\n")[2] for part in done.stdout.split("== ")[1:]]
    shown = dict(zip((what.split(",")[0].split(" (")[0] for what, _ in commands), answers, strict=True))
    assert "vehicle-02" in shown["machines and their roles"]
    assert "cloud-0-mqtt-bridge" in shown["what Argo CD runs"]
    assert "RobotKube-Task: cloud-0/" in shown["every change with its cause"]
    silent = {"use this cluster", "tasks", "who signed the forge's certificate", "the deployment repository"}
    assert all(shown[what] for what in shown.keys() - silent)


def test_all_our_namespaces_enforce_restricted_pods(platform: Platform) -> None:
    items = platform.get("namespaces")["items"]
    labels = {item["metadata"]["name"]: item["metadata"].get("labels", {}) for item in items}
    enforced = {name for name, of_namespace in labels.items() if of_namespace.get(ENFORCE) == "restricted"}
    assert {"robotkube", "robotkube-gate", "argocd", *platform.agents} <= enforced


def test_every_pod_runs_as_an_ordinary_user_on_a_read_only_root(platform: Platform, story: Story) -> None:
    platforms = [pod for place in ("robotkube", "robotkube-gate") for pod in platform.get("-n", place, "pods")["items"]]
    ours = [*platforms, *story.pods.values()]
    names = {pod["metadata"]["labels"].get("app.kubernetes.io/name") for pod in ours}
    assert {"manager", "gate", "broker", "forge", "database", "mqtt-bridge", "event-detector", "bag-player"} <= names
    assert any(pod["metadata"]["name"].startswith("recorder-") for pod in ours)
    assert {pod["metadata"]["name"]: problems(pod) for pod in ours if problems(pod)} == {}


def problems(pod: Mapping[str, Any]) -> list[str]:
    """What a pod's containers may that they should not."""
    general = pod["spec"].get("securityContext", {})
    broken = []
    for container in [*pod["spec"]["containers"], *pod["spec"].get("initContainers", [])]:
        own = container.get("securityContext", {})
        wanted = {
            "non-root": own.get("runAsNonRoot", general.get("runAsNonRoot")) is True,
            "user": own.get("runAsUser", general.get("runAsUser", 0)) > 0,
            "read-only root": own.get("readOnlyRootFilesystem") is True,
            "no more privileges": own.get("allowPrivilegeEscalation") is False,
            "no capabilities": own.get("capabilities", {}).get("drop") == ["ALL"],
            "default seccomp": (own.get("seccompProfile") or general.get("seccompProfile", {})).get("type")
            == "RuntimeDefault",
        }
        broken += [f"{container['name']}: {what}" for what, holds in wanted.items() if not holds]
    return broken


def test_what_was_recorded_is_proved_by_its_seals(platform: Platform, story: Story) -> None:
    """With the files and the database of the cluster, by the command that a person runs. Exit code 1 is a gap that the
    recording names itself; 4 would be a recording that nothing proves."""

    def ask(*words: str) -> tuple[int, Any]:
        command = [sys.executable, "-m", "robotkube.cli", "recording", *words, "-o", "json"]
        surroundings = {**os.environ, "KUBECONFIG": str(platform.installer.kubeconfig)}
        done = subprocess.run(
            command, env=surroundings, capture_output=True, text=True, timeout=COMMANDS_SECONDS_MAX, check=False
        )
        assert done.stdout, done.stderr
        return done.returncode, json.loads(done.stdout)

    code, listed = ask("list")
    assert code == 0
    recordings = [row["recording"] for row in listed["recordings"] if row["state"] == "ended"]
    assert recordings, story.output[-2000:]
    for recording in recordings:
        code, proof = ask("verify", recording)
        assert proof["manifests"], recording
        assert {row["sealed"] for row in proof["manifests"]} == {True}, recording
        assert code in (0, 1), recording
        incomplete = [row for row in proof["topics"] if not row["complete"]]
        assert (code == 0) == (not incomplete), (recording, code, incomplete)
        unnamed = [row for row in incomplete if not row["gap_count"] or row["unexplained"]]
        assert not unnamed, (recording, unnamed)
