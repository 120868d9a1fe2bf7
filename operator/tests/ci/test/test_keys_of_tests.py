"""The key with which tests sign is in no file, so none stays when a run of tests is killed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.stages.forge.catalogue_evidence import OTHER_SEED, artefact, gate_key, signing, trusted_keys
from tests.stages.paths import REPOSITORY

OPERATOR = REPOSITORY / "operator"
KILLED = """
import os, signal
from tests.stages.forge.catalogue_evidence import artefact, gate_key, signing, trusted_keys
signing(artefact("mqtt-bridge", "0.1.0", "sha256:" + "1" * 64))
assert trusted_keys().trusted() == {gate_key().key_id}
print("used", flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_process_that_is_killed_leaves_no_key(tmp_path: Path) -> None:
    options = {"cwd": OPERATOR, "env": {**os.environ, "TMPDIR": str(tmp_path)}, "timeout": 60}
    done = subprocess.run([sys.executable, "-c", KILLED], capture_output=True, check=False, **options)
    assert (done.stdout, done.returncode) == (b"used\n", -9), done.stderr.decode()
    assert list(tmp_path.iterdir()) == []


def test_the_public_key_that_is_trusted_is_the_gates() -> None:
    assert trusted_keys().trusted() == {gate_key().key_id}
    assert gate_key(OTHER_SEED).key_id != gate_key().key_id
    assert signing(artefact("mqtt-bridge", "0.1.0", "sha256:" + "1" * 64)).key.key_id == gate_key().key_id
