"""Settings of the bootstrap Job: which Deployments read the hooks' secrets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.errors import DocumentError
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.setup.bootstrap import read_configuration


def settings_file(folder: Path, **argocd: Any) -> Path:
    for name, text in {"username": "manager", "password": "any", "secret": "any"}.items():
        (folder / name).write_text(text)
    account = {"name": "manager", "credentials": str(folder)}
    wiring = {"namespace": "argocd", "account": account, "rbac": "p, role:x\n", "closed_project": "default", **argocd}
    wiring["hook"] = {"secret": str(folder / "secret")}
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump({"log_level": "info", "wait_seconds": 1, "argocd": wiring}))
    return path


@pytest.mark.parametrize(
    ("written", "readers"),
    [
        ({"hook_readers": ["argocd-server", "other"]}, ("argocd-server", "other")),
        ({"hook_reader": "argocd-applicationset-controller"}, ("argocd-applicationset-controller",)),
    ],
)
def test_deployments_are_listed_or_one_is_named_as_formerly(
    tmp_path: Path, written: dict[str, Any], readers: tuple[str, ...]
) -> None:
    settings = read_settings(settings_file(tmp_path, **written), read_configuration)
    assert settings.argocd.hook_readers == readers


@pytest.mark.parametrize("written", [{}, {"hook_readers": "argocd-server"}, {"hook_readers": [1]}])
def test_what_is_no_list_of_names_is_refused(tmp_path: Path, written: dict[str, Any]) -> None:
    with pytest.raises(DocumentError, match=r"argocd\.hook_readers"):
        read_settings(settings_file(tmp_path, **written), read_configuration)
