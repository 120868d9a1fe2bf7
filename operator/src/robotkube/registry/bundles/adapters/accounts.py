"""Accounts by which a registry is used: the account that was given, or what `docker login`, `podman login` and `helm
registry login` left in Docker's file."""

from __future__ import annotations

import base64
import binascii
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json


@dataclass(frozen=True)
class RegistryAccount:
    """A user of a registry; an empty name is nobody."""

    user: str = ""
    password: str = ""

    @property
    def encoded(self) -> str:
        """The form in which Docker's file has it."""
        return base64.b64encode(f"{self.user}:{self.password}".encode()).decode()


def given_account(user: str, password_file: Path | None) -> RegistryAccount | None:
    """The account of the command line; None when none is given."""
    if not user and password_file is None:
        return None
    if not user or password_file is None:
        raise InputError("--username and --password-file go together")
    try:
        return RegistryAccount(user, password_file.read_text(encoding="utf-8").strip())
    except OSError as error:
        raise InputError(f"--password-file {password_file}: cannot be read: {error.strerror}") from error


def kept_account(host: str, environment: Mapping[str, str] | None = None) -> RegistryAccount:
    """The account that Docker's file has for a host; nobody when it has none, or keeps it in a helper."""
    variables = os.environ if environment is None else environment
    folder = Path(variables.get("DOCKER_CONFIG") or Path.home() / ".docker")
    path = folder / "config.json"
    try:
        document = read_json(path.read_bytes())
        encoded = document["auths"][host]["auth"]
        user, _, password = base64.b64decode(encoded, validate=True).decode().partition(":")
    except (OSError, KeyError, TypeError):
        return RegistryAccount()
    except (ValueError, binascii.Error) as error:
        raise InputError(f"{path}: auths.{host}: cannot be read: {error}; log in again") from error
    return RegistryAccount(user, password)
