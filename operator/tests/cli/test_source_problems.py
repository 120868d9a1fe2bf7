"""`robotkube registry validate` composes what it validates: an application that no task could ever have is a mistake,
in the words of the gate's trial."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli.main import main
from robotkube.cli.registry.source_problems import check_sources, source_problems
from robotkube.delivery.gate.core.source_compositions import SourceCompositions, compose_sources
from robotkube.errors import InputError
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.catalogue.adapters.source_folders import read_sources
from robotkube.registry.publication.adapters.submission_folders import validation_tools
from tests.stages.paths import REPOSITORY

Written = Callable[..., Path]
CHARTS = ("mqtt-bridge", "object-detection")
BRIDGE = "mqtt-bridge.yaml"
DETECTION = {"cloud": "/vehicles/a/cloud", "objects": "/vehicles/a/objects", "uncertainty": "/vehicles/a/uncertainty"}


def service(name: str, placement: Mapping[str, Any], **more: Any) -> dict[str, Any]:
    chart = {"name": "object-detection", "version": ">=0.1.0"}
    parts = {"name": name, "release": name, "chart": chart, "placement": dict(placement)}
    return {**parts, "values": {"detection": {key: f"{topic}/{name}" for key, topic in DETECTION.items()}}, **more}


def link(source: Mapping[str, str], target: Mapping[str, str], topic: str) -> dict[str, Any]:
    carried = {"name": topic, "type": "geometry_msgs/msg/PoseArray", "channel": "telemetry", "reliability": "reliable"}
    topics = [{**carried, "durability": "volatile", "depth": 10}]
    return {"kind": "mqtt", "from": dict(source), "to": dict(target), "topics": topics}


@pytest.fixture
def written(tmp_path: Path) -> Written:
    """Writes the application `sample` beside the bridge's, with the charts of both; the registry's folder."""
    registry = tmp_path / "registry"
    (tmp_path / "charts" / "apps").mkdir(parents=True)
    for name in CHARTS:
        shutil.copytree(REPOSITORY / "registry" / "charts" / name, registry / "charts" / name)
        (tmp_path / "charts" / "apps" / name).symlink_to(REPOSITORY / "charts" / "apps" / name)
    shutil.copytree(REPOSITORY / "registry" / "policies", registry / "policies")
    (registry / "applications").mkdir()
    shutil.copy(REPOSITORY / "registry" / "applications" / BRIDGE, registry / "applications")

    def write(*services: Mapping[str, Any], links: tuple[Any, ...] = (), **properties: Any) -> Path:
        parameters = {"type": "object", "additionalProperties": False, "properties": properties}
        head = {"apiVersion": "registry.robotkube.io/v1alpha1", "kind": "Application", "metadata": {"name": "sample"}}
        spec = {"description": "d", "provides": ["sample/x"], "parameters": parameters, "services": list(services)}
        text = write_mapping({**head, "spec": {**spec, "links": list(links)}})
        (registry / "applications" / "sample.yaml").write_text(text)
        return registry

    return write


def problems(registry: Path) -> list[str]:
    gathered = source_problems(read_sources(registry, registry.parent / "charts" / "apps"))
    return [str(problem).removeprefix(f"{registry}/") for problem in gathered]


ROS = {"kind": "ros", "from": {"service": "one"}, "to": {"service": "two"}}
HERE, THERE = {"agent": "vehicle-00"}, {"agent": "cloud-00"}


@pytest.mark.parametrize(
    ("services", "links", "words"),
    [
        (
            [service("one", {"role": "vehicle"}), service("two", {"role": "cloud"})],
            (ROS,),
            "no sample could be composed: NoCapableNode: services one, two of application sample: services with ros "
            "links must share a node: one wants role vehicle, two wants role cloud; give the parameters `examples` "
            "that name agents, or widen the placements",
        ),
        (
            [service("one", HERE), service("two", HERE, release="one")],
            (),
            "two services of sample make the release vehicle-00/one",
        ),
        (
            [service("one", HERE), {**service("two", HERE), "values": service("one", HERE)["values"]}],
            (),
            "topic /vehicles/a/objects/one on vehicle-00 has two publishers in application sample, release "
            "vehicle-00/one and release vehicle-00/two",
        ),
        (
            [],
            (link(THERE, HERE, "/vehicles/vehicle_00/objects"),),
            "topic /vehicles/vehicle_00/objects cannot go from cloud-00",
        ),
    ],
    ids=["no place fits", "one release twice", "one topic twice", "a link that the broker refuses"],
)
def test_what_can_never_be_composed_is_a_mistake(
    written: Written, services: list[Any], links: tuple[Any, ...], words: str
) -> None:
    (problem,) = problems(written(*services, links=links))
    assert problem.startswith("applications/sample.yaml: spec: with parameters {}: ")
    assert words in problem


def test_a_sample_for_which_the_fleet_has_no_place_is_none(written: Written) -> None:
    """Agents that a parameter names are there; one place that fits is enough."""
    where = {"where": {"type": "string", "enum": ["vehicle-00", "cloud-00"]}}
    one = service("one", {"agent": "{{ parameters.where | default('cloud-00') }}"})
    assert problems(written(one, **where)) == []


def test_of_what_validation_names_already_nothing_more_is_said(written: Written) -> None:
    twice = [service("one", HERE), service("two", HERE, release="one")]
    (problem,) = problems(written(service("zero", HERE, chart={"name": "gone", "version": ">=0.1.0"}), *twice))
    assert "there is no chart 'gone'" in problem
    registry = written(*twice)
    (registry / "charts" / "object-detection" / "0.1.2.yaml").write_text("a: b\n")
    assert not any("make the release" in problem for problem in problems(registry))


def test_a_bridge_that_cannot_be_read_says_nothing_of_what_it_would_carry(written: Written) -> None:
    registry = written(links=(link(HERE, THERE, "/vehicles/vehicle_00/objects"),))
    assert problems(registry) == []
    (registry / "applications" / BRIDGE).write_text("a: b\n")
    assert {problem.partition(": ")[0] for problem in problems(registry)} == {f"applications/{BRIDGE}"}


def test_the_time_is_bounded(written: Written) -> None:
    sources = read_sources(written(service("one", HERE)))
    composed = compose_sources(sources, (), validation_tools(), lambda: True)
    assert composed == SourceCompositions((), ("mqtt-bridge", "sample"))


def test_the_commands_say_it(written: Written, capsys: pytest.CaptureFixture[str]) -> None:
    registry = written(service("one", HERE), service("two", HERE, release="one"))
    assert main(["registry", "validate", "--registry", str(registry), "-o", "json"]) == 1
    (row,) = json.loads(capsys.readouterr().out)["mistakes"]
    assert (row["file"], row["key"]) == (f"{registry}/applications/sample.yaml", "spec")
    with pytest.raises(InputError, match=r"1 mistake in the sources, nothing was submitted:\n.* make the release"):
        check_sources([], ["sample"], registry.parent / "charts" / "apps", registry, "submitted")
    assert main(["registry", "try", str(registry / "applications" / "sample.yaml")]) == 2
    assert "nothing was tried" in capsys.readouterr().err
