"""A mistyped name is answered with the one that was meant."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from robotkube.cli.registry import commands
from robotkube.cli.tasks import submit
from robotkube.errors import InputError, RefusalError, did_you_mean
from robotkube.registry.catalogue.core.search import find
from robotkube.registry.publication.adapters.submission_folders import read_chart, read_sources

ENTRIES = [
    {"kind": "chart", "name": "event-detector", "version": "0.2.1", "channel": "stable", "state": "verified"},
    {"kind": "chart", "name": "event-detector", "version": "0.2.2", "channel": "stable", "state": "verified"},
    {"kind": "chart", "name": "mqtt-bridge", "version": "0.2.2", "channel": "stable", "state": "verified"},
    {"kind": "application", "name": "pose-telemetry"},
]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("event-detecter", "did you mean event-detector? "),
        ("evnt-detector", "did you mean event-detector? "),
        ("vehicle-0", "did you mean vehicle-00 or vehicle-01? "),
        ("lidar", ""),
        ("", ""),
    ],
)
def test_what_is_like_the_name_was_meant(name: str, words: str) -> None:
    assert did_you_mean(name, ["event-detector", "mqtt-bridge", "vehicle-00", "vehicle-01"]) == words


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ("mqtt-brigde", "has no 'mqtt-brigde'; did you mean mqtt-bridge? there are event-detector, mqtt-bridge, pose"),
        ("event-detector@9", "has no 'event-detector@9'; versions of event-detector: 0.2.1, 0.2.2"),
        (
            "pose-telemetry@1.0.0",
            "has no 'pose-telemetry@1.0.0'; pose-telemetry is an application, and those have no versions: write "
            "pose-telemetry",
        ),
    ],
)
def test_an_entry_that_is_not_there(wanted: str, words: str) -> None:
    with pytest.raises(RefusalError) as refused:
        find(ENTRIES, wanted)
    assert words in str(refused.value)


def test_a_chart_of_the_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "_entries", lambda options: ENTRIES)
    with pytest.raises(RefusalError, match="no chart mqtt-bridg; did you mean mqtt-bridge\\? there are event-detector"):
        commands.show_graph(argparse.Namespace(charts=["mqtt-bridg"], dot=False))


def test_a_chart_and_an_application_of_the_sources(tmp_path: Path) -> None:
    charts, registry = tmp_path / "charts", tmp_path / "registry"
    (charts / "relay").mkdir(parents=True)
    (charts / "relay" / "Chart.yaml").write_text("name: relay\nversion: 0.1.0\n")
    (registry / "applications").mkdir(parents=True)
    (registry / "applications" / "text-relay.yaml").write_text("")
    with pytest.raises(InputError, match=r"relai/Chart.yaml: missing; did you mean relay\? Name a chart of the folder"):
        read_chart("relai", charts, registry, {})
    with pytest.raises(InputError, match=r"text-rely.yaml: missing; did you mean text-relay\? Name an application"):
        read_sources((), ("text-rely",), charts, registry, {})


class Refusing:
    """Agents that are declared, and an API server that knows no other namespace."""

    def agents(self) -> list[str]:
        return ["cloud-0", "vehicle-00"]

    def create(self, document: object) -> bool:
        raise InputError("there is no namespace clod-0, or the platform is not installed")


@pytest.mark.parametrize(("namespace", "end"), [("clod-0", "; did you mean cloud-0?"), ("lidar", ""), ("cloud-0", "")])
def test_an_agent_in_whose_name_a_task_is_submitted(namespace: str, end: str) -> None:
    with pytest.raises(InputError) as refused:
        submit._create(Refusing(), Refusing(), {"metadata": {"namespace": namespace}})  # type: ignore[arg-type]
    assert str(refused.value) == f"there is no namespace clod-0, or the platform is not installed{end}"
