"""Copying by the program oras (https://oras.land): from a layout on this machine to any OCI registry, what is attached
with it, every manifest as it is."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.bundles.adapters.accounts import RegistryAccount
from robotkube.registry.bundles.core.contents import BundleItem
from robotkube.registry.bundles.core.places import RegistryPlace

PROGRAM = "oras"
COPY_SECONDS_MAX = 3600  # of one item: an image of 350 MB over a slow line
WORDS_MAX = 1500


@dataclass(frozen=True)
class Oras:
    """The program, and as whom it copies; `authority` is a file with a certificate authority of the registry, `plain`
    says that the registry speaks HTTP."""

    program: str
    account: RegistryAccount
    authority: Path | None = None
    plain: bool = False

    def copy(self, bundle: Path, item: BundleItem, place: RegistryPlace) -> None:
        """Copy an item with all that is attached to it. InputError or UnavailableError with the program's words."""
        target = f"{place}/{item.repository}:{item.tag}"
        command = [
            self.program,
            "cp",
            "--recursive",
            "--no-tty",
            "--from-oci-layout",
            f"{bundle}@{item.digest}",
            target,
        ]
        command += ["--to-ca-file", str(self.authority)] if self.authority else []
        command += ["--to-plain-http"] if self.plain else []
        with self._configuration(place) as file:
            done = self._run([*command, "--to-registry-config", str(file)], target)
        if done.returncode:
            said = (done.stderr or done.stdout).strip()[-WORDS_MAX:]
            kind = InputError if _is_final(said) else UnavailableError
            raise kind(f"{target}: {self.program} cannot copy {item.kind} {item.name}: {said}")

    def _run(self, command: list[str], target: str) -> subprocess.CompletedProcess[str]:
        try:
            return subprocess.run(command, capture_output=True, text=True, timeout=COPY_SECONDS_MAX, check=False)
        except subprocess.TimeoutExpired as error:
            raise UnavailableError(
                f"{target}: not copied within {COPY_SECONDS_MAX} s; the same again goes on"
            ) from error
        except OSError as error:
            raise InputError(f"{self.program}: cannot be run: {error.strerror}") from error

    @contextmanager
    def _configuration(self, place: RegistryPlace) -> Iterator[Path]:
        """A file with the account, which no list of processes shows and only this user can read."""
        with tempfile.TemporaryDirectory(prefix="robotkube-bundle-") as folder:
            file = Path(folder) / "config.json"
            file.touch(mode=0o600)
            accounts = {place.host: {"auth": self.account.encoded}} if self.account.user else {}
            file.write_text(json.dumps({"auths": accounts}), encoding="utf-8")
            yield file


def find_oras() -> str:
    """The program on PATH; InputError says where to get it."""
    program = shutil.which(PROGRAM)
    if program is None:
        raise InputError(
            f"{PROGRAM} is not on PATH: install it (https://oras.land), or name the one that `make bundle` put beside "
            "the bundle: --oras FILE"
        )
    return program


def _is_final(said: str) -> bool:
    """Return whether the same again would fail again."""
    words = ("unauthorized", "denied", "forbidden", "not found", "certificate", "401", "403", "invalid")
    return any(word in said.lower() for word in words)
