"""Break-glass with OpenSSH's own program: its keys sign, and it verifies what main has."""

from __future__ import annotations

import base64
import subprocess
from pathlib import Path

import pytest

from robotkube.delivery.deployment.adapters.ssh_keys import holds, sign
from robotkube.delivery.deployment.core.break_glass import NAMESPACE, EmergencyChange, read_signers
from robotkube.delivery.deployment.core.unchecked_commits import BREAK_GLASS, NOT_SIGNED, GlassClaim, judge_claim

pytestmark = pytest.mark.processes
NAMES = ("ada", "grace")
CHANGE = EmergencyChange("robotkube/deployment", "a" * 40, "b" * 40, "2026-11-24T12:00:00Z", "the gate is away", {})


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """Keys of both, and the file of who signs."""
    for name in NAMES:
        run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", f"{name}@laptop", "-f", str(tmp_path / name))
    lines = [f"{name} {(tmp_path / f'{name}.pub').read_text()}" for name in NAMES]
    (tmp_path / "signers").write_text("".join(lines))
    return tmp_path


def run(*command: str, given: bytes = b"") -> int:
    return subprocess.run(command, input=given, capture_output=True, timeout=30, check=False).returncode


def claim(change: EmergencyChange) -> GlassClaim:
    return GlassClaim("c" * 40, change.repository, (change.parent,), change.tree, change.message)


def test_keys_of_openssh_sign_and_what_openssh_signs_holds(keys: Path) -> None:
    signers = (keys / "signers").read_text()
    statement = keys / "statement"
    statement.write_bytes(CHANGE.statement)
    assert run("ssh-keygen", "-Y", "sign", "-n", NAMESPACE, "-f", str(keys / "ada"), str(statement)) == 0
    armoured = (keys / "statement.sig").read_text().strip().split("\n")[1:-1]
    theirs = "".join(armoured)
    ours = sign(keys / "grace", CHANGE.statement, str)[1]
    assert holds(theirs, read_signers(signers)["ada"], CHANGE.statement)
    signed = CHANGE.signed_by("ada", theirs).signed_by("grace", ours)
    assert judge_claim(claim(signed), signers, holds).how == BREAK_GLASS
    exchanged = CHANGE.signed_by("ada", ours).signed_by("grace", theirs)
    assert judge_claim(claim(exchanged), signers, holds).how == NOT_SIGNED


def test_openssh_verifies_what_the_command_signed(keys: Path) -> None:
    """As docs/how-to/break-the-glass.md has it."""
    signature = sign(keys / "ada", CHANGE.statement, str)[1]
    text = base64.b64encode(base64.b64decode(signature)).decode()
    (keys / "sig").write_text(f"-----BEGIN SSH SIGNATURE-----\n{text}\n-----END SSH SIGNATURE-----\n")
    verify = ("ssh-keygen", "-Y", "verify", "-n", NAMESPACE, "-f", str(keys / "signers"), "-I", "ada", "-s")
    assert run(*verify, str(keys / "sig"), given=CHANGE.statement) == 0
    assert run(*verify, str(keys / "sig"), given=CHANGE.statement + b"x") != 0
