"""The interface suite on the detector's process and a real database: what a recording writes is its output."""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.foundation.certificates.adapters.issuing import throw_away
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.evidence.core.statements import Artefact, Check
from robotkube.registry.suites.loops.installation import filled_sets, install
from robotkube.registry.suites.loops.installed.changing import SettingsChange
from robotkube.registry.suites.loops.interface import InterfaceSuite
from robotkube.registry.suites.loops.interface_observer import ObserverTimeouts
from robotkube.registry.suites.ports.suites import Subject
from tests.stages.paths import REPOSITORY
from tests.stages.recording.database_server import NAME, DatabaseServer
from tests.stages.registry.local_namespace import LocalTestNamespace, deployment

pytestmark = pytest.mark.toolchain

WHOLE, SHORT = ObserverTimeouts(), ObserverTimeouts(settle=3.0, answer=4.0, watch=4.0)
CHART = REPOSITORY / "charts" / "apps" / "event-detector"


@pytest.fixture
def namespace(tmp_path: Path) -> Iterator[LocalTestNamespace]:
    """With a database that speaks TLS, as where the platform does."""
    server = DatabaseServer(tmp_path / "database", issued=throw_away(NAME))
    server.start()
    made = LocalTestNamespace(tmp_path / "suite", server)
    yield made
    made.close()
    server.close()


def objects(values: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    settings = {"name": f"suite/{name}", **values["detector"]}
    command = ["robotkube-event-detector"]
    return deployment(name, command, {"config.yaml": yaml.safe_dump(settings)}, "database-account")


def subject_of(entry: Mapping[str, Any]) -> Subject:
    artefact = Artefact("event-detector", "0.2.3", "sha256:" + "0" * 64, "linux/amd64")
    files = {"values.yaml": (CHART / "values.yaml").read_bytes()}
    return Subject(artefact, entry, files, b"", {"ros": "ros@sha256:0"}, objects)


def checks_of(entry: Mapping[str, Any], namespace: LocalTestNamespace, bounds: ObserverTimeouts = WHOLE) -> list[Check]:
    render = Jinja2Templates().render
    suite = InterfaceSuite("observer", render, time.time_ns, lambda: secrets.token_hex(8), bounds)
    return list(suite.run(subject_of(entry), namespace))


def entry() -> dict[str, Any]:
    return dict(yaml.safe_load((REPOSITORY / "registry/charts/event-detector/0.2.3.yaml").read_text()))


def test_every_watched_topic_is_recorded(namespace: LocalTestNamespace) -> None:
    checks = checks_of(entry(), namespace)
    assert [f"{c.name}: {c.found}" for c in checks if not c.passed] == []
    names = {check.name for check in checks}
    assert "set named: ros in /vehicles/suite_a/pointcloud leads to an output" in names
    assert "set patterns: ros in /vehicles/{agent}/pose leads to an output" in names
    assert "set patterns: database out segments_index" in names


@pytest.mark.thorough
def test_changed_settings_are_seen_at_work(namespace: LocalTestNamespace) -> None:
    """From named topics to patterns: the topic that fits none of them is closed."""
    tested = subject_of(entry())
    render = Jinja2Templates().render
    sets = filled_sets(tested.entry, namespace.agent, time.time_ns(), render)
    installed = install(tested, namespace, sets[0])
    change = SettingsChange("observer", render, lambda: secrets.token_hex(8))
    [check], _ = change.checks(tested, namespace, installed, sets)
    assert check.passed, check.found


@pytest.mark.thorough
def test_a_collection_that_is_not_declared_is_found(namespace: LocalTestNamespace) -> None:
    other = entry()
    del other["spec"]["suites"]["sets"][1:]
    recorded = next(interface for interface in other["spec"]["interfaces"] if interface["name"] == "recorded")
    recorded["forEach"] = {"collection": ["samples", "no_such"]}
    failed = [check.name for check in checks_of(other, namespace, SHORT) if not check.passed]
    # what goes to segments leads to nothing that is declared: not even to the recording's own document
    assert failed == [
        "set named: database out no_such: declared but absent",
        "set named: ros in /vehicles/suite_a/pointcloud leads to an output",
        "set named: undeclared collection database out audits",
        "set named: undeclared collection database out manifests",
        "set named: undeclared collection database out recordings",
        "set named: undeclared collection database out segments",
        "set named: undeclared collection database out segments_index",
    ]
