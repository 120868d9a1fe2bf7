"""What a Dockerfile asks of whoever builds it."""

from __future__ import annotations

import re

BASE = "BASE"
_OPEN_BASE = re.compile(rf"^\s*ARG\s+{BASE}\s*$", re.MULTILINE | re.IGNORECASE)


def wants_base(text: str) -> bool:
    """Return whether the image to build on is to be given: `ARG BASE` without a default."""
    return _OPEN_BASE.search(text) is not None
