"""The gate as a process on the tests' forge: its settings file, its log and whether it answers."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import httpx
import yaml

from tests.stages import http_calls
from tests.stages.forge.catalogue_evidence import SEED, key_folder
from tests.stages.forge.installation import (
    CHARTS_URL,
    HOOK_SECRET,
    WEBHOOK_SECRET,
    Installation,
    manager_secret,
)
from tests.stages.registry.signed_evidence import signing_key

PROCESS_SECONDS_MAX = 60


def secret_file(folder: Path, name: str, text: str) -> str:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return str(path)


def account_folder(folder: Path, name: str, username: str, password: str) -> str:
    secret_file(folder, f"{name}/username", username)
    secret_file(folder, f"{name}/password", password)
    return str(folder / name)


def write_settings(folder: Path, document: dict[str, Any]) -> dict[str, str]:
    """The environment of a process with these settings."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(document))
    return {**os.environ, "ROBOTKUBE_CONFIG": str(folder / "config.yaml"), "ROBOTKUBE_WORK": str(folder / "work")}


def lines(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


def key_file(folder: Path) -> str:
    """The gate's private key."""
    signing_key(folder / "key", SEED)
    return str(folder / "key" / "key.pem")


def gate_settings(installation: Installation, folder: Path, hook_url: str) -> dict[str, Any]:
    return {
        "listen": {"address": "127.0.0.1", "port": installation.gate_port},
        "log_level": "info",
        "forge": {
            "url": installation.url,
            "credentials": account_folder(folder, "forge", "gate", installation.passwords["gate"]),
            "deployment": "robotkube/deployment",
            "catalogue": "robotkube/catalogue",
            "branch": "main",
            "proposers": [
                {
                    "account": "manager",
                    "namespaces": ["cloud-0"],
                    "secret": secret_file(folder, "proposers/manager/secret", manager_secret()),
                }
            ],
            "publishers": ["publisher"],
        },
        "oci_registry": {"charts": CHARTS_URL, "staging": CHARTS_URL.replace("verified", "staging")},
        "local_builds": False,
        "evidence": {
            "key": key_file(folder),
            "keys": str(key_folder()),
            "verifier": "gate-of-tests",
        },
        "hook": {"url": hook_url, "secret": secret_file(folder, "hook/secret", HOOK_SECRET)},
        "webhook": {"secret": secret_file(folder, "webhook/secret", WEBHOOK_SECRET)},
    }


def answers(url: str) -> int:
    try:
        return http_calls.get(url, timeout=2).status_code
    except httpx.HTTPError:
        return 0
