"""The container engine that kind finds: docker, else podman, unless KIND_EXPERIMENTAL_PROVIDER names one."""

from __future__ import annotations

import os
import subprocess

CHOICE = "KIND_EXPERIMENTAL_PROVIDER"
KNOWN = {"docker": "Docker version", "podman": "podman version"}
"""Programs in kind's order, and how their answer to -v begins; kind knows more of them."""
ASKED_SECONDS_MAX = 30
WORDS_MAX = 500


def found() -> str:
    """The name of its program; empty when there is none that is known here."""
    chosen = os.environ.get(CHOICE, "")
    names = [name for name in KNOWN if name == chosen] if chosen else list(KNOWN)
    return next((name for name in names if _answers(name)), "")


def problem(engine: str) -> str:
    """What an engine says when it cannot be used, for example because its daemon does not run; empty: it can."""
    done = subprocess.run([engine, "version"], capture_output=True, text=True, timeout=ASKED_SECONDS_MAX, check=False)
    return (done.stderr or done.stdout).strip()[-WORDS_MAX:] if done.returncode else ""


def has(engine: str, reference: str) -> bool:
    """Return whether an engine has an image."""
    return bool(engine) and _ends_well([engine, "image", "inspect", reference])


def _answers(name: str) -> bool:
    try:
        done = subprocess.run(
            [name, "-v"],
            capture_output=True,
            text=True,
            timeout=ASKED_SECONDS_MAX,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.stdout.startswith(KNOWN[name])


def _ends_well(command: list[str]) -> bool:
    try:
        return subprocess.run(command, capture_output=True, timeout=ASKED_SECONDS_MAX, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False
