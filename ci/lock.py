"""`make lock`: the lock files of operator/requirements/ from operator/pyproject.toml, with hashes and without
download addresses; and which of the robots' files are for the image on ROS 2 of Ubuntu.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from ci.images import wheels

TOP = Path(__file__).resolve().parent.parent
# cyclonedx-bom asks for jsonschema's format checks, of which one builds a grammar whenever jsonschema is imported:
# 1.4 s in every process of ours. Nothing here checks that format, and jsonschema works without it.
LEFT_OUT = ["--no-emit-package", "rfc3987-syntax", "--no-emit-package", "lark"]
OF_DEVELOPMENT = ("platform", "terminal", "robot", "scenario", "images", "development")
LOCKS = {
    "platform": ["--extra", "platform"],
    "robot": ["--extra", "robot"],
    "development": [*(word for name in OF_DEVELOPMENT for word in ("--extra", name)), *LEFT_OUT],
    "docs": ["--extra", "docs"],
    "console": ["--extra", "console"],
}
UV = "uv==0.13.8"  # the resolver; installed into a folder that is thrown away


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "pip", "install", "-q", "--target", folder, UV], check=True)
        for name, extras in LOCKS.items():
            target = f"requirements/{name}.txt"
            command = [
                f"{folder}/bin/uv",
                "pip",
                "compile",
                "-q",
                "--python-version",
                "3.11",
                *extras,
                "pyproject.toml",
            ]
            options = [
                "--generate-hashes",
                "--no-emit-index-url",
                "--custom-compile-command",
                "make lock",
                "-o",
                target,
            ]
            subprocess.run([*command, *options], cwd=TOP / "operator", check=True, stdout=subprocess.DEVNULL)
            print(f"operator/{target}")
    return wheels.main()


if __name__ == "__main__":
    sys.exit(main())
