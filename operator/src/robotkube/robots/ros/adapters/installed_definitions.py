"""Message definitions as MCAP files carry them."""

from __future__ import annotations

import re
from pathlib import Path

FIELDS_DEPTH_MAX = 16

_BUILT_IN = re.compile(r"(u?int(8|16|32|64)|float(32|64)|bool|byte|char|w?string)$")


def definition(type_name: str, share: Path) -> str:
    """The definition of a type with all types it uses, in MCAP's `ros2msg` form; `""` when `share` does not have it."""
    parts: dict[str, str] = {}
    try:
        _collect(type_name, share, parts, 0)
    except OSError:
        return ""
    first, *others = parts.items()
    return "\n".join([first[1], *(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in others)])


def _collect(type_name: str, share: Path, parts: dict[str, str], depth: int) -> None:
    package = type_name.split("/")[0]
    name = type_name.split("/")[-1]
    key = f"{package}/{name}"
    if key in parts or depth > FIELDS_DEPTH_MAX:
        return
    text = parts[key] = (share / package / "msg" / f"{name}.msg").read_text()
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if len(words) < 2:
            continue
        field = re.sub(r"(<=\d+)?(\[.*\])?$", "", words[0])
        if not _BUILT_IN.match(field):
            used = field if "/" in field else f"{'std_msgs' if field == 'Header' else package}/{field}"
            _collect(used, share, parts, depth + 1)
