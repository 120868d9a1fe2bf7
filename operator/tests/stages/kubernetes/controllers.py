"""Kubernetes' own controllers beside an API server of the tests, as the embedded cluster starts them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.stages.programs import program

END_SECONDS_MAX = 10


@contextmanager
def controlling(folder: Path, kubeconfig: Path) -> Iterator[None]:
    """The controller manager of the API server below `folder`; each controller has an account of its own."""
    command = [
        program("kube-controller-manager"),
        f"--kubeconfig={kubeconfig}",
        f"--service-account-private-key-file={folder}/account.key",
        "--use-service-account-credentials",
        "--leader-elect=false",
        "--secure-port=0",
    ]
    with (folder / "kube-controller-manager.log").open("wb") as log:
        manager = subprocess.Popen(command, stdout=log, stderr=log)
    try:
        yield
    finally:
        manager.kill()
        manager.wait(END_SECONDS_MAX)
