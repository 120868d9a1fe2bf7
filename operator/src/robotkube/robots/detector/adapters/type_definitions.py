"""The definitions of message types: those of installed packages, then those that the broker has carried."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from robotkube.robots.ros.adapters import installed_definitions


def definition(type_name: str, carried: Mapping[str, str]) -> str:
    """The definition of a type with all it uses: an installed one counts before one that the broker has `carried`;
    KeyError when it is unknown."""
    return installed_definitions.definition(type_name, Path(sys.prefix) / "share") or carried[type_name]
