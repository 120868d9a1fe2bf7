"""The commands `robotkube bundle ...` that start no other program, and how the one that copies is asked."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli.main import main
from robotkube.registry.bundles.adapters import oras as copying
from tests.stages.registry.made_bundles import PREFIX, made


def test_show_says_what_is_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bundle = made(tmp_path)
    assert main(["bundle", "show", str(bundle.path), "--check", "-o", "json"]) == 0
    printed = capsys.readouterr()
    rows = json.loads(printed.out)["contents"]
    assert [(row["kind"], row["name"]) for row in rows] == [
        ("image", "gate"),
        ("image", "platform"),
        ("chart", "bag-player"),
        ("chart", "mqtt-bridge"),
        ("chart", "robotkube"),
        ("manifests", "argocd"),
    ]
    assert set(rows[3]["attachments"]) == {"evidence: static", "evidence: summary"}
    assert "blobs have the bytes of their digests" in printed.err
    assert "without evidence: bag-player 0.2.0\n" in printed.err


def test_the_newest_of_the_folder_is_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["bundle", "show"]) == 2
    assert "build/bundle: no bundle; name its file, or make one: make bundle" in capsys.readouterr().err
    (tmp_path / "build" / "bundle").mkdir(parents=True)
    made(tmp_path / "build" / "bundle")
    assert main(["bundle", "show"]) == 0


def test_manifests_have_the_images_of_the_registry(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(made(tmp_path).path)
    assert main(["bundle", "manifests", path]) == 0
    assert capsys.readouterr().out == f"image: {PREFIX}/argocd@sha256:{'0' * 64}\n"
    assert main(["bundle", "manifests", path, "--registry", "registry.example/robots"]) == 0
    assert capsys.readouterr().out == f"image: registry.example/robots/argocd@sha256:{'0' * 64}\n"
    assert main(["bundle", "manifests", path, "--name", "other"]) == 2


def test_the_password_is_in_no_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who lists processes sees command lines; the account stands in a file for the time of the copy."""
    bundle = made(tmp_path)
    (tmp_path / "password").write_text("its-password")
    seen: list[tuple[list[str], str, int]] = []

    def run(command: list[str], **more: Any) -> subprocess.CompletedProcess[str]:
        file = Path(command[command.index("--to-registry-config") + 1])
        seen.append((command, file.read_text(), file.stat().st_mode & 0o777))
        return subprocess.CompletedProcess(command, 1, "", "Error: unauthorized: authentication required")

    monkeypatch.setattr(copying.subprocess, "run", run)
    account = ["--username", "robot", "--password-file", str(tmp_path / "password")]
    to = ["--to", "registry.example/robots", "--ca", "ca.pem", "--oras", "oras"]
    assert main(["bundle", "push", str(bundle.path), *to, *account]) == 2
    [(command, configuration, mode)] = seen
    assert "its-password" not in " ".join(command)
    assert json.loads(configuration)["auths"].keys() == {"registry.example"}
    assert mode == 0o600
    assert command[command.index("--to-ca-file") + 1] == "ca.pem"
    assert f"{bundle.path}@{bundle.digest}" in command
    assert "registry.example/robots/bundle:0.1.0" in command


def test_a_program_that_is_missing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    path = str(made(tmp_path).path)
    assert main(["bundle", "push", path, "--to", "registry.example/robots"]) == 2
    assert "oras is not on PATH: install it (https://oras.land), or name the one" in capsys.readouterr().err
    assert main(["bundle", "load", path, "--kind", "kind"]) == 2
    assert "kind is not on PATH" in capsys.readouterr().err


def test_what_earlier_loads_left_for_k3s_is_named_and_removed_when_that_is_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(made(tmp_path).path)
    folder = tmp_path / "k3s"
    folder.mkdir()
    earlier, broken = folder / "robotkube-0.0.9-0123456789ab.tar", folder / "robotkube-0.0.8-0123456789ab.tar.part"
    others = [folder / "robotkube-0.0.9.tar", folder / "k3s-airgap-images-amd64.tar"]
    for file in (earlier, broken, *others):
        file.touch()
    assert main(["bundle", "load", path, "--k3s", str(folder), "-o", "json"]) == 0
    printed = capsys.readouterr()
    [archive] = {row["where"] for row in json.loads(printed.out)["loaded"]}
    assert Path(archive).name.startswith("robotkube-0.1.0-")
    assert f"{earlier} is of an earlier load: k3s imports it at each start as well; --replace removes it" in printed.err
    assert f"{broken} is of an earlier load" in printed.err
    assert not any(f"{other} is" in printed.err for other in others)
    assert main(["bundle", "load", path, "--k3s", str(folder), "--replace"]) == 0
    assert f"{earlier} is removed; what k3s imported of it stays" in capsys.readouterr().err
    assert sorted(folder.iterdir()) == sorted([Path(archive), *others])


def test_what_can_be_no_folder_of_k3s(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(made(tmp_path).path)
    assert main(["bundle", "load", path, "--kind", "kind", "--replace"]) == 2
    assert "--replace: removes files of the folder that --k3s names" in capsys.readouterr().err
    assert main(["bundle", "load", path, "--k3s", "/proc"]) == 2
    assert "--k3s /proc: cannot be written to: " in capsys.readouterr().err
