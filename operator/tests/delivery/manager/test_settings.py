"""The manager's settings file: keys of today, and former ones that are still taken."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.manager.__main__ import FORMER_KEYS, read_configuration, renderer_of
from robotkube.errors import DocumentError
from robotkube.foundation.runtime.settings_file import read_settings, warn_of_former_keys
from tests.stages.delivery.manager.manager_process import Outside, write_settings

FORGE, CHARTS = "http://forge.example:3000", "oci://forge.example:3000/verified"
OUTSIDE = Outside(FORGE, "password", "webhook secret", Path("/etc/robotkube/keys"), CHARTS, "http://nowhere.example")


def settings(folder: Path, **changes: Any) -> Path:
    """A settings file of the manager."""
    return write_settings(OUTSIDE, folder, 8080, "robotkube-manager", **changes)


def test_a_former_key_is_taken_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = settings(tmp_path)
    today = read_settings(path, read_configuration, FORMER_KEYS)
    warn_of_former_keys(path, FORMER_KEYS)
    assert caplog.messages == []
    document = yaml.safe_load(path.read_text())
    document["registry"] = document.pop("oci_registry")
    path.write_text(yaml.safe_dump(document))
    former = read_settings(path, read_configuration, FORMER_KEYS)
    assert former.manager.charts_url == OUTSIDE.charts_url
    assert former == today
    warn_of_former_keys(path, FORMER_KEYS)
    assert caplog.messages == [f"settings have a former key file={path} key=registry new_key=oci_registry"]


def test_a_key_under_both_names_is_refused(tmp_path: Path) -> None:
    path = settings(tmp_path, registry={"charts": OUTSIDE.charts_url})
    with pytest.raises(DocumentError, match="registry: is the former name of oci_registry, which is there as well"):
        read_settings(path, read_configuration, FORMER_KEYS)


def test_without_the_program_that_renders_images_are_left_to_the_gate(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    missing = str(tmp_path / "chart-renderer")
    assert renderer_of({"ROBOTKUBE_RENDERER": missing}) is None
    assert f"images are looked up by the gate alone, there is no program {missing}" in caplog.text
    Path(missing).touch()
    renderer = renderer_of({"ROBOTKUBE_RENDERER": missing})
    assert renderer is not None
    renderer.close()


LISTEN = {"address": "127.0.0.1", "port": 8080}
ENCRYPTED = {**LISTEN, "certificate": "/var/run/secrets/robotkube/certificate"}
AUTHORITIES = "/etc/robotkube/authorities/ca.crt"
NAME = "manager.robotkube.svc.cluster.local"


def by_https(folder: Path, listen: dict[str, Any], **lease: str) -> Path:
    path = settings(folder, listen=listen, authorities=AUTHORITIES)
    document = yaml.safe_load(path.read_text())
    document["lease"] |= lease
    path.write_text(yaml.safe_dump(document))
    return path


def test_by_https_the_processes_of_a_manager_have_a_name_for_each_other(tmp_path: Path) -> None:
    read = read_settings(by_https(tmp_path, ENCRYPTED, server_name=NAME), read_configuration)
    assert (read.server_name, read.listen.certificate) == (NAME, Path(ENCRYPTED["certificate"]))
    assert read.authorities == Path(AUTHORITIES)


@pytest.mark.parametrize(("listen", "lease"), [(LISTEN, {"server_name": NAME}), (ENCRYPTED, {})])
def test_one_without_the_other_is_refused(tmp_path: Path, listen: dict[str, Any], lease: dict[str, str]) -> None:
    problem = r"lease\.server_name: goes with listen\.certificate: .* give both or neither"
    with pytest.raises(DocumentError, match=problem):
        read_settings(by_https(tmp_path, listen, **lease), read_configuration)
