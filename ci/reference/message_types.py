"""What `make reference` writes of message types: those of the wheels that the image `ros` is made of, as a module of
the package and as docs/reference/message-types.md.

An image knows a type when its package's type support for the middleware's C interface has it: what the bridge, the
detector, the player and the observer of suites load. Images of services have the layers of `ros` with these packages,
so one list stands for all of them; a test compares it with the image itself.
"""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ci.docs import markdown
from ci.folders import PROJECT
from ci.images.services import GROUND, SERVICE_NAMES
from robotkube.robots.ros.adapters.rclpy_node import MessageTypeError, message_type

LOCK = PROJECT / "operator" / "requirements" / "robot.txt"
MODULE = PROJECT / "operator" / "src" / "robotkube" / "robots" / "ros" / "core" / "packaged_types.py"
PAGE = PROJECT / "docs" / "reference" / "message-types.md"
WIDTH = 120

_LOCKED = re.compile(r"^(ros-[a-z0-9-]+)==(\S+)", re.MULTILINE)
_SUPPORT = re.compile(r"/site-packages/(\w+)/\1_s__rosidl_typesupport_c\.[^/]*so$")
_DEFINITION = re.compile(r"/share/(\w+)/msg/(\w+)\.msg$")
_MODULE_HEAD = '''"""The message types that the packaged images know, by package. Written by `make reference` from the
wheels of operator/requirements/robot.txt, which the image `ros` has; images of services are cut from it. A test says
when this module is not current, another compares it with the image."""

from __future__ import annotations

from collections.abc import Mapping

'''
_PAGE_HEAD = f"""# Message types

Written by `make reference` from the wheels of operator/requirements/robot.txt; a test says when this page is not
current. These types are known to every image that speaks ROS 2: `{GROUND}` and, cut from it,
{", ".join(f"`{name}`" for name in sorted(SERVICE_NAMES))}. Bridges carry them, event detectors subscribe to them, the
suites `interface` and `install` publish them. What is refused with another type, and where:
[message types of your own](../how-to/add-an-application.md#message-types-of-your-own).

| package | version | messages |
| --- | --- | --- |
"""


def installed_types(prefix: Path | None = None) -> dict[str, tuple[str, ...]]:
    """Package -> messages, of the installation in `prefix` (default: this Python's)."""
    types: dict[str, tuple[str, ...]] = {}
    for folder in sorted(((prefix or Path(sys.prefix)) / "share").glob("*/msg")):
        package = folder.parent.name
        names = tuple(name for name in sorted(p.stem for p in folder.glob("*.msg")) if _supported(package, name))
        types |= {package: names} if names else {}
    return types


def types_among(paths: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """The same of an image, from the paths of its files: definitions of packages that have type support."""
    present = frozenset(paths)
    supported = {match[1] for path in present if (match := _SUPPORT.search(path))}
    types: dict[str, list[str]] = {}
    for path in sorted(present):
        match = _DEFINITION.search(path)
        if match and match[1] in supported:
            types.setdefault(match[1], []).append(match[2])
    return {package: tuple(names) for package, names in sorted(types.items())}


def locked_versions() -> dict[str, str]:
    """Package of messages -> version, of what the lock of robots' images pins and is installed here in that version."""
    locked = dict(_LOCKED.findall(LOCK.read_text(encoding="utf-8")))
    versions = {}
    for package in installed_types():
        wheel = f"ros-{package.replace('_', '-')}"
        if locked.get(wheel) == _installed(wheel):
            versions[package] = locked[wheel]
    return versions


def module(types: Mapping[str, Iterable[str]]) -> str:
    """The text of the module."""
    images = "".join(f'        "{name}",\n' for name in sorted({GROUND, *SERVICE_NAMES}))
    entries = "".join(_entry(package, names) for package, names in types.items())
    return (
        f"{_MODULE_HEAD}PACKAGED_IMAGES = frozenset(\n    {{\n{images}    }}\n)\n\n"
        f"PACKAGED_TYPES: Mapping[str, str] = {{\n{entries}}}\n"
        '"""Package -> its messages, separated by spaces."""\n'
    )


def page(types: Mapping[str, Iterable[str]], versions: Mapping[str, str]) -> str:
    """The page of the reference."""
    rows = [f"| `{package}` | {versions[package]} | {', '.join(names)} |\n" for package, names in types.items()]
    return markdown.wrapped(f"{_PAGE_HEAD}{''.join(rows)}")


def write() -> Iterable[Path]:
    """Write both."""
    types = installed_types()
    MODULE.write_text(module(types), encoding="utf-8")
    PAGE.write_text(page(types, locked_versions()), encoding="utf-8")
    return MODULE, PAGE


def _supported(package: str, name: str) -> bool:
    try:
        message_type(f"{package}/msg/{name}")
    except MessageTypeError:
        return False
    return True


def _installed(wheel: str) -> str:
    try:
        return version(wheel)
    except PackageNotFoundError:
        return ""


def _entry(package: str, names: Iterable[str]) -> str:
    """An entry of the mapping, as the formatter would lay it out."""
    text = " ".join(names)
    line = f'    "{package}": "{text}",\n'
    if len(line) <= WIDTH:
        return line
    parts = textwrap.wrap(text, WIDTH - 11)
    inner = "".join(f'        "{part} "\n' for part in parts[:-1])
    return f'    "{package}": (\n{inner}        "{parts[-1]}"\n    ),\n'
