"""The process `robotkube-gate-key`: makes the key with which the gate signs evidence, once.

Settings: docs/reference/settings.md. Exit code 0 when key and public half are in their places, 2 when the settings are
wrong or the API server refuses, 3 when it does not answer. Running it again changes nothing.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.foundation.documents.core.patterns import NAME, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.process import Process, run
from robotkube.registry.evidence.adapters.key_pairs import new_key_pair, read_key_pair
from robotkube.setup.adapters.gate_key_objects import KubernetesGateKey
from robotkube.setup.loops.gate_key import provide_key

GRACE_SECONDS = 4.0


@dataclass(frozen=True)
class GateKeySettings:
    """The settings of the Job: Secret `namespace`/`secret`, ConfigMap `public_keys` in each of `namespaces`, and the
    file with the key of an older installation, which may be missing."""

    log_level: str
    namespace: str
    secret: str
    namespaces: tuple[str, ...]
    public_keys: str
    former_key: Path


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> GateKeySettings:
    """Read the settings document of the Job."""
    root = reader.mapping(document, "", ["log_level", "secret", "public_keys", "former_key"])
    secret = reader.mapping(root.get("secret") or {}, "secret", ["namespace", "name"])
    public = reader.mapping(root.get("public_keys") or {}, "public_keys", ["namespaces", "name"])
    namespaces = reader.sequence(public.get("namespaces"), "public_keys.namespaces")
    if not namespaces:
        reader.problems.append("public_keys.namespaces: must name who verifies: the gate's and the platform's")
    return GateKeySettings(
        log_level=files.log_level(reader, root.get("log_level")),
        namespace=reader.word(secret.get("namespace"), "secret.namespace", NAME),
        secret=reader.word(secret.get("name"), "secret.name", WORD),
        namespaces=tuple(reader.word(name, "public_keys.namespaces", NAME) for name in namespaces),
        public_keys=reader.word(public.get("name"), "public_keys.name", WORD),
        former_key=Path(reader.word(root.get("former_key"), "former_key", files.PATH)),
    )


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Wire the API server to the service and say where the key came from."""
    settings = files.start_with_settings(process, read_configuration, environment)
    api = ApiServer.from_environment(environment)
    objects = KubernetesGateKey(api, settings.namespace, settings.secret, settings.public_keys, settings.namespaces)
    provided = provide_key(objects, read_key_pair(settings.former_key), new_key_pair)
    process.log("key is in its place", origin=provided.origin, trusted=provided.trusted)


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("gate-key", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
