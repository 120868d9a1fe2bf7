"""Folders of what was built: below the user's cache folder, never in the repository."""

from __future__ import annotations

import os
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent


def user_cache() -> Path:
    """RobotKube's folder below $XDG_CACHE_HOME (default ~/.cache); it may not exist yet."""
    configured = os.environ.get("XDG_CACHE_HOME", "")
    base = Path(configured) if configured.startswith("/") else Path.home() / ".cache"
    return base / "robotkube"
