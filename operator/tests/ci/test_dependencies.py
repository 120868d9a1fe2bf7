"""What is imported is declared: by every process in the extra of operator/pyproject.toml that its image is built from,
by everything else in any of them. A package that comes only because another one asks for it may go with that other one.
"""

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from ci.imports import imports_in, module_name, package_of
from robotkube.cli.main import COMMANDS

TOP = Path(__file__).resolve().parents[3]
SOURCES = TOP / "operator" / "src"
PLATFORM = (
    "robotkube.setup.bootstrap",
    "robotkube.delivery.gate.__main__",
    "robotkube.delivery.manager.__main__",
    "robotkube.delivery.removal.__main__",
    "robotkube.delivery.inspection.__main__",
    "robotkube.registry.charts.adapters.helm_sandbox",
    "robotkube.registry.admission.__main__",
    "robotkube.delivery.rights.__main__",
    "robotkube.delivery.certificates.__main__",
    "robotkube.delivery.console.__main__",
    "robotkube.delivery.rights.first_file",
    "robotkube.registry.catalogue.adapters.bounded_validation",
    "robotkube.registry.suites.__main__",
    "robotkube.setup.teardown",
    "robotkube.setup.gate_key",
    "robotkube.setup.installation_test",
    "robotkube.delivery.preflight.probe",
)
ROBOT = (
    "robotkube.robots.bridge.__main__",
    "robotkube.robots.detector.__main__",
    "robotkube.robots.perception.object_detection",
    "robotkube.robots.perception.object_tracking",
    "robotkube.robots.bags.__main__",
    "robotkube.robots.reactions.host",
    "robotkube.robots.rules.host",
    "robotkube.robots.bags.sample_bag",
    "robotkube.registry.suites.observer",
)
NATIVE_TOO = frozenset(["robotkube", "robotkube_rcl"])  # the second is built from operator/native
COMMAND_LINE = ("robotkube.cli.__main__",)
COMMANDS_IMPORTED = ("robotkube.cli.__main__", *sorted({f"robotkube.cli.{command.module}" for command in COMMANDS}))
BUILD_STAGE = frozenset(  # of message packages: registry/images/skeletons/messages/Dockerfile installs them
    [
        *("rosidl_adapter", "rosidl_generator_c", "rosidl_generator_py", "rosidl_generator_type_description"),
        *("rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"),
    ]
)


def imported(source: str, package: str = "") -> Iterator[str]:
    """Every module that a text of Python in `package` imports, anywhere in it; of `from a import b` both `a` and `a.b`.
    Relative ones have their whole name, and a literal name in a call of `import_module` or `__import__` counts."""
    for one in imports_in(source, package):
        yield from (one.module, one.whole)


@cache
def homes() -> Mapping[str, list[str]]:
    """The installed distributions that every top-level package comes from."""
    return packages_distributions()


@cache
def modules() -> Mapping[str, frozenset[str]]:
    """Every module of the package and what it imports."""
    return {module_name(path, SOURCES): imported_by(path, SOURCES) for path in SOURCES.rglob("*.py")}


@cache
def imported_by(path: Path, root: Path) -> frozenset[str]:
    return frozenset(imported(path.read_text(), package_of(path, root)))


def reachable(start: str) -> frozenset[str]:
    """What running module `start` can import, its own packages' __init__ included."""
    seen: set[str] = set()
    waiting = {start}
    while waiting:
        module = waiting.pop()
        seen.add(module)
        parents = {module.rsplit(".", count)[0] for count in range(1, module.count(".") + 1)}
        waiting |= {name for name in modules()[module] | parents if name in modules()} - seen
    return frozenset(name for module in seen for name in modules()[module])


def distribution(requirement: str) -> str:
    return re.split(r"[\[<>=!~; ]", requirement)[0].lower().replace("_", "-")


def declared(*extras: str) -> frozenset[str]:
    project = tomllib.loads((TOP / "operator" / "pyproject.toml").read_text())["project"]
    lists = [project["dependencies"], *(project["optional-dependencies"][extra] for extra in extras)]
    return frozenset(distribution(requirement) for requirements in lists for requirement in requirements)


def every_extra() -> frozenset[str]:
    project = tomllib.loads((TOP / "operator" / "pyproject.toml").read_text())["project"]
    return declared(*project["optional-dependencies"])


def undeclared(names: frozenset[str], known: frozenset[str], own: frozenset[str]) -> dict[str, list[str]]:
    """Package that is imported and comes from elsewhere -> the distributions of which none is in `known`."""
    tops = {name.partition(".")[0] for name in names} - set(sys.stdlib_module_names) - own
    sources = {top: [*map(distribution, homes().get(top, [])), f"ros-jazzy-{top.replace('_', '-')}"] for top in tops}
    return {top: files for top, files in sorted(sources.items()) if not known.intersection(files)}


def own_packages() -> frozenset[str]:
    """What is imported by name and is part of the repository: its packages, and what lies beside a skeleton's node."""
    return NATIVE_TOO | {"benchmarks", "ci", "scenarios", "gitops", "tests", "answers"}


@pytest.mark.parametrize("process", PLATFORM)
def test_what_a_process_of_the_platform_imports_is_declared_for_the_platform(process: str) -> None:
    assert undeclared(reachable(process), declared("platform"), NATIVE_TOO) == {}


@pytest.mark.parametrize("process", ROBOT)
def test_what_a_process_on_a_robot_imports_is_declared_for_robots(process: str) -> None:
    assert undeclared(reachable(process), declared("robot"), NATIVE_TOO) == {}


@pytest.mark.parametrize("process", COMMANDS_IMPORTED)
def test_what_the_command_line_imports_is_declared_for_the_platform_terminals_or_robots(process: str) -> None:
    assert undeclared(reachable(process), declared("platform", "terminal", "robot"), NATIVE_TOO) == {}


@pytest.mark.parametrize("folder", ["operator/src", "operator/tests", "benchmarks", "ci", "scenarios"])
def test_what_a_folder_imports_is_declared_in_some_extra(folder: str) -> None:
    root = SOURCES if folder == "operator/src" else (TOP / folder).parent
    names = frozenset(name for path in (TOP / folder).rglob("*.py") for name in imported_by(path, root))
    assert undeclared(names, every_extra(), own_packages() | BUILD_STAGE) == {}


def test_every_module_that_runs_as_a_process_is_looked_at() -> None:
    """A new process has to be put into one of the lists above."""
    guards = (path for path in SOURCES.rglob("*.py") if "\nif __name__ ==" in path.read_text())
    runs = {module_name(path, SOURCES) for path in guards if "skeletons" not in path.parts}
    assert runs == {*PLATFORM, *ROBOT, *COMMAND_LINE}


def test_every_package_that_is_declared_for_the_platform_is_imported() -> None:
    """What nothing imports, such as a library that was replaced, goes."""
    names = {name.partition(".")[0] for process in (*PLATFORM, *COMMANDS_IMPORTED) for name in reachable(process)}
    used = {distribution(one) for name in names for one in homes().get(name, [])}
    assert declared("platform") - used == set()


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("from . import c", "robotkube.a.b.c"),
        ("from .c import d", "robotkube.a.b.c.d"),
        ("from ..c import d", "robotkube.a.c"),
        ("from ... import errors", "robotkube.errors"),
        ("import importlib\nimportlib.import_module('numpy')", "numpy"),
        ("from importlib import import_module\nimport_module(name='..c', package=__package__)", "robotkube.a.c"),
        ("x = __import__('numpy.linalg')", "numpy.linalg"),
    ],
)
def test_relative_imports_and_calls_with_a_literal_name_are_seen(text: str, name: str) -> None:
    assert name in set(imported(text, "robotkube.a.b"))
