"""buildah, run without a daemon and with a storage of its own, so that a user's images and containers are never
touched."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

BUILD_SECONDS_MAX = 1800
COMMAND_SECONDS_MAX = 600
STOP_SECONDS_MAX = 10
LOG_LINES_SHOWN = 25
FREE_BYTES_MIN = 6_000_000_000
SAME_EVERYWHERE = {"LC_ALL": "C.UTF-8", "TZ": "UTC"}  # sorting and dates in what builds write


class BuildError(Exception):
    """A build step failed; the message carries the end of its output and names the log."""


@dataclass(frozen=True)
class Buildah:
    """`storage` holds images and layers and is kept between runs; `log` collects the output of all commands."""

    storage: Path
    log: Path

    def _command(self, *words: str) -> list[str]:
        roots = [
            "--root",
            str(self.storage / "root"),
            "--runroot",
            str(self.storage / "run"),
            "--storage-driver",
            "overlay",
        ]
        return ["buildah", *roots, *words]

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
        arguments: dict[str, str],
        volumes: tuple[str, ...],
        fresh: bool,
    ) -> None:
        """Build `dockerfile` with its own layers cached unless `fresh`; the machine's network is used, base images
        are never fetched."""
        words = [
            "build",
            "--layers",
            "--pull-never",
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
            raise BuildError(f"buildah could not load {archive}: {done.stderr.strip()}")
        self.run("tag", done.stdout.split()[-1], tag)

    def export(self, tag: str, folder: Path) -> None:
        """Write the image as a folder: manifest.json, config and layers named by hex digest, not compressed."""
        self.run("push", "--quiet", "--disable-compression", "--format", "oci", tag, f"dir:{folder}")

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


def require_programs(folder: Path) -> None:
    """Say what the machine lacks for building in `folder` before anything is started."""
    missing = [name for name in ("buildah", "mmdebstrap") if shutil.which(name) is None]
    if missing:
        packages = " ".join(missing)
        raise BuildError(f"missing: {packages}; apt-get install -y --no-install-recommends {packages}")
    if os.geteuid() != 0:
        raise BuildError("building images needs root (overlay mounts and chroot); run as root")
    free = shutil.disk_usage(folder).free
    if free < FREE_BYTES_MIN:
        raise BuildError(f"{folder}: {free / 1e9:.1f} GB free, building images needs {FREE_BYTES_MIN / 1e9:.0f} GB")
