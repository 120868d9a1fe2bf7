"""Message packages of a publisher, compiled into the image that its own image is built on."""

from __future__ import annotations

import tempfile
from pathlib import Path

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import MESSAGE_FILE, ROS_PACKAGE
from robotkube.registry.images.adapters.build_contexts import copy_context
from robotkube.registry.images.core.dockerfiles import BASE
from robotkube.registry.images.ports import Engine
from robotkube.robots.ros.core.message_definitions import read_definitions
from robotkube.robots.ros.core.packaged_types import PACKAGED_TYPES

FOLDER = "msgs"
SOURCES = Path(__file__).resolve().parent.parent / "skeletons" / "messages"
PACKAGES_MAX = 50


def message_packages(folder: Path) -> tuple[str, ...]:
    """The packages in `msgs` of an image's folder; none without it. DocumentError names everything that is none."""
    place = folder / FOLDER
    if not place.is_dir():
        return ()
    packages = sorted(path for path in place.iterdir() if not path.name.startswith("."))
    problems = [problem for package in packages for problem in _problems(package)]
    if len(packages) > PACKAGES_MAX:
        problems.append(f"{len(packages)} packages; at most {PACKAGES_MAX} are compiled")
    if problems:
        raise DocumentError(str(place), problems)
    return tuple(package.name for package in packages)


def with_messages(folder: Path, name: str, base: str, engine: Engine) -> str:
    """Build the image `base` with the message packages of `folder`; its tag. `base` must be the platform's `ros`, or
    stand on it."""
    tag = f"localhost/robotkube-own/{name}-messages:latest"
    with tempfile.TemporaryDirectory(prefix=f"{name}-messages-") as work:
        context = Path(work) / "context"
        copy_context(SOURCES, context)
        copy_context(folder / FOLDER, context / FOLDER)
        engine.build(context, context / "Dockerfile", tag, {BASE: base})
    return tag


def _problems(package: Path) -> list[str]:
    name = package.name
    if not package.is_dir() or not ROS_PACKAGE.fullmatch(name):
        return [f"{name}: is no message package; write {FOLDER}/<package>/msg/<Message>.msg, the package in lower case"]
    if name in PACKAGED_TYPES:
        return [f"{name}: is a package of the platform's images; give yours another name"]
    others = sorted(path.name for path in package.iterdir() if path.name != "msg")
    problems = [f"{name}/{other}: only messages are compiled; take it out of {FOLDER}" for other in others]
    files = sorted((package / "msg").glob("*")) if (package / "msg").is_dir() else []
    if not files:
        problems.append(f"{name}/msg: holds no message; write {FOLDER}/{name}/msg/<Message>.msg")
    return [*problems, *(problem for file in files for problem in _message_problems(name, file))]


def _message_problems(package: str, file: Path) -> list[str]:
    if not MESSAGE_FILE.fullmatch(file.name) or not file.is_file():
        return [f"{package}/msg/{file.name}: is no message; name it like PoseStamped.msg"]
    try:
        read_definitions(f"{package}/msg/{file.stem}", file.read_text(encoding="utf-8"))
    except ValueError as error:
        return [f"{package}/msg/{file.name}: {error}; correct it"]
    return []
