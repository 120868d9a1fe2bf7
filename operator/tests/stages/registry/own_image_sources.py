"""A folder with a Dockerfile that builds on nothing: one program, one file."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

DOCKERFILE = """FROM scratch
LABEL org.opencontainers.image.title="own" org.opencontainers.image.version="0.2.0"
COPY tool /usr/bin/tool
COPY files/ /opt/own/
USER 10001:10001
ENTRYPOINT ["/usr/bin/tool"]
"""


def write_folder(folder: Path, dockerfile: str = DOCKERFILE, mode: int = 0o644, seconds: int = 0) -> Path:
    """Write it, with modes and times as somebody's checkout has them; the folder."""
    (folder / "files").mkdir(parents=True)
    (folder / "Dockerfile").write_text(dockerfile)
    (folder / "files" / "answers.py").write_text("ANSWER = 42\n")
    shutil.copyfile("/bin/true", folder / "tool")
    (folder / "files" / "answers.py").chmod(mode)
    (folder / "tool").chmod(mode | 0o100)
    for path in (folder / "files" / "answers.py", folder / "tool"):
        os.utime(path, (seconds, seconds))
    return folder


def with_example(dockerfile: str) -> str:
    """The Dockerfile of `registry new` with what it shows as an example."""
    shown = re.sub(r"^# (USER|RUN) ", r"\1 ", dockerfile, flags=re.MULTILINE)
    assert shown != dockerfile
    return shown
