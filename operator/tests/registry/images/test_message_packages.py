"""Message packages beside a Dockerfile: what is one, what the image is built on, and one that is compiled for real."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from robotkube.cli import main as cli
from robotkube.errors import DocumentError
from robotkube.registry.images.adapters.message_packages import SOURCES, message_packages, with_messages

FIX = 'std_msgs/Header header\nstring name "x"\nfloat64[] values\nLevel level\ngeometry_msgs/Point[3] corners\n'
MESSAGES = {"rover_msgs/msg/Fix.msg": FIX, "rover_msgs/msg/Level.msg": "uint8 LOW=0\nuint8 value\n"}
MESSAGES |= {"a_first/msg/Uses.msg": "rover_msgs/Fix fix\nint8[<=4] few\n"}


class RecordingEngine:
    """An engine that keeps what it shall build."""

    program = "none"

    def __init__(self) -> None:
        self.built: list[tuple[str, Mapping[str, str], dict[str, str]]] = []

    def has(self, tag: str) -> bool:
        return False

    def load(self, archive: Path, tag: str) -> None:
        raise NotImplementedError

    def export(self, tag: str, folder: Path) -> None:
        raise NotImplementedError

    def build(self, context: Path, dockerfile: Path, tag: str, arguments: Mapping[str, str]) -> None:
        paths = (path for path in sorted(context.rglob("*")) if path.is_file())
        files = {str(path.relative_to(context)): path.read_text(encoding="utf-8") for path in paths}
        assert dockerfile == context / "Dockerfile"
        self.built.append((tag, dict(arguments), files))


def write(folder: Path, files: Mapping[str, str]) -> Path:
    for name, text in files.items():
        (folder / "msgs" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "msgs" / name).write_text(text)
    return folder


def test_packages_are_compiled_into_what_the_image_is_built_on(tmp_path: Path) -> None:
    engine = RecordingEngine()
    folder = write(tmp_path, MESSAGES)
    assert message_packages(folder) == ("a_first", "rover_msgs")
    tag = with_messages(folder, "rover", "localhost/base:1", engine)
    assert tag == "localhost/robotkube-own/rover-messages:latest"
    [(built, arguments, files)] = engine.built
    assert (built, arguments) == (tag, {"BASE": "localhost/base:1"})
    assert sorted(files) == ["Dockerfile", "compile_messages.py", *(f"msgs/{name}" for name in sorted(MESSAGES))]
    assert files["Dockerfile"].count("FROM ${BASE}") == 2


def test_a_folder_without_messages_is_built_as_before(tmp_path: Path) -> None:
    assert message_packages(tmp_path) == ()


def test_everything_that_is_no_message_package_is_named_at_once(tmp_path: Path) -> None:
    wrong = {
        "Rover/msg/Fix.msg": FIX,
        "std_msgs/msg/Text.msg": "string data\n",
        "rover_msgs/srv/Ask.srv": "---\n",
        "rover_msgs/msg/fix.msg": FIX,
        "rover_msgs/msg/Odd.msg": "float64[x] value\n",
        "loose.msg": FIX,
    }
    with pytest.raises(DocumentError) as caught:
        message_packages(write(tmp_path, wrong))
    assert [problem.partition(": ")[0] for problem in caught.value.problems] == [
        "Rover", "loose.msg", "rover_msgs/srv", "rover_msgs/msg/Odd.msg", "rover_msgs/msg/fix.msg", "std_msgs",
    ]  # fmt: skip
    assert "give yours another name" in str(caught.value)


def test_an_image_on_a_base_of_its_own_cannot_have_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "buildah").write_text("")
    (tmp_path / "buildah").chmod(0o755)
    own = write(tmp_path / "own", MESSAGES)
    (own / "Dockerfile").write_text("FROM docker.io/library/debian:bookworm\n")
    assert cli.main(["image", "build", str(own)]) == 2
    words = "own/msgs: is compiled into the image to build on; write ARG BASE in the Dockerfile"
    assert words in capsys.readouterr().err


@pytest.mark.processes
def test_compiled_messages_are_read_as_they_were_written(tmp_path: Path) -> None:
    """With the compiler and the wheels of this machine: what the build stage does with those of the image."""
    folder = write(tmp_path, MESSAGES)
    made = tmp_path / "made"
    script = [sys.executable, str(SOURCES / "compile_messages.py")]
    subprocess.run([*script, "compile", str(folder / "msgs"), str(made)], check=True, capture_output=True, timeout=120)
    libraries = f"{made}/lib:{Path(sys.prefix) / 'lib'}:{os.environ.get('LD_LIBRARY_PATH', '')}"
    python = next((made / "lib").glob("python3*/site-packages"))
    environment = {**os.environ, "LD_LIBRARY_PATH": libraries, "PYTHONPATH": str(python)}
    subprocess.run([*script, "check", str(folder / "msgs")], check=True, env=environment, timeout=60)
    code = "from robotkube.robots.ros.adapters.rclpy_node import message_type; message_type('rover_msgs/msg/Fix')"
    environment["PYTHONPATH"] += f":{os.environ.get('PYTHONPATH', '')}"
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, timeout=60)
    assert {path.name for path in (made / "share").glob("*/msg/*.msg")} == {"Fix.msg", "Level.msg", "Uses.msg"}
    shutil.rmtree(made)
