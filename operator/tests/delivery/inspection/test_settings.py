"""The inspector's settings, in the form in which the chart writes them, and what is made of them without a network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.inspection.__main__ import build_source
from robotkube.delivery.inspection.settings import InspectorConfiguration, read_configuration
from robotkube.errors import DocumentError
from robotkube.foundation.forge.connect import ForgeAddress
from robotkube.foundation.runtime.settings_file import Credentials, read_settings
from tests.stages.forge.catalogue_evidence import key_folder

DIGEST = "sha256:" + "1" * 64
BY_DIGEST = f"forge.example/robotkube/platform@{DIGEST}"
BY_TAG = "docker.io/library/mongo:8"


def document(folder: Path, **changes: Any) -> dict[str, Any]:
    for name in ("username", "password"):
        (folder / name).write_text(name)
    forge = {"url": "http://forge.example:3000", "credentials": str(folder), "branch": "main"}
    namespaces = {"agents": ["vehicle-00"], "tests": ["robotkube-suite-0"], "platform": "robotkube"}
    return {
        "listen": {"address": "0.0.0.0", "port": 8081},  # noqa: S104
        "log_level": "info",
        "forge": {**forge, "deployment": "robotkube/deployment", "catalogue": "robotkube/catalogue"},
        "oci_registry": {"charts": "oci://forge.example:3000/verified"},
        "evidence": {"keys": str(key_folder())},
        "namespaces": {**namespaces, "gate": "robotkube-gate", "argocd": "argocd", "others": False},
        "images": [BY_DIGEST, BY_TAG],
        "kubelets": {"verify": True},
        **changes,
    }


def read(folder: Path, **changes: Any) -> InspectorConfiguration:
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(document(folder, **changes)))
    return read_settings(path, read_configuration)


def test_forge_namespaces_and_images_are_read(tmp_path: Path) -> None:
    settings = read(tmp_path)
    assert settings.forge.address == ForgeAddress("http://forge.example:3000")
    assert settings.forge.account == Credentials("username", "password")
    assert (settings.forge.deployment, settings.forge.catalogue) == ("robotkube/deployment", "robotkube/catalogue")
    assert settings.installation.domain.of_the_platform == ("robotkube", "robotkube-gate")
    assert (settings.installation.digests, settings.installation.references) == ((DIGEST,), {BY_TAG})
    assert settings.verify


def test_before_main_was_read_nothing_is_claimed(tmp_path: Path) -> None:
    """Nothing is asked of the forge to build it, and what may run is not known yet."""
    assert build_source(read(tmp_path), tmp_path / "work", object()).permitted() is None


def test_every_problem_is_named_at_once(tmp_path: Path) -> None:
    forge = {"url": "nowhere", "credentials": str(tmp_path), "catalogue": "robotkube/catalogue", "branch": "main"}
    with pytest.raises(DocumentError) as refusal:
        read(tmp_path, forge=forge, kubelets={"verify": "perhaps"})
    problems = str(refusal.value)
    assert all(one in problems for one in ("forge.deployment: missing", "forge.url: ", "kubelets.verify"))
