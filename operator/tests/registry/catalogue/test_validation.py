"""`registry validate`: the project's registry has no mistake, and every mistake is named with file, key and fix."""

from __future__ import annotations

import shutil
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import check_schema, validate, violations
from robotkube.registry.catalogue.adapters.skeletons import new_application
from robotkube.registry.catalogue.adapters.source_folders import read_sources
from robotkube.registry.catalogue.core.guarantees import UNITS
from robotkube.registry.catalogue.core.sources import SourceProblem, Tools
from robotkube.registry.catalogue.core.validation import Tried, validate_sources
from tests.stages.paths import REPOSITORY
from tests.stages.registry.link_mistakes import LINKS, PERCEPTION
from tests.stages.registry.registry_mistakes import (
    BRIDGE,
    CHARTS,
    FILES,
    GONE,
    REACTION,
    RECORDING,
    REFERENCES,
    RELEASE,
    TEMPLATES,
    Mistake,
    both,
    put,
    write,
)

FEW = ("mqtt-bridge", "environment-perception", "proximity-operator", "pose-point-cloud-recording", "bag-player")
APPLICATIONS = "registry/applications/"
SECONDS_MAX = 10.0  # of the processor for 500 versions; it takes 2


def tools() -> Tools:
    templates = Jinja2Templates()
    return Tools(templates.render, templates.references, check_schema, validate, violations)


TOOLS = tools()


def findings(folder: Path, charts: bool = False) -> list[SourceProblem]:
    sources = read_sources(folder / "registry", folder / "charts" if charts else None)
    return validate_sources(sources, TOOLS)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the project's registry and charts, of the bridge without what its version replaces: a catalogue need
    not have the whole history."""
    shutil.copytree(REPOSITORY / "registry", tmp_path / "registry")
    (tmp_path / "registry" / "charts" / "mqtt-bridge" / "0.1.2.yaml").unlink()
    shutil.copytree(REPOSITORY / "charts" / "apps", tmp_path / "charts")
    return tmp_path


@pytest.fixture
def few(folder: Path) -> Path:
    """The copy with those applications alone in which mistakes are made, and what they name."""
    for file in (folder / "registry" / "applications").iterdir():
        if file.stem not in FEW:
            file.unlink()
    return folder


@pytest.mark.parametrize(
    ("place", "charts"),
    [
        ("apps", {"bag-player", "event-detector", "mqtt-bridge", "object-detection", "object-tracking"}),
        ("earlier", {"event-detector", "mqtt-bridge", "object-detection", "object-tracking"}),
    ],
)
def test_the_project_has_no_mistakes(place: str, charts: set[str]) -> None:
    sources = read_sources(REPOSITORY / "registry", REPOSITORY / "charts" / place)
    assert set(sources.folders) == charts
    assert validate_sources(sources, TOOLS) == []


def test_what_registry_new_writes_has_no_mistakes(few: Path) -> None:
    new_application("text-relay", "text/relay", few / "charts", few / "registry")
    assert findings(few, charts=True) == []


@pytest.mark.parametrize("charts", [False, True])
def test_the_copy_has_no_mistakes_before_one_is_made(few: Path, charts: bool) -> None:
    assert findings(few, charts) == []


def test_without_folders_of_charts_templates_are_tried_again_when_their_application_changed(few: Path) -> None:
    file = f"applications/{FEW[1]}.yaml"
    release = "object-detection-{{ parameters.sensor }}"
    other = "recorder-{{ parameters.vehicles | join('-') }}"
    sources = read_sources(few / "registry", None)
    templates = Jinja2Templates()
    rendered = Counter[str]()

    def render(template: Any, names: Any) -> Any:
        rendered[str(template)] += 1
        return templates.render(template, names)

    counting = replace(TOOLS, render=render)
    tried = Tried()
    assert validate_sources(sources, counting, tried) == []
    first = rendered.copy()
    assert first[release] > 0
    assert first[other] > 0
    wrong = sources.files[file].replace(release, "{{ parameters.no }}")
    changed = replace(sources, files={**sources.files, file: wrong})
    named = validate_sources(changed, counting, tried)
    assert named == validate_sources(changed, TOOLS)
    assert any("no" in str(finding) for finding in named)
    assert rendered["{{ parameters.no }}"] > 0
    assert (rendered[release], rendered[other]) == (first[release], first[other]), "the others were tried again"
    assert (validate_sources(changed, counting, tried), validate_sources(sources, counting, tried)) == (named, [])
    assert (rendered[release], rendered[other]) == (first[release], first[other])
    assert validate_sources(read_sources(few / "registry", few / "charts"), counting, tried) == []
    assert rendered[release] > first[release], "charts beside the registry say more of templates"


def alone(folder: Path, wrong: str) -> None:
    """Without applications but the one in the file `wrong`: in others nothing is found, and they take the most time."""
    for file in (folder / APPLICATIONS).iterdir():
        if not file.match(wrong):
            file.unlink()


@pytest.mark.parametrize("mistake", [*FILES, *REFERENCES, *TEMPLATES], ids=lambda m: m.name)
def test_a_mistake_is_named(few: Path, mistake: Mistake) -> None:
    mistake.make(few)
    if mistake.file.startswith(APPLICATIONS):
        alone(few, mistake.file)
    named = findings(few)
    assert any(_names(f, mistake) for f in named), "\n".join(map(str, named))
    assert all(";" in f.text for f in named), "no fix: " + "\n".join(map(str, named))


@pytest.mark.parametrize("mistake", [*CHARTS, *LINKS], ids=lambda m: m.name)
def test_a_difference_from_the_chart_is_named(few: Path, mistake: Mistake) -> None:
    mistake.make(few)
    alone(few, mistake.file)
    named = findings(few, charts=True)
    assert any(_names(f, mistake) for f in named), "\n".join(map(str, named))


def _names(finding: SourceProblem, mistake: Mistake) -> bool:
    return finding.file.endswith(mistake.file) and finding.key == mistake.key and mistake.text in finding.text


def test_all_mistakes_come_at_once(few: Path) -> None:
    put(RECORDING, "spec.services[0].chart.name", "gone")(few)
    put(RECORDING, f"{REACTION}.recording", "{{ nothing }}")(few)
    both(put(BRIDGE, "spec.a", 1), put(BRIDGE, "spec.b", 2), write(RELEASE, b"["))(few)
    named = [str(f) for f in findings(few)]
    for wanted in (
        "chart.name",
        "unknown name 'nothing'",
        "spec.a: unknown",
        "spec.b: unknown",
        "release.yaml: document",
    ):
        assert sum(wanted in text for text in named) == 1, named


DETECTOR = "registry/charts/event-detector/0.2.3.yaml"


def test_a_wrong_key_hides_only_what_depends_on_it(few: Path) -> None:
    """Mistakes of form, of names, of templates, of types and of the chart, in one document at once."""
    both(
        put(RECORDING, "spec.surprise", 1),
        put(RECORDING, "spec.links[0].topics[0].depth", -5),
        put(RECORDING, "spec.links[0].topics[1].type", "sensor_msgs/msg/PointCloud3"),
        put(RECORDING, f"{REACTION}.trace", "{{ tusk.trace }}"),
        put(RECORDING, "spec.services[0].values.detector.typo", 1),
        put(RECORDING, "spec.services[0].chart.requirements", [{"guarantee": "stop-time", "atMost": 0, "unit": "s"}]),
    )(few)
    assert [problem.key for problem in findings(few, charts=True)] == [
        "spec.surprise",
        "spec.links[0].topics[0].depth",
        "spec.services[0].chart.requirements[0]",
        "spec.links[0].topics[1].type",
        f"{REACTION}.trace",
        "spec.services[0].values.detector",
    ]


def test_what_follows_from_a_wrong_key_is_not_said(few: Path) -> None:
    """Neither of a service without a name, nor of parameters that are no schema, nor of a document without a spec."""
    service = "spec.services[0]"
    for changes, keys in (
        ([put(RECORDING, f"{service}.name", GONE)], [f"{service}.name"]),
        ([put(RECORDING, "spec.parameters", {"type": "objekt"})], ["spec.parameters"]),
        ([put(RECORDING, f"{service}.chart.version", 5)], [f"{service}.chart.version"]),
        ([put(RECORDING, f"{service}.chart", {"nmae": "x"})], [f"{service}.chart.nmae", f"{service}.chart"]),
        ([put(RECORDING, "spec.links[0].forEach", {"vehicle": 3})], ["spec.links[0].forEach.vehicle"]),
        ([put(RECORDING, "spec", GONE)], ["spec"]),
    ):
        before = (few / RECORDING).read_text()
        both(*changes)(few)
        assert [problem.key for problem in findings(few, charts=True)] == keys
        (few / RECORDING).write_text(before)


def test_a_template_that_is_none_is_named_whatever_its_names_are(few: Path) -> None:
    put(RECORDING, "spec.parameters.properties.vehicles.type", "liste")(few)
    put(RECORDING, f"{REACTION}.recording", "{{ nothing }}")(few)
    assert [problem.key for problem in findings(few)] == ["spec.parameters", f"{REACTION}.recording"]
    put(RECORDING, "spec.parameters", [])(few)
    put(RECORDING, f"{REACTION}.recording", "{{ a")(few)
    assert [problem.key for problem in findings(few)] == ["spec.parameters", f"{REACTION}.recording"]


def test_a_wrong_key_of_an_entry_hides_neither_its_templates_nor_what_others_ask_of_it(few: Path) -> None:
    both(
        put(DETECTOR, "spec.interfaces[0].name", GONE),
        put(DETECTOR, "spec.interfaces[0].topic", "{{ topik.name }}"),
        put(DETECTOR, "spec.images", ["python"]),
        put(DETECTOR, "spec.replaces", "0.9.9"),
        put(RECORDING, "spec.services[0].values.detector.typo", 1),
        put(RECORDING, "spec.services[0].chart.version", ">=0.9.0"),
    )(few)
    places = [(Path(finding.file).name, finding.key) for finding in findings(few, charts=True)]
    assert places == [
        ("pose-point-cloud-recording.yaml", "spec.services[0].chart.version"),
        ("0.2.3.yaml", "spec.interfaces[0].name"),
        ("0.2.3.yaml", "spec.replaces"),
        ("0.2.3.yaml", "spec.interfaces[0].topic"),
        ("0.2.3.yaml", "spec.images"),
    ]


def test_values_are_compared_with_a_chart_whose_entry_cannot_be_read(few: Path) -> None:
    (few / DETECTOR).write_text("a: [")
    put(RECORDING, "spec.services[0].values.detector.typo", 1)(few)
    places = [(Path(finding.file).name, finding.key) for finding in findings(few, charts=True)]
    assert places == [
        ("pose-point-cloud-recording.yaml", "spec.services[0].values.detector"),
        ("0.2.3.yaml", "document"),
    ]


def test_every_file_of_a_chart_is_read(few: Path) -> None:
    chart = few / "charts" / "event-detector"
    for name, text in (("Chart.yaml", "name: a b\n"), ("values.yaml", "a: ["), ("values.schema.json", "{")):
        (chart / name).write_text(text)
    places = [(Path(finding.file).name, finding.text.partition(": ")[0]) for finding in findings(few, charts=True)]
    assert places == [
        ("Chart.yaml", "name 'a b' is malformed; write the name of the folder"),
        ("Chart.yaml", "version is missing; write one such as 0.1.0"),
        ("values.schema.json", "not readable as JSON"),
        ("values.yaml", "not readable as YAML"),
    ]


def test_a_pattern_is_tried_with_texts_that_fit_it(few: Path) -> None:
    """Where nothing fits, this alone is said, not what the templates say of a parameter that is missing."""
    sensor = "spec.parameters.properties.sensor"
    both(put(PERCEPTION, f"{sensor}.pattern", "^unit-[0-9]{3}$"), put(PERCEPTION, f"{sensor}.examples", GONE))(few)
    assert findings(few) == []
    put(PERCEPTION, f"{sensor}.pattern", "^(?=b)a$")(few)
    assert [problem.key for problem in findings(few)] == [sensor]


def test_a_broken_file_does_not_make_others_dangle(few: Path) -> None:
    (few / BRIDGE).write_text("a: b\n")
    (few / "registry" / "applications" / "mqtt-bridge.yaml").write_text("a: b\n")
    assert {Path(f.file).name for f in findings(few)} == {"0.2.3.yaml", "mqtt-bridge.yaml"}


def test_a_folder_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no folder; name the one"):
        read_sources(tmp_path / "nothing")


def test_five_hundred_versions(folder: Path) -> None:
    text = (folder / BRIDGE).read_text().replace("\n  replaces: 0.2.2\n  skips: [0.1.2]", "")
    for chart in range(50):
        place = folder / "registry" / "charts" / f"chart-{chart:02d}"
        place.mkdir()
        for number in range(10):
            before = f"\n  replaces: 0.{number - 1}.0" if number else ""
            named = text.replace("name: mqtt-bridge", f"name: {place.name}")
            changed = named.replace("version: 0.2.3", f"version: 0.{number}.0{before}")
            (place / f"0.{number}.0.yaml").write_text(changed)
    began = time.process_time()
    assert findings(folder) == []
    assert time.process_time() - began < SECONDS_MAX


def test_the_manual_names_every_unit() -> None:
    text = (REPOSITORY / "docs" / "reference" / "catalogue.md").read_text()
    assert f"`{' '.join(UNITS)}`" in text
