"""The forge as a command reaches it: an address and an account, given or those of the kubeconfig's cluster."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from robotkube.cli.platform import Platform
from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.certificate_authorities import trust

REPOSITORY = "robotkube/deployment"


@dataclass(frozen=True)
class AccountAtForge:
    """The address at which the forge is reached from here, and an account of it."""

    url: str
    username: str
    password: str


def reaching(parser: argparse.ArgumentParser) -> None:
    """Add the arguments by which the forge is found."""
    parser.add_argument("--forge-url", metavar="URL", help="the forge (default: that of the kubeconfig's cluster)")
    parser.add_argument("--forge-ca", type=Path, metavar="FILE", help="who signed its certificate, besides the usual")
    parser.add_argument("--password-file", type=Path, metavar="FILE", help="file with the account's password there")


def forge_account(options: argparse.Namespace, name: str) -> AccountAtForge:
    """The account `name` of the forge; InputError says what is missing."""
    if not options.forge_url:
        return AccountAtForge(*Platform(options).forge_account(name))
    if not options.password_file:
        raise InputError(f"--forge-url needs --password-file with the password of {name}")
    try:
        password = options.password_file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--password-file {options.password_file}: cannot be read: {error}") from error
    trust(options.forge_ca)
    return AccountAtForge(options.forge_url.rstrip("/"), name, password)
