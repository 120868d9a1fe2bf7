"""Policies as files of the API server, which no request to it can see, change or delete.

    <folder>/admission.yaml             the server's admission configuration, which names the folder below
    <folder>/manifests/policies.json    policies, bindings and the list, in one file that is replaced at once

The server reads the folder again when it changes, and keeps what it had when that cannot be used; but it does not start
on such a file, and it starts without policies on an empty folder. So the first list is written before the server
starts, each later one beside the folder and then renamed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.errors import InputError

FEATURE = "ManifestBasedAdmissionControlConfig"
BYTES_MAX = 8 * 1024 * 1024


class PolicyFiles:
    """The files below `folder`, an absolute path of the API server's machine."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._manifests = folder / "manifests"
        self.configuration = folder / "admission.yaml"
        self.policies = self._manifests / "policies.json"

    @property
    def options(self) -> Mapping[str, str]:
        """Options of kube-apiserver that make it read these files."""
        return {"feature-gates": f"{FEATURE}=true", "admission-control-config-file": str(self.configuration)}

    def write(self, documents: Sequence[Mapping[str, Any]]) -> bool:
        """Replace the policies; False when they stood there already. The file is whole at every moment, also after a
        power failure. InputError when they would be none, or more than the server should read."""
        text = json.dumps({"apiVersion": "v1", "kind": "List", "items": list(documents)}, indent=1, sort_keys=True)
        if not documents or len(text) > BYTES_MAX:
            raise InputError(f"{self.policies}: {len(documents)} policies in {len(text)} bytes: not written")
        if self.policies.is_file() and self.policies.read_text(encoding="utf-8") == text:
            return False
        self._manifests.mkdir(parents=True, exist_ok=True)
        if not self.configuration.is_file():
            _replace(self.configuration, self._folder, json.dumps(self._configuration(), indent=1))
        _replace(self.policies, self._folder, text)
        return True

    def intact(self) -> bool:
        """Always: who may write this machine's files is beyond this."""
        return True

    def _configuration(self) -> dict[str, Any]:
        api = "apiserver.config.k8s.io/v1"
        folder = {"staticManifestsDir": str(self._manifests)}
        configuration = {"apiVersion": api, "kind": "ValidatingAdmissionPolicyConfiguration", **folder}
        plugin = {"name": "ValidatingAdmissionPolicy", "configuration": configuration}
        return {"apiVersion": api, "kind": "AdmissionConfiguration", "plugins": [plugin]}


def _replace(path: Path, beside: Path, text: str) -> None:
    """Write in the folder `beside`, then rename: the server's folder never holds a part of a file."""
    part = beside / f".{path.name}.{os.getpid()}"
    with part.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
