"""The repository's own rules, by the check's entry: each is broken in a small repository and says so."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from ci.check import assignments, boundaries, cores, rules, tools, words
from tests.stages.paths import REPOSITORY

CORE = "operator/src/robotkube/delivery/manager/core/updates.py"
SETTINGS = """
[[tool.importlinter.contracts]]
name = "Floors: what stands"
layers = ["robotkube.delivery", "robotkube.errors"]
[[tool.importlinter.contracts]]
name = "Subjects form no circle"
ancestors = ["robotkube", "robotkube.delivery"]
[[tool.importlinter.contracts]]
name = "Inside a subject"
containers = ["robotkube.delivery.manager"]
[[tool.importlinter.contracts]]
name = "Ports and loops know no adapter"
forbidden_modules = ["httpx"]
[[tool.importlinter.contracts]]
name = "ROS is known"
source_modules = ["robotkube.delivery.manager", "robotkube.errors", "ci", "scenarios"]
[[tool.importlinter.contracts]]
name = "Nothing that runs"
source_modules = ["robotkube.delivery", "robotkube.errors"]
"""


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A repository with one subject, in which every rule is kept."""
    folder = tmp_path_factory.mktemp("kept")
    subprocess.run(["git", "init", "-q", "--template=", str(folder)], check=True, timeout=60)
    write(folder, "operator/pyproject.toml", SETTINGS)
    write(folder, "operator/src/robotkube/errors.py", "")
    write(folder, CORE, "import json\n")
    return folder


@pytest.fixture
def place(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it of the test's own."""
    shutil.copytree(kept, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(rules, "TOP", tmp_path)
    return tmp_path


def write(place: Path, name: str, text: str) -> None:
    """A file; below the package, with the `__init__.py` of its folders."""
    path = place / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    for folder in path.parents:
        if folder.is_relative_to(place / "operator/src/robotkube"):
            (folder / "__init__.py").touch()


def findings(place: Path) -> list[str]:
    subprocess.run(["git", "add", "--all"], cwd=place, check=True, timeout=60)
    return rules.repository_rules()


def test_nothing_is_found_where_every_rule_is_kept(place: Path) -> None:
    assert findings(place) == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("def f():\n    from robotkube.foundation.runtime import clockwork", "robotkube.foundation.runtime.clockwork"),
        ("from robotkube.delivery.manager.adapters import x", "imports robotkube.delivery.manager.adapters.x"),
        ("from .. import adapters", "imports robotkube.delivery.manager.adapters"),
        ("from ..loops.turns import turn", "imports robotkube.delivery.manager.loops.turns.turn"),
        ("import robotkube.delivery.manager.core.plans", "imports robotkube.delivery.manager.core.plans"),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import httpx", "imports httpx"),
        ("import importlib", "imports importlib"),
        ("import ctypes", "imports ctypes"),
        ("from concurrent.futures import Future", "imports concurrent.futures.Future"),
        ("import _thread", "imports _thread"),
        ("import posix as p", "imports posix"),
        ("import pickle", "imports pickle"),
        ("import numpy", "imports numpy"),
        ("from os import environ", "imports os.environ"),
        ("import time", "imports time"),
        ("import random", "imports random"),
        ("import sys\nsys.modules['os'].environ", "uses sys.modules"),
        ("from sys import modules", "imports sys.modules"),
        ("import typing as t\nt.sys.argv", "uses t.sys"),
        ("import dataclasses\ndataclasses.sys", "uses dataclasses.sys"),
        ("from dataclasses import sys", "imports dataclasses.sys"),
        ("import tarfile\ntarfile.open('x')", "uses tarfile.open"),
        ("from tarfile import bltn_open", "imports tarfile.bltn_open"),
        ("from shlex import os", "imports shlex.os"),
        ("import gzip\ngzip.compress(b'')", "without mtime"),
        ("from gzip import compress as c\nc(b'')", "without mtime"),
        ("from datetime import datetime\ndatetime.now()", "uses datetime.now"),
        ("import datetime as d\nx = d.date.today", "uses d.date.today"),
        ("from datetime import datetime as D\nE = D\nE.utcnow()", "uses E.utcnow"),
        ("from datetime import datetime as D\nD.fromtimestamp(1)", "calls fromtimestamp without a time zone"),
        ("open('x')", "uses open"),
        ("read = open", "uses open"),
        ("__import__('os')", "uses __import__"),
        ("print(1)", "uses print"),
        ("exec('')", "uses exec"),
    ],
)
def test_a_core_that_is_not_pure_is_a_finding(place: Path, text: str, problem: str) -> None:
    write(place, CORE, f"{text}\n")
    impure = findings(place)
    assert impure
    assert all(CORE.removeprefix("operator/src/") in line for line in impure)
    assert problem in "\n".join(impure)


def test_what_a_core_may_use_is_no_finding(place: Path) -> None:
    text = (
        "import collections.abc, gzip, hashlib, sys, tarfile, yaml\n"
        "from datetime import UTC, datetime\nfrom typing import TYPE_CHECKING\n\n"
        "from robotkube.errors import RefusalError\nfrom robotkube.registry.charts.core import packing\n"
        "from . import plans\nfrom .plans import Plan\nfrom ..core.plans import Other\n"
        "if TYPE_CHECKING:\n    from collections.abc import Mapping\n"
        "packed = gzip.compress(b'', mtime=0), sys.byteorder, tarfile.TarInfo('x'), yaml.SafeLoader\n"
        "moment = datetime.fromtimestamp(1, UTC).isoformat()\n"
        "class Sum:\n    open: bool = False\n\n    now = 1\n"
    )
    write(place, CORE, text)
    assert findings(place) == []


@pytest.mark.parametrize("name", ["operator/src/robotkube/errors.py", "operator/src/robotkube/delivery/__init__.py"])
def test_what_a_core_loads_with_it_is_pure_too(place: Path, name: str) -> None:
    write(place, name, "import os\n")
    assert [line.partition(";")[0] for line in findings(place)] == [
        f"{name.removeprefix('operator/src/')}:1: imports os"
    ]


def test_the_lists_of_what_is_pure_hold_nothing_that_no_core_could_import() -> None:
    for name in {*cores.STANDARD, *cores.PARTS}:
        assert cores._loaded(name)
    for name, parts in cores.PARTS.items():
        assert all(hasattr(cores._loaded(name), part) for part in parts)


def test_a_folder_without_init_is_a_finding(place: Path) -> None:
    folder = place / "operator/src/robotkube/delivery/manager/hidden"
    folder.mkdir()
    (folder / "module.py").touch()
    assert [line.partition(":")[0] for line in findings(place)] == ["robotkube/delivery/manager/hidden"]
    (folder / "__init__.py").touch()
    assert findings(place) == []


def test_a_subject_that_no_contract_names_is_a_finding(place: Path) -> None:
    write(place, "operator/src/robotkube/delivery/new/loops/turns.py", "")
    write(place, "operator/src/robotkube/extra.py", "")
    assert [line.removeprefix("operator/pyproject.toml: contract ") for line in findings(place)] == [
        "'Floors: what stands': layers lacks robotkube.extra",
        "'Inside a subject': containers lacks robotkube.delivery.new",
        "'ROS is known': source_modules lacks robotkube.delivery.new",
        "'ROS is known': source_modules lacks robotkube.extra",
        "'Nothing that runs': source_modules lacks robotkube.extra",
    ]


def test_a_library_of_an_adapter_that_loops_could_import_is_a_finding(place: Path) -> None:
    adapter = "operator/src/robotkube/delivery/manager/adapters/answers.py"
    write(place, adapter, "import json\nimport yaml\nimport httpx\nimport cel.parser\n")
    missing = "operator/pyproject.toml: contract 'Ports and loops know no adapter': forbidden_modules lacks cel"
    assert findings(place) == [missing]


def test_every_contract_with_a_list_is_there() -> None:
    text = (REPOSITORY / "operator/pyproject.toml").read_text(encoding="utf-8")
    beginnings = boundaries.demanded(REPOSITORY / "operator/src/robotkube")
    assert {beginning: text.count(f'\nname = "{beginning}') for beginning in beginnings} == dict.fromkeys(beginnings, 1)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("operator/src/robotkube/delivery/manager/loops/turns.py", "def f():\n    from rclpy.qos import QoSProfile"),
        ("ci/reference/walks/pose.py", "import rclpy.node as node"),
        ("scenarios/one.py", "from rosidl_runtime_py import utilities"),
        ("benchmarks/other.py", "import importlib\nimportlib.import_module('rclpy')"),
        ("ci/publish.py", "from tests.stages import paths"),
        ("operator/src/robotkube/delivery/manager/loops/turns.py", "__import__('tests.stages')"),
    ],
)
def test_ros_and_the_tests_are_imported_where_they_may_be_alone(place: Path, name: str, text: str) -> None:
    write(place, name, f"{text}\n")
    (finding,) = findings(place)
    assert finding.startswith(f"{name}:2: " if "\n" in text else f"{name}:1: ")
    assert "; only " in finding


@pytest.mark.parametrize(
    "text",
    [
        "from ci.cluster.embedded.provider import Embedded",
        "from ci.cluster import existing",
        "from ci.cluster.api_server import client",
        "import ci.cluster.embedded.network.addresses",
        "from ci.cluster.choosing_elsewhere import provider",
    ],
)
@pytest.mark.parametrize("name", ["scenarios/demo.py", "benchmarks/one.py", "ci/publish.py"])
def test_who_uses_a_cluster_does_not_know_its_kind(place: Path, name: str, text: str) -> None:
    write(place, name, f"{text}\n")
    [finding] = findings(place)
    assert finding.startswith(f"{name}:1: imports ci.cluster.")
    assert "does not know its kind" in finding


def test_what_all_kinds_of_clusters_have_may_be_known(place: Path) -> None:
    write(
        place,
        "scenarios/demo.py",
        "from ci.cluster import choosing\nfrom ci.cluster_contract.provider import Provider\n",
    )
    write(place, "ci/cluster/choosing.py", "from ci.cluster.embedded.provider import Embedded\n")
    assert findings(place) == []


def test_the_templates_of_repositories_import_nothing_of_ours(place: Path) -> None:
    name = "gitops/argocd/render.py"
    write(place, name, "import yaml\n")
    assert findings(place) == []
    write(place, name, "import yaml\nfrom ci import toolchain\n")
    assert findings(place) == [f"{name}:2: imports ci; gitops stands below all others, it imports none of them"]


def test_every_module_is_formatted_and_read() -> None:
    seen = tuple(f"{place}/" for place in tools.CODE)
    assert [name for name in rules.tracked("*.py") if not name.startswith(seen)] == []


def test_the_adapter_and_the_baselines_import_ros(place: Path) -> None:
    write(place, "benchmarks/bridges/naive_bridge.py", "import rclpy\n")
    path = place / boundaries.ROS_HOME / "node.py"
    write(place, str(path.relative_to(place)), "import rclpy\n")
    assert not [line for line in findings(place) if "knows ROS" in line]
    assert all((REPOSITORY / name).is_file() for name in boundaries.ROS_ELSEWHERE)


@pytest.mark.parametrize(
    "folder", [str(Path(CORE).parent), "ci", "ci/cluster/embedded", "benchmarks/bridges", "scenarios/runner"]
)
def test_a_folder_with_too_many_modules_is_a_finding(place: Path, folder: str) -> None:
    write(place, f"{folder}/__init__.py", "")
    for number in range(rules.MODULES_MAX - len(list((place / folder).glob("[!_]*.py")))):
        write(place, f"{folder}/module_{number}.py", "")
    assert findings(place) == []
    write(place, f"{folder}/one_more.py", "")
    assert [line.partition(";")[0] for line in findings(place)] == [f"{folder}: 16 modules"]


@pytest.mark.parametrize(
    "text",
    [
        "path, deadline = folder / 'a', now + 60",
        "memo, asked = Memo(), [1]",
        "releases, made = read(), commits(stage)",
        "HOST, SECONDS = 'localhost', 2.0",
        "self.now, self.tasks = 0.0, tasks",
    ],
)
def test_what_has_nothing_to_do_with_each_other_is_assigned_apart(place: Path, text: str) -> None:
    write(place, "ci/running.py", f"def run():\n    {text}\n")
    targets = text.partition(" = ")[0]
    assert findings(place) == [
        f"ci/running.py:2: {targets} are given values of several kinds at once; assign each by itself"
    ]


@pytest.mark.parametrize(
    "text",
    [
        "first, last = spans[0], spans[-1]",
        "before, after = read(old), read(new)",
        "problems, unknown = list[str](), list[int]()",
        "BYTES_MAX, SECONDS_MAX = 64 * 1024, -2.5",
        "waiting, self.waiting = self.waiting, []",
        "first, second = second, first + second",
        "near, far = ends",
        "first, *others = 1, 'a', 2",
    ],
)
def test_what_belongs_together_may_be_assigned_at_once(text: str) -> None:
    assert assignments.findings("ci/running.py", text) == []


def test_a_name_of_two_public_classes_is_a_finding(place: Path) -> None:
    plans, gate = (
        "operator/src/robotkube/delivery/manager/core/plans.py",
        "operator/src/robotkube/delivery/manager/gate.py",
    )
    write(place, plans, "class Cause:\n    class Inner: ...\n\n\nclass _Own: ...\n")
    write(place, gate, "class Room:\n    class Inner: ...\n\n\nclass _Own: ...\n")
    assert findings(place) == []
    write(place, gate, "class Cause(Exception): ...\n")
    assert findings(place) == [f"{plans}, {gate}: class Cause stands for 2 things; give each a name of its own"]


def test_names_of_classes_are_compared_in_each_tree_alone(place: Path) -> None:
    one, other = "ci/cluster/embedded/admission/stranded.py", "ci/cluster/embedded/containers/reports.py"
    write(place, "operator/src/robotkube/delivery/manager/core/plans.py", "class Report: ...\n")
    write(place, one, "class Report: ...\n")
    assert findings(place) == []
    write(place, other, "class Report: ...\n")
    assert findings(place) == [f"{one}, {other}: class Report stands for 2 things; give each a name of its own"]


VOCABULARY = words.Vocabulary({"room": "test namespace", "door": "task gateway"}, {"ci/former.py": ["room"]})


@pytest.mark.parametrize(
    ("name", "text", "line", "kind", "given"),
    [
        ("ci/doors/room.py", "", 1, "module", "room"),
        ("ci/running.py", "class FreeRoom: ...", 1, "class", "FreeRoom"),
        ("ci/running.py", "class A:\n    def _room_of(self): ...", 2, "function", "_room_of"),
        ("ci/running.py", "async def room(): ...", 1, "function", "room"),
        ("ci/running.py", 'made = {\n    "testRoom": 1}', 2, "key", "testRoom"),
        ("ci/former.py", 'made = {"room": 1, "rooms": 2, "room_of": 3}', 1, "key", "room_of"),
        ("operator/tests/ci/test_room.py", "", 1, "module", "test_room"),
        ("operator/tests/ci/test_running.py", "class Room: ...", 1, "class", "Room"),
    ],
)
def test_a_private_word_in_a_name_is_a_finding(name: str, text: str, line: int, kind: str, given: str) -> None:
    assert words.findings(name, text, VOCABULARY) == [
        f"{name}:{line}: {kind} {given} has the private word 'room'; the field's is: test namespace ({words.FILE})"
    ]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("ci/running.py", "class Broom: ...\ndef showroom(): ..."),
        ("ci/running.py", 'made = {"in the room": 1, "room/door": 2, 3: 4, **others}\nroom = "room"'),
        ("ci/former.py", 'made = {"room": 1}'),
        ("operator/tests/ci/test_running.py", "def test_there_is_room(): ...\ndef room(): ..."),
    ],
)
def test_other_words_sentences_and_values_are_not(name: str, text: str) -> None:
    assert words.findings(name, text, VOCABULARY) == []


def test_private_words_are_those_of_the_repositorys_list(place: Path) -> None:
    module = "ci/cluster/rooms.py"
    write(place, module, "")
    assert findings(place) == []
    write(place, words.FILE, '[words]\nrooms = "test namespaces"\n[former_keys]\n"ci/gone.py" = ["room"]\n')
    assert findings(place) == [
        f"{words.FILE}: former_keys: ci/gone.py has no key 'room'; take it out",
        f"{module}:1: module rooms has the private word 'rooms'; the field's is: test namespaces ({words.FILE})",
    ]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("words", "write it as TOML"),
        ('[words]\nRoom = "x"', "words.Room: must be one word in small letters"),
        ('[words]\nroom = ""', "words.room: must be one word in small letters, with the field's word for it"),
        ("[others]", "others: is unknown; known tables are words and former_keys"),
    ],
)
def test_a_list_of_words_that_is_none_is_a_finding(place: Path, text: str, problem: str) -> None:
    write(place, words.FILE, text)
    [finding] = findings(place)
    assert finding.startswith(f"{words.FILE}: ")
    assert problem in finding


def test_the_list_has_words_that_no_name_has() -> None:
    listed = words.read((REPOSITORY / words.FILE).read_text(encoding="utf-8"))
    assert {"room", "door", "following"} <= listed.words.keys()
    assert words.unused(listed, REPOSITORY) == []


@pytest.mark.parametrize(
    ("line", "counts"),
    [
        ('ci/a.py:1: error: "B" has no attribute "c"  [attr-defined]', True),
        ("ci/a.py:1: error: Incompatible return value type  [return-value]", True),
        ('operator/tests/a.py:1: error: "B" has no attribute "gone"  [attr-defined]', True),
        ('operator/tests/a.py:1: error: Too many arguments for "b"  [call-arg]', True),
        ('operator/tests/a.py:1: error: Name "b.C" is not defined  [name-defined]', True),
        ('operator/tests/a.py:1: error: "Object" has no attribute "data"  [attr-defined]', False),
        ('operator/tests/a.py:1: error: "B" has no attribute "_own"  [attr-defined]', False),
        ("operator/tests/a.py:1: error: Incompatible return value type  [return-value]", False),
        ("Found 3 errors in 2 files (checked 9 source files)", False),
        ("mypy: can't read file 'x'", True),
    ],
)
def test_types_of_tests_count_where_they_name_what_is_gone(line: str, counts: bool) -> None:
    assert tools.type_findings(f"{line}\n") == ([line] if counts else [])
