"""The gate's settings file: its new keys, and the former ones that it still accepts."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.gate.__main__ import FORMER_KEYS, GateConfiguration, read_configuration
from robotkube.errors import DocumentError
from robotkube.foundation.runtime.settings_file import Listen, read_settings, warn_of_former_keys
from tests.stages.delivery.gate.gate_settings import OCI_REGISTRY, settings_file


def configuration(folder: Path, **keys: Any) -> GateConfiguration:
    return read_settings(settings_file(folder, **keys), read_configuration, FORMER_KEYS)


def test_the_former_key_of_the_oci_registry_is_accepted_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "config.yaml"
    now = configuration(tmp_path, oci_registry=OCI_REGISTRY)
    assert now.publication.charts_url == "oci://forge:3000/verified"
    with caplog.at_level(logging.WARNING):
        warn_of_former_keys(path, FORMER_KEYS)
        assert caplog.messages == []
        assert configuration(tmp_path, registry=OCI_REGISTRY) == now
        warn_of_former_keys(path, FORMER_KEYS)
    assert caplog.messages == [f"settings have a former key file={path} key=registry new_key=oci_registry"]


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


def test_a_problem_names_the_key_that_stands_in_the_file(tmp_path: Path) -> None:
    with pytest.raises(DocumentError) as refused:
        configuration(tmp_path, registry={"charts": "forge:3000/verified"})
    problems = refused.value.problems
    assert "registry.staging: missing (registry is the former name of oci_registry)" in problems
    assert any(problem.startswith("registry.charts: 'forge:3000/verified' must match") for problem in problems)
    assert not any(problem.startswith("oci_registry") for problem in problems)


def test_a_former_key_that_is_empty_is_one_all_the_same(tmp_path: Path) -> None:
    with pytest.raises(DocumentError) as refused:
        configuration(tmp_path, oci_registry=OCI_REGISTRY, registry=None)
    assert refused.value.problems == (
        "registry: is the former name of oci_registry, which is there as well; remove registry",
    )


def test_today_s_key_without_a_value_beside_the_former_one_is_refused_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(DocumentError) as refused:
        configuration(tmp_path, oci_registry=None, registry=OCI_REGISTRY)
    assert refused.value.problems == (
        "registry: is the former name of oci_registry, which is there as well, without a value; "
        "give it what registry has and remove registry",
    )


def test_a_port_for_health_may_be_named(tmp_path: Path) -> None:
    listen = {"address": "127.0.0.1", "port": 8080}
    assert configuration(tmp_path, oci_registry=OCI_REGISTRY).listen == Listen("127.0.0.1", 8080, None)
    named = configuration(tmp_path, oci_registry=OCI_REGISTRY, listen={**listen, "health_port": 8081})
    assert named.listen == Listen("127.0.0.1", 8080, 8081)


@pytest.mark.parametrize(
    ("port", "problem"),
    [
        (8080, "listen.health_port: is the same as listen.port; give it a port of its own"),
        ("health", "listen.health_port: must be a whole number from 0 to 65535"),
        (70_000, "listen.health_port: must be a whole number from 0 to 65535"),
        (True, "listen.health_port: must be a whole number from 0 to 65535"),
    ],
)
def test_a_wrong_port_for_health_is_refused(tmp_path: Path, port: Any, problem: str) -> None:
    listen = {"address": "127.0.0.1", "port": 8080, "health_port": port}
    with pytest.raises(DocumentError) as refused:
        configuration(tmp_path, oci_registry=OCI_REGISTRY, listen=listen)
    assert refused.value.problems == (problem,)


def test_the_gate_serves_and_asks_by_https(tmp_path: Path) -> None:
    listen = {"address": "127.0.0.1", "port": 8080, "certificate": "/var/run/secrets/robotkube/certificate"}
    authorities = "/etc/robotkube/authorities/ca.crt"
    read = configuration(tmp_path, oci_registry=OCI_REGISTRY, listen=listen, authorities=authorities)
    assert (read.listen.certificate, read.authorities) == (Path(listen["certificate"]), Path(authorities))
    assert configuration(tmp_path, oci_registry=OCI_REGISTRY).authorities is None
