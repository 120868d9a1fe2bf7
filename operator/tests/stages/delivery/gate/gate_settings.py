"""The settings file of a gate, with its secrets, for tests without a forge."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

OCI_REGISTRY = {"charts": "oci://forge:3000/verified", "staging": "oci://forge:3000/staging"}


def secret_file(folder: Path, name: str) -> str:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"the secret {name}")
    return str(path)


def settings_file(folder: Path, **keys: Any) -> Path:
    """A complete settings file but for the address of the OCI registry, which `keys` add."""
    secret_file(folder, "forge/username")
    secret_file(folder, "forge/password")
    (folder / "forge" / "username").write_text("gate")
    proposer = {"account": "manager", "namespaces": ["cloud-0"], "secret": secret_file(folder, "proposer")}
    document = {
        "listen": {"address": "127.0.0.1", "port": 8080},
        "log_level": "info",
        "forge": {
            "url": "http://forge:3000",
            "credentials": str(folder / "forge"),
            "deployment": "robotkube/deployment",
            "catalogue": "robotkube/catalogue",
            "branch": "main",
            "proposers": [proposer],
            "publishers": ["publisher"],
        },
        "local_builds": False,
        "evidence": {"key": str(folder / "key.pem"), "keys": str(folder / "keys"), "verifier": "gate"},
        "hook": {"url": "http://controller:7000/api/webhook", "secret": secret_file(folder, "hook")},
        "webhook": {"secret": secret_file(folder, "webhook")},
        **keys,
    }
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(document))
    return path
