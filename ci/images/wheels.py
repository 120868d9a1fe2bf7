"""`python -m ci.images.wheels`, a part of `make lock`: the wheels that operator/images/ros-distribution gets on arm64,
by digest and file name.

The lock has the digests of all files of a version, and does not say for which Python and which processor each is. The
list does; fetching it fails when a version has no wheel that fits.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

from ci.errors import SetUpError
from ci.images.catalogue import DOCKERFILES, TOP

FOLDER = DOCKERFILES / "ros-distribution"
LIST = FOLDER / "wheels.txt"
LOCK = TOP / "operator" / "requirements" / "robot.txt"
PYTHON = "3.12"  # of Ubuntu 24.04, for which ROS 2 Jazzy is packaged
PLATFORMS = ("manylinux2014_aarch64", "manylinux_2_17_aarch64", "manylinux_2_28_aarch64")  # its C library: 2.39
FETCH_SECONDS_MAX = 600


def selected(lock: Path = LOCK) -> str:
    """The lines of a lock that the image installs, by the image's own program."""
    command = [FOLDER / "select-requirements", lock]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout


def fetch(folder: Path) -> None:
    """Fetch the wheels of `selected` into `folder`; SetUpError with pip's last words when one does not fit."""
    requirements = folder / "selected.txt"
    requirements.write_text(selected(), encoding="utf-8")
    command = [sys.executable, "-m", "pip", "download", "-q", "--python-version", PYTHON, "--only-binary", ":all:"]
    command += [word for platform in PLATFORMS for word in ("--platform", platform)]
    command += ["--no-deps", "--require-hashes", "-r", str(requirements), "-d", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=FETCH_SECONDS_MAX)
    if done.returncode:
        raise SetUpError(f"wheels for Python {PYTHON} on {PLATFORMS[0]}: {done.stderr.strip()[-500:]}")


def write() -> None:
    """Write the list anew."""
    with tempfile.TemporaryDirectory() as folder:
        fetch(Path(folder))
        wheels = sorted(Path(folder).glob("*.whl"))
        lines = [f"{hashlib.sha256(wheel.read_bytes()).hexdigest()}  {wheel.name}\n" for wheel in wheels]
    LIST.write_text("".join(lines), encoding="utf-8")
    print(LIST.relative_to(TOP))


def main() -> int:
    """Exit code 0 written, 3 a wheel is missing."""
    try:
        write()
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
