"""The robots' image on ROS 2 as Ubuntu packages it: what it leaves out of the lock, what it gets for arm64, and what it
must find in its base. No test builds it: its base cannot be had here."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from ci.errors import SetUpError
from ci.images import wheels
from tests.ci.test_dependencies import NATIVE_TOO, ROBOT, distribution, homes, imported_by, reachable
from tests.stages.paths import REPOSITORY

pytestmark = pytest.mark.processes
IMAGES = REPOSITORY / "operator" / "images"
OURS = "robotkube (pyproject.toml)"
PIN = re.compile(r"^([a-z0-9-]+)==(\S+) \\$", re.M)
VIA = re.compile(r"^    #(?: via| {2}) (\S.*)$", re.M)
OF_UBUNTU = {"numpy"}  # what processes import and the lock does not bring, beside ROS
BUILD_ONLY = {
    "lark",
    "argcomplete",
}  # imported by generators of messages, and for completion in a shell, where they are there


@dataclass(frozen=True)
class Pin:
    """A version in a lock, the digests of its files, and who asks for it."""

    version: str
    digests: frozenset[str]
    asked_by: frozenset[str]


def pins(text: str) -> Mapping[str, Pin]:
    """Name -> what a lock says of it."""
    parts = PIN.split(text)[1:]
    return {
        name: Pin(version, frozenset(re.findall(r"--hash=sha256:([0-9a-f]{64})", more)), frozenset(VIA.findall(more)))
        for name, version, more in zip(parts[::3], parts[1::3], parts[2::3], strict=True)
    }


@cache
def locked() -> Mapping[str, Pin]:
    return pins(wheels.LOCK.read_text(encoding="utf-8"))


@cache
def installed() -> frozenset[str]:
    return frozenset(pins(wheels.selected()))


def is_ros(name: str) -> bool:
    return name.startswith("ros-")


def asked_without_ros() -> set[str]:
    """What the package asks for, and what that asks for, without any step over ROS."""
    known: set[str] = set()
    while more := {
        name
        for name, pin in locked().items()
        if name not in known and not is_ros(name) and ({OURS} | known) & pin.asked_by
    }:
        known |= more
    return known


def test_left_out_are_the_ros_wheels_and_what_only_they_ask_for() -> None:
    assert installed() == asked_without_ros()
    assert {name for name in locked() if not is_ros(name)} - installed() == {
        "empy",
        "lark-parser",
        "numpy",
        "setuptools",
    }
    assert len([name for name in locked() if is_ros(name)]) > 50


def test_what_is_selected_has_all_of_its_digests() -> None:
    chosen = pins(wheels.selected())
    assert chosen == {name: pin for name, pin in locked().items() if name in chosen}


def fits(file: str) -> bool:
    """Whether a wheel is pure or for CPython 3.12 on arm64 with the C library of Ubuntu 24.04, by its name."""
    python, abi, platform = file.removesuffix(".whl").rsplit("-", 3)[1:]
    if (abi, platform) == ("none", "any"):
        return "py3" in python.split(".")
    stable = abi == "abi3" and int(python.removeprefix("cp3")) <= 12
    return (stable or python == abi == "cp312") and bool({*platform.split(".")} & {*wheels.PLATFORMS})


@pytest.mark.parametrize(
    "file",
    [
        "lz4-4.4.5-cp312-cp312-manylinux2014_x86_64.manylinux_2_17_x86_64.whl",
        "lz4-4.4.5-cp311-cp311-manylinux2014_aarch64.whl",
        "lz4-4.4.5-cp313-abi3-manylinux2014_aarch64.whl",
        "lz4-4.4.5-cp312-cp312-musllinux_1_2_aarch64.whl",
        "lz4-4.4.5-py2-none-any.whl",
    ],
)
def test_a_wheel_for_something_else_does_not_fit(file: str) -> None:
    assert not fits(file)


def test_each_package_that_is_installed_has_a_wheel_for_arm64_whose_digest_is_in_the_lock() -> None:
    """The lock does not name files; the list does, and `make lock` writes both."""
    lines = [line.split("  ") for line in wheels.LIST.read_text(encoding="utf-8").splitlines()]
    assert [file for _, file in lines if not fits(file)] == []
    files = {file.split("-")[0].replace("_", "-"): (file.split("-")[1], digest) for digest, file in lines}
    assert files.keys() == installed(), "make lock"
    assert [name for name, (version, _) in files.items() if version != locked()[name].version] == [], "make lock"
    assert [name for name, (_, digest) in files.items() if digest not in locked()[name].digests] == []


@pytest.mark.parametrize("process", ROBOT)
def test_what_a_process_imports_is_installed_or_of_ros(process: str) -> None:
    tops = {name.partition(".")[0] for name in reachable(process)} - set(sys.stdlib_module_names) - NATIVE_TOO
    origins = {top: {distribution(home) for home in homes().get(top, [])} for top in tops}
    assert {top for top, home in origins.items() if not home & installed() and not any(map(is_ros, home))} <= OF_UBUNTU


def test_what_rclpy_and_the_messages_import_is_installed_or_of_ubuntu() -> None:
    """The bindings of the lock stand for those of Ubuntu, which are of the same release."""
    ros = {top for top, found in homes().items() if any(is_ros(distribution(home)) for home in found)}
    site = Path(next(path for path in sys.path if path.endswith("site-packages")))
    read = {"rclpy", "rpyutils", "ament_index_python", "rosidl_generator_py", "rosidl_parser", *messages()}
    assert read <= ros
    names = {name for top in read for path in (site / top).rglob("*.py") for name in imported_by(path, site)}
    others = {name.partition(".")[0] for name in names} - set(sys.stdlib_module_names) - ros - BUILD_ONLY
    assert {"yaml", "numpy"} <= others
    brought = {top for top in others if {distribution(home) for home in homes()[top]} & installed()}
    assert others - brought == OF_UBUNTU


def dockerfile(image: str) -> str:
    return re.sub(r"\s*\\\n\s*", " ", (IMAGES / image / "Dockerfile").read_text(encoding="utf-8"))


def checked_types() -> list[str]:
    """The types that the image's own check reads and writes."""
    (words,) = re.findall(r"^RUN check-ros \S+ (.*)$", dockerfile("ros-distribution"), re.M)
    return str(words).split()


def messages() -> set[str]:
    return {name.partition("/")[0] for name in checked_types()}


def test_every_message_package_that_the_base_must_have_is_named() -> None:
    project = tomllib.loads((REPOSITORY / "operator" / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {distribution(one) for one in project["optional-dependencies"]["robot"]}
    packages = {name.removeprefix("ros-jazzy-").replace("-", "_") for name in declared if name.endswith("-msgs")}
    assert messages() == {*packages, "builtin_interfaces"}


def test_the_page_gives_the_command_and_names_what_comes_from_the_base() -> None:
    page = (REPOSITORY / "docs" / "reference" / "bundles.md").read_text(encoding="utf-8")
    (base,) = re.findall(r"^ARG BASE=(.*)$", dockerfile("ros-distribution"), re.M)
    assert f"--platform linux/arm64 --build-arg BASE={base} " in page
    assert "--file operator/images/ros-distribution/Dockerfile ." in page
    assert {name for name in messages() if f"`{name}`" not in page} == set()


def test_both_images_of_robots_have_the_same_commands_and_settings() -> None:
    places = {"LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "PATH"}
    commands, settings = [], []
    for image in ("ros", "ros-distribution"):
        commands += re.findall(r"install-commands \S+ \S+ (.*)$", dockerfile(image), re.M)
        (line,) = re.findall(r"^ENV (.*)$", dockerfile(image), re.M)
        settings.append(dict(word.split("=", 1) for word in line.split()))
    assert commands[0] == commands[1]
    assert settings[0].keys() == settings[1].keys()
    assert {name for name in settings[0] if settings[0][name] != settings[1][name]} == places


@pytest.fixture
def commands(tmp_path: Path) -> Path:
    (names,) = re.findall(r"install-commands \S+ \S+ (.*)$", dockerfile("ros-distribution"), re.M)
    program, project = IMAGES / "install-commands", REPOSITORY / "operator" / "pyproject.toml"
    subprocess.run([sys.executable, program, project, tmp_path, *names.split()], check=True, timeout=30)
    return tmp_path / "bin"


def check(folder: Path, *types: str) -> subprocess.CompletedProcess[str]:
    """What the image runs at the end of its build, run by this Python with the wheels."""
    command = [sys.executable, str(IMAGES / "ros-distribution" / "check-ros"), str(folder), *types]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


def test_the_images_check_loads_commands_and_reads_messages(commands: Path) -> None:
    done = check(commands, *checked_types())
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"check-ros: 7 commands load, by rmw_fastrtps_cpp; {len(checked_types())} types, 0 problems\n"


def test_the_images_check_says_what_is_missing(commands: Path) -> None:
    done = check(commands, "std_msgs/msg/Header", "missing_msgs/msg/Other")
    assert done.returncode == 1
    assert "missing_msgs/msg/Other: InputError: type missing_msgs/msg/Other: is not installed" in done.stderr
    assert "docker.io/library/ros:jazzy" in done.stderr
    (commands / "robotkube-broken").write_text("import no_such_module\n")
    assert "No module named 'no_such_module'" in check(commands, "std_msgs/msg/Header").stderr
    assert check(commands.parent, "std_msgs/msg/Header").returncode == 2


def test_a_version_without_a_wheel_that_fits_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An index without any file stands for one without the right one."""
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.delenv("PIP_FIND_LINKS", raising=False)
    with pytest.raises(SetUpError, match=r"wheels for Python 3.12 on manylinux2014_aarch64: .*annotated-doc"):
        wheels.fetch(tmp_path)
