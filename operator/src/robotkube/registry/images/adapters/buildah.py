"""buildah, or podman, which builds with the same library and the same words: run without a daemon and with a storage
of its own, so that a user's images and containers are never touched."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robotkube.errors import InputError

BUILD_SECONDS_MAX = 1800
COMMAND_SECONDS_MAX = 600
STOP_SECONDS_MAX = 10
LOG_LINES_SHOWN = 25
UMASK = 0o022  # modes of what a build writes must not depend on who builds
SAME_EVERYWHERE = {"LC_ALL": "C.UTF-8", "TZ": "UTC"}  # sorting and dates in what builds write


class BuildError(InputError):
    """A build step failed; the message carries the end of its output and names the log."""


@dataclass(frozen=True)
class Buildah:
    """Images by buildah or podman. `storage` holds images and layers and is kept between runs; `log` collects the
    output of all commands; `program` is buildah or podman; `fetching`: base images that are not in the storage are
    asked of their registries."""

    storage: Path
    log: Path
    program: str = "buildah"
    driver: str = "overlay"
    fetching: bool = False

    def _command(self, *words: str) -> list[str]:
        roots = [
            "--root",
            str(self.storage / "root"),
            "--runroot",
            str(self.storage / "run"),
            "--storage-driver",
            self.driver,
        ]
        return [self.program, *roots, *words]

    def run(self, *words: str, seconds: int = COMMAND_SECONDS_MAX) -> None:
        run_logged(self._command(*words), self.log, seconds, {"BUILDAH_ISOLATION": "chroot"})

    def has(self, tag: str) -> bool:
        command = self._command("inspect", "--type", "image", tag)
        return (
            self.storage.exists()
            and subprocess.run(command, capture_output=True, check=False, timeout=60).returncode == 0
        )

    def build(
        self,
        context: Path,
        dockerfile: Path,
        tag: str,
        arguments: Mapping[str, str],
        volumes: tuple[str, ...] = (),
        fresh: bool = False,
    ) -> None:
        """Build `dockerfile` with its own layers cached unless `fresh`; the machine's network is used."""
        words = [
            "build",
            "--layers",
            "--force-rm",
            *([] if self.fetching else ["--pull=never"] if self.program == "podman" else ["--pull-never"]),
            "--network",
            "host",
            "--format",
            "oci",
            "--file",
            str(dockerfile),
            "--tag",
            tag,
        ]
        words += [f"--build-arg={name}={value}" for name, value in arguments.items()]
        words += [f"--volume={volume}" for volume in volumes]
        words += ["--no-cache"] if fresh else []
        self.run(*words, str(context), seconds=BUILD_SECONDS_MAX)

    def load(self, archive: Path, tag: str) -> None:
        """Take an OCI archive into the storage under `tag`."""
        done = subprocess.run(
            self._command("pull", "--quiet", f"oci-archive:{archive}"),
            capture_output=True,
            text=True,
            check=False,
            timeout=COMMAND_SECONDS_MAX,
        )
        if done.returncode:
            raise BuildError(f"{self.program} could not load {archive}: {done.stderr.strip()}")
        self.run("tag", done.stdout.split()[-1], tag)

    def export(self, tag: str, folder: Path) -> None:
        """Write the image as a folder: manifest.json, config and layers named by hex digest, not compressed."""
        plain = ["--disable-compression"] if self.program == "buildah" else []  # podman does not compress for a folder
        self.run("push", "--quiet", *plain, "--format", "oci", tag, f"dir:{folder}")

    def clean(self) -> None:
        """Remove working containers, also those of a run that was killed."""
        if self.storage.exists():
            subprocess.run(self._command("rm", "--all"), capture_output=True, check=False, timeout=COMMAND_SECONDS_MAX)


def run_logged(command: list[str], log: Path, seconds: int, environment: dict[str, str]) -> None:
    """Run with output to the end of `log`; on failure or interruption the process is ended before the error goes on."""
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a", encoding="utf-8") as out:
        start = out.tell()
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            env={**os.environ, **SAME_EVERYWHERE, **environment},
            umask=UMASK,
        )
        try:
            code = process.wait(timeout=seconds)
        except subprocess.TimeoutExpired as error:
            raise BuildError(f"{command[0]} took more than {seconds} s; see {log}") from error
        finally:
            _end(process)
    if code:
        lines = log.read_bytes()[start:].decode(errors="replace").splitlines()[-LOG_LINES_SHOWN:]
        raise BuildError(f"{command[0]} ended with code {code}; the end of {log}:\n" + "\n".join(lines))


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(timeout=STOP_SECONDS_MAX)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(timeout=STOP_SECONDS_MAX)
