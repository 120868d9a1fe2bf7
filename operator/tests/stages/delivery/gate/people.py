"""People with SSH keys in OpenSSH's files, who sign break-glass commits as the command does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from robotkube.delivery.deployment.adapters.ssh_keys import sign
from robotkube.delivery.deployment.core.break_glass import EmergencyChange

TIME = "2026-11-24T12:00:00Z"
REPOSITORY = "robotkube/deployment"


@dataclass(frozen=True)
class People:
    """Private keys below `folder`, by name."""

    folder: Path

    def add(self, *names: str) -> People:
        """Make a key for each."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for name in names:
            key = Ed25519PrivateKey.generate()
            text = key.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, NoEncryption())
            (self.folder / name).write_bytes(text)
            public = key.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH).decode()
            (self.folder / f"{name}.pub").write_text(f"{public} {name}@laptop\n")
        return self

    def signers(self, *names: str) -> str:
        """policies/signers with these people."""
        return "".join(f"{name} {(self.folder / f'{name}.pub').read_text()}" for name in names)

    def signed(self, change: EmergencyChange, *names: str) -> EmergencyChange:
        """The change with their signatures."""
        for name in names:
            change = change.signed_by(name, sign(self.folder / name, change.statement, str)[1])
        return change

    def message(self, parent: str, tree: str, reason: str, *names: str) -> str:
        """The message of the commit that has `tree` on `parent`, signed by these people."""
        return self.signed(EmergencyChange(REPOSITORY, parent, tree, TIME, reason, {}), *names).message
