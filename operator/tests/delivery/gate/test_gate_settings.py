"""The gate's settings file: its new keys, and the former ones that it still accepts."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.gate.__main__ import NEW_KEYS, GateConfiguration, read_configuration
from robotkube.errors import DocumentError
from robotkube.foundation.runtime.settings_file import read_settings, warn_of_former_keys

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


def configuration(folder: Path, **keys: Any) -> GateConfiguration:
    return read_settings(settings_file(folder, **keys), read_configuration)


def test_the_former_key_of_the_oci_registry_is_accepted_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    now = configuration(tmp_path, oci_registry=OCI_REGISTRY)
    formerly = configuration(tmp_path, registry=OCI_REGISTRY)
    assert now.publication.charts_url == "oci://forge:3000/verified"
    assert replace(formerly, former_keys=()) == now
    with caplog.at_level(logging.WARNING):
        warn_of_former_keys(tmp_path / "config.yaml", now.former_keys, NEW_KEYS)
        assert caplog.messages == []
        warn_of_former_keys(tmp_path / "config.yaml", formerly.former_keys, NEW_KEYS)
    assert caplog.messages == [
        f"settings have a former key file={tmp_path / 'config.yaml'} key=registry new_key=oci_registry"
    ]


def test_both_keys_of_the_oci_registry_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DocumentError) as refused:
        configuration(tmp_path, oci_registry=OCI_REGISTRY, registry=dict(OCI_REGISTRY))
    assert refused.value.problems == (
        "registry: is the former name of oci_registry, which is there as well; remove registry",
    )


def test_a_registry_that_is_missing_is_named_by_its_new_key(tmp_path: Path) -> None:
    with pytest.raises(DocumentError) as refused:
        configuration(tmp_path)
    assert "oci_registry: missing" in refused.value.problems
