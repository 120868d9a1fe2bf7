"""Boundaries that the import contracts draw by lists: nothing on the disk is outside of the lists, and ROS, the tests
and the kinds of clusters are imported where they may be alone.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ci.check import cores
from ci.imports import imports_in, module_name, package_of

FLOORS = ("foundation", "robots", "registry", "delivery")  # packages of subjects; every other package is a subject
KINDS = ("core", "ports", "loops", "adapters")
ROOTS = {"benchmarks": ".", "ci": ".", "gitops": ".", "scenarios": ".", "robotkube": "operator/src"}
SKELETONS = "skeletons"  # files for others to start from, no modules
ROS = ("rclpy", "rosbag2_py", "rosidl_runtime_py")
ROS_HOME = "operator/src/robotkube/robots/ros/adapters/"
ROS_ELSEWHERE = {
    "benchmarks/bridges/naive_bridge.py": "a baseline: stands for what other people write",
    "benchmarks/detector/naive_detector.py": "a baseline: stands for what other people write",
}
PROVIDERS = "ci.cluster"
CHOOSING = f"{PROVIDERS}.choosing"
CONTRACT = "ci.cluster_contract"


def findings(top: Path) -> list[str]:
    root = top / "operator/src/robotkube"
    project = tomllib.loads((top / "operator/pyproject.toml").read_text(encoding="utf-8"))
    return [*no_packages(root), *outside_of_contracts(root, project), *forbidden_imports(top)]


def no_packages(root: Path) -> list[str]:
    """Folders with modules and without `__init__.py`, which import-linter does not see; those above them too."""
    folders = {
        folder
        for path in modules(root)
        for folder in path.parents
        if folder.is_relative_to(root) and not (folder / "__init__.py").is_file()
    }
    return [
        f"{folder.relative_to(root.parent).as_posix()}: has modules and no __init__.py: the import contracts miss it"
        for folder in sorted(folders)
    ]


def modules(root: Path) -> list[Path]:
    return [path for path in sorted(root.rglob("*.py")) if SKELETONS not in path.parts]


def outside_of_contracts(root: Path, project: dict[str, Any]) -> list[str]:
    """Packages on the disk that a list of the import contracts lacks."""
    listed = {contract["name"]: contract for contract in project["tool"]["importlinter"]["contracts"]}
    return [
        f"operator/pyproject.toml: contract {name!r}: {key} lacks {missing}"
        for beginning, (key, names) in demanded(root).items()
        for name, contract in listed.items()
        if name.startswith(beginning)
        for missing in sorted(names - {part for entry in contract[key] for part in entry.split(" | ")})
    ]


def demanded(root: Path) -> dict[str, tuple[str, set[str]]]:
    """What the name of a contract begins with -> its key with a list, and what has to stand there."""
    names = {module_name(path, root.parent) for path in modules(root)} | packages(root)
    floors = {f"robotkube.{floor}" for floor in FLOORS} & names
    first = {name for name in names if name.count(".") == 1}
    subjects = {name for name in names if name.rpartition(".")[0] in floors} | (first - floors)
    ros = "robotkube.robots.ros"
    of_ros = {f"{ros}.{kind}" for kind in KINDS if kind != "adapters"} & names
    layered = {name for name in subjects for kind in KINDS if f"{name}.{kind}" in names}
    running = first - {"robotkube.testing"}
    libraries = adapter_libraries(root)
    return {
        "Floors": ("layers", running),
        "Subjects form no circle": ("ancestors", floors | {"robotkube"}),
        "Inside a subject": ("containers", layered),
        "A core is pure": ("forbidden_modules", libraries),
        "Ports and loops": ("forbidden_modules", libraries),
        "ROS is known": ("source_modules", subjects - {ros} | of_ros | {"ci", "scenarios"}),
        "Nothing that runs": ("source_modules", running),
    }


def adapter_libraries(root: Path) -> set[str]:
    """Libraries that adapters import, but for those that are pure: what they are called in an import."""
    adapters = [path for path in modules(root) if "adapters" in path.relative_to(root).parts]
    imported = {name for path in adapters for _, name in _first_parts(path, root.parent)}
    return imported - sys.stdlib_module_names - {"robotkube", *cores.LIBRARIES}


def packages(root: Path) -> set[str]:
    folders = {path.parent.relative_to(root.parent).parts for path in modules(root)}
    return {".".join(parts[:length]) for parts in folders for length in range(1, len(parts) + 1)}


def forbidden_imports(top: Path) -> list[str]:
    """Imports of ROS outside of its adapter, and of the tests anywhere."""
    problems = []
    for package, place in ROOTS.items():
        for path in modules(top / place / package):
            name = path.relative_to(top).as_posix()
            problems += kinds_of_clusters(path, name, top / place)
            for line, imported in _first_parts(path, top / place):
                if imported in ROS and not name.startswith(ROS_HOME) and name not in ROS_ELSEWHERE:
                    problems.append(f"{name}:{line}: imports {imported}; only {ROS_HOME} knows ROS")
                if package == "gitops" and imported in ROOTS and imported != package:
                    problems.append(
                        f"{name}:{line}: imports {imported}; gitops stands below all others, it imports none of them"
                    )
                if imported == "tests":
                    problems.append(f"{name}:{line}: imports tests; only tests do")
    return problems


def kinds_of_clusters(path: Path, name: str, root: Path) -> list[str]:
    """Imports of what only one kind of cluster has, outside of the providers' folder."""
    if name.startswith(f"{PROVIDERS.replace('.', '/')}/"):
        return []
    return [
        f"{name}:{one.line}: imports {one.whole}; who uses a cluster does not know its kind: take it from "
        f"{CONTRACT}, or have {CHOOSING} do it"
        for one in imports_in(path.read_text(encoding="utf-8"), package_of(path, root))
        if one.whole.startswith(f"{PROVIDERS}.") and not f"{one.whole}.".startswith(f"{CHOOSING}.")
    ]


def _first_parts(path: Path, root: Path) -> Iterator[tuple[int, str]]:
    for one in imports_in(path.read_text(encoding="utf-8"), package_of(path, root)):
        yield one.line, one.module.partition(".")[0]
