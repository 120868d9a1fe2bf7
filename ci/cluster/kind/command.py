"""The program kind, and what it says when it fails."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

from ci.cluster.kind.configuration import CLUSTER
from ci.errors import SetUpError

READY_SECONDS_MAX = 180
CREATE_SECONDS_MAX = 900  # the first one pulls the image of nodes
ANSWER_SECONDS_MAX = 120
WORDS_MAX = 3000


@dataclass(frozen=True)
class Kind:
    """kind as a command; which engine it uses is its own choice (KIND_EXPERIMENTAL_PROVIDER)."""

    program: Path

    def runs(self) -> bool:
        """Return whether there is the cluster, whatever state it is in."""
        return CLUSTER in self._run("get", "clusters").split()

    def create(self, configuration: Path, kubeconfig: Path, node_image: str) -> None:
        """Make the cluster; it is gone again when that fails."""
        words = ["create", "cluster", "--config", str(configuration), "--kubeconfig", str(kubeconfig)]
        words += ["--wait", f"{READY_SECONDS_MAX}s", *(["--image", node_image] if node_image else [])]
        self._run(*words, seconds=CREATE_SECONDS_MAX)

    def delete(self, kubeconfig: Path) -> None:
        """Remove the cluster, and what names it in the kubeconfig."""
        self._run("delete", "cluster", "--name", CLUSTER, "--kubeconfig", str(kubeconfig))

    def _run(self, *words: str, seconds: float = ANSWER_SECONDS_MAX) -> str:
        command = [str(self.program), *words]
        said = f"kind {' '.join(words[:2])}"
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
        except subprocess.TimeoutExpired as error:
            raise SetUpError(f"{said}: no end within {seconds:.0f} s") from error
        if done.returncode:
            raise SetUpError(f"{said}: {done.stderr.strip()[-WORDS_MAX:]}")
        return done.stdout
