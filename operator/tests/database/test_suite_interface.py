"""The interface suite on the detector's process and a real database: what a recording writes is its output."""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from database_server import DatabaseServer
from local_room import LocalRoom, deployment

from robotkube.adapters.templates_jinja2 import Jinja2Templates
from robotkube.domain.evidence import Artefact, Check
from robotkube.ports.suites import Subject
from robotkube.services.suite_interface import InterfaceSuite
from robotkube.services.suite_observing import Bounds

TOP = Path(__file__).resolve().parents[3]
WHOLE, SHORT = Bounds(), Bounds(settle=3.0, answer=4.0, watch=4.0)
CHART = TOP / "charts" / "apps" / "event-detector"


@pytest.fixture
def room(server: DatabaseServer, tmp_path: Path) -> Iterator[LocalRoom]:
    made = LocalRoom(tmp_path / "room", server)
    yield made
    made.close()


def objects(values: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    settings = {"name": f"room/{name}", **values["detector"]}
    command = ["python3", "-m", "robotkube.entrypoints.detector"]
    return deployment(name, command, {"config.yaml": yaml.safe_dump(settings)}, "database-account")


def checks_of(entry: Mapping[str, Any], room: LocalRoom, bounds: Bounds = WHOLE) -> list[Check]:
    artefact = Artefact("event-detector", "0.2.0", "sha256:" + "0" * 64, "linux/amd64")
    files = {"values.yaml": (CHART / "values.yaml").read_bytes()}
    subject = Subject(artefact, entry, files, b"", {"ros": "ros@sha256:0"}, objects)
    render = Jinja2Templates().render
    suite = InterfaceSuite("observer", render, time.time_ns, lambda: secrets.token_hex(8), bounds)
    return list(suite.run(subject, room))


def entry() -> dict[str, Any]:
    return dict(yaml.safe_load((TOP / "registry/charts/event-detector/0.2.0.yaml").read_text()))


def test_every_watched_topic_is_recorded(room: LocalRoom) -> None:
    checks = checks_of(entry(), room)
    assert [f"{c.name}: {c.found}" for c in checks if not c.passed] == []
    names = {check.name for check in checks}
    assert "set named: ros in /vehicles/suite_a/pointcloud leads to an output" in names
    assert "set patterns: ros in /vehicles/{agent}/pose leads to an output" in names
    assert "set patterns: database out segments_index" in names


def test_a_collection_that_is_not_declared_is_found(room: LocalRoom) -> None:
    """In the second set, too: what the first one wrote is taken away before."""
    other = entry()
    recorded = next(found for found in other["spec"]["interfaces"] if found["name"] == "recorded")
    recorded["forEach"] = {"collection": ["samples", "no_such"]}
    failed = [check.name for check in checks_of(other, room, SHORT) if not check.passed]
    # what goes to segments leads to nothing that is declared: not even to the recording's own document
    lost = {"named": "/vehicles/suite_a/pointcloud", "patterns": "/vehicles/{agent}/pose"}
    assert failed == [
        f"set {name}: {what}"
        for name, topic in lost.items()
        for what in (
            "database out no_such: declared but absent",
            f"ros in {topic} leads to an output",
            "undeclared collection database out audits",
            "undeclared collection database out recordings",
            "undeclared collection database out segments",
            "undeclared collection database out segments_index",
        )
    ]
