"""The key `forge` of settings, which several processes read alike."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.forge.connect import ForgeAddress, ForgeSettings, read_forge
from robotkube.foundation.runtime.settings_file import Credentials

URL = "http://forge.example:3000"


@pytest.fixture
def forge(tmp_path: Path) -> dict[str, Any]:
    (tmp_path / "username").write_text("manager")
    (tmp_path / "password").write_text("word")
    return {"url": URL, "credentials": str(tmp_path), "branch": "main", "catalogue": "robotkube/catalogue"}


def test_an_account_and_one_repository(forge: dict[str, Any]) -> None:
    reader = Reader("settings")
    access = read_forge(reader, forge, deployment=False)
    assert reader.problems == []
    assert access == ForgeSettings(ForgeAddress(URL), Credentials("manager", "word"), "main", "robotkube/catalogue")


def test_two_repositories_of_a_forge_of_ones_own(forge: dict[str, Any], tmp_path: Path) -> None:
    reader = Reader("settings")
    more = {"kind": "gitlab", "api": "https://forge.example/api", "deployment": "robotkube/deployment", "publishers": 1}
    access = read_forge(reader, {**forge, **more}, more=["publishers"])
    assert reader.problems == []
    assert access.address == ForgeAddress(URL, "gitlab", "https://forge.example/api")
    assert (access.catalogue, access.deployment) == ("robotkube/catalogue", "robotkube/deployment")
    assert access.clone(access.deployment, tmp_path / "clone") is not None


def test_every_problem_is_named_at_once(tmp_path: Path) -> None:
    reader = Reader("settings")
    read_forge(reader, {"url": "forge", "credentials": str(tmp_path), "catalogue": "x y", "publishers": []})
    text = "\n".join(reader.problems)
    for problem in (
        "forge.branch: missing",
        "forge.deployment: missing",
        "forge.publishers: unknown key; remove it",
        "forge.url: 'forge' must match",
        "forge.catalogue: 'x y' must match",
        "forge.credentials: ",
    ):
        assert problem in text


def test_what_is_no_mapping_is_a_problem() -> None:
    reader = Reader("settings")
    assert read_forge(reader, "robotkube").catalogue == ""
    assert "forge: must be a mapping" in "\n".join(reader.problems)
