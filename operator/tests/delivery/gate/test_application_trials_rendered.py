"""Trials of this project's applications with its charts, rendered by the gate's renderer."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.gate.loops.application_trials import CompositionTrials
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.chart_renderer import ChartRenderer
from robotkube.registry.charts.core.packing import build_tag
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.loops.release_images import ReleaseObjects
from robotkube.registry.publication.core.submissions import schema_text
from robotkube.testing.publishing import MemoryChartRegistry
from tests.stages.delivery.manager.manager_in_memory import schema_file
from tests.stages.forge.real_charts import IMAGE, chart_with_image_value
from tests.stages.paths import CHARTS, DOCS, REGISTRY
from tests.stages.programs import program
from tests.stages.registry.publications import write_sources
from tests.stages.registry.signed_evidence import signing_key, trusting

pytestmark = pytest.mark.toolchain

FOREIGN = "docker.io/library/busybox@sha256:" + "2" * 64


class Catalogue:
    """The project's catalogue with its charts in staging, as one submission of all of them."""

    def __init__(self) -> None:
        paths = [*REGISTRY.glob("applications/*.yaml"), *REGISTRY.glob("policies/*.yaml")]
        self.files = {str(path.relative_to(REGISTRY)): path.read_text() for path in paths}
        self.registry = MemoryChartRegistry()
        self.submitted: list[ChartReference] = []
        for path in sorted(REGISTRY.glob("charts/*/*.yaml")):
            document = yaml.safe_load(path.read_text())
            version = document["spec"]["version"]
            self.add(_folder(path.parent.name, version), document)
            self.files |= schema_file(path.parent.name, version)

    def add(self, folder: Path, document: dict[str, Any]) -> None:
        """Submit the chart in `folder` with the entry `document`."""
        images = dict.fromkeys(document["spec"]["images"], IMAGE)
        packed = pack(folder, images, document["spec"])
        self.registry.push_chart("staging", packed, build_tag(packed.version, packed.digest))
        status = {"state": "staged", "digest": packed.digest, "images": sorted(set(images.values()))}
        self.files[f"charts/{packed.name}/{packed.version}.yaml"] = yaml.safe_dump({**document, "status": status})
        self.submitted = [one for one in self.submitted if (one.name, one.version) != (packed.name, packed.version)]
        self.submitted.append(ChartReference(packed.name, packed.version, packed.digest))


def _folder(chart: str, version: str) -> Path:
    places = [CHARTS / place / chart for place in ("apps", "earlier")]
    return next(p for p in places if p.is_dir() and f"version: {version}\n" in (p / "Chart.yaml").read_text())


@pytest.fixture
def catalogue() -> Catalogue:
    return Catalogue()


@pytest.fixture
def renderer() -> Iterator[ChartRenderer]:
    started = ChartRenderer(program("chart-renderer"))
    yield started
    started.close()


def trials(catalogue: Catalogue, renderer: ChartRenderer, folder: Path) -> CompositionTrials:
    reader = EvidenceReader(trusting(folder / "keys", signing_key(folder / "key")))
    objects = ReleaseObjects(catalogue.registry, ("verified", "staging"), renderer)
    return CompositionTrials(reader, Jinja2Templates().render, validate, objects, time.monotonic)


def names(files: Mapping[str, str]) -> set[str]:
    return {path.split("/")[1].removesuffix(".yaml") for path in files if path.startswith("applications/")}


def test_every_application_of_the_project_passes(catalogue: Catalogue, renderer: ChartRenderer, tmp_path: Path) -> None:
    results = trials(catalogue, renderer, tmp_path)(catalogue.files, names(catalogue.files), catalogue.submitted)
    assert {name: result.problems for name, result in results.items()} == dict.fromkeys(names(catalogue.files), ())
    assert all(result.charts and result.samples and result.releases for result in results.values())


def test_a_value_that_names_an_image_is_found_where_a_parameter_leads_to_it(
    catalogue: Catalogue, renderer: ChartRenderer, tmp_path: Path
) -> None:
    document = yaml.safe_load(catalogue.files["charts/mqtt-bridge/0.2.3.yaml"])
    del document["status"]
    catalogue.add(chart_with_image_value(tmp_path / "charts"), document)
    schema = json.loads(catalogue.files["charts/mqtt-bridge/0.2.3.schema.json"])
    schema["properties"]["image"] = {"type": "object", "properties": {"reference": {"type": "string"}}}
    catalogue.files["charts/mqtt-bridge/0.2.3.schema.json"] = json.dumps(schema)
    parameters = {"image": {"enum": [IMAGE, FOREIGN], "default": IMAGE}}
    service = {
        "name": "bridge",
        "release": "second-bridge",
        "chart": {"name": "mqtt-bridge", "version": ">=0.2.0 <0.3.0"},
        "placement": {"role": "cloud"},
        "values": {"image": {"reference": "{{ parameters.image }}"}},
    }
    text = {"spec": {"description": "Bridges", "provides": [], "services": [service]}}
    text["spec"]["parameters"] = {"type": "object", "properties": parameters}
    head = {"apiVersion": "registry.robotkube.io/v1alpha1", "kind": "Application", "metadata": {"name": "bridging"}}
    catalogue.files["applications/bridging.yaml"] = yaml.safe_dump({**head, **text})
    trial = trials(catalogue, renderer, tmp_path)(catalogue.files, ["bridging"], catalogue.submitted)["bridging"]
    assert len(trial.problems) == 1
    words = f"a pod would run image {FOREIGN}, which was not verified with chart"
    assert f"spec.services[0]: with parameters {{'image': '{FOREIGN}'}}: {words}" in trial.problems[0]


def test_the_application_of_the_how_to_passes_with_the_chart_that_the_command_writes(
    catalogue: Catalogue, renderer: ChartRenderer, tmp_path: Path
) -> None:
    page = (DOCS / "how-to" / "add-an-application.md").read_text()
    path = "registry/applications/greeting.yaml"
    (text,) = re.findall(rf"^```yaml {path}\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    write_sources(tmp_path, "text-relay")
    entry = yaml.safe_load((tmp_path / "registry" / "charts" / "text-relay" / "0.1.0.yaml").read_text())
    entry["spec"]["provides"] = ["text/relay"]
    chart = tmp_path / "charts" / "apps" / "text-relay"
    catalogue.add(chart, entry)
    values = {name: (chart / name).read_bytes() for name in ("values.schema.json", "values.yaml")}
    catalogue.files |= {"charts/text-relay/0.1.0.schema.json": schema_text(values)}
    catalogue.files |= {path.removeprefix("registry/"): text}
    trial = trials(catalogue, renderer, tmp_path)(catalogue.files, ["greeting"], catalogue.submitted)["greeting"]
    assert trial.problems == ()
    assert [chart.name for chart in trial.charts] == ["text-relay"]


def test_a_new_chain_of_services_passes(catalogue: Catalogue, renderer: ChartRenderer, tmp_path: Path) -> None:
    write_sources(tmp_path, "delivery", "--services", "order,plan,drive")
    for service in ("order", "plan", "drive"):
        name = f"delivery-{service}"
        chart = tmp_path / "charts" / "apps" / name
        catalogue.add(chart, yaml.safe_load((tmp_path / "registry" / "charts" / name / "0.1.0.yaml").read_text()))
        values = {file: (chart / file).read_bytes() for file in ("values.schema.json", "values.yaml")}
        catalogue.files[f"charts/{name}/0.1.0.schema.json"] = schema_text(values)
    path = "applications/delivery.yaml"
    catalogue.files[path] = (tmp_path / "registry" / path).read_text()
    trial = trials(catalogue, renderer, tmp_path)(catalogue.files, ["delivery"], catalogue.submitted)["delivery"]
    assert trial.problems == ()
    assert [chart.name for chart in trial.charts] == ["delivery-drive", "delivery-order", "delivery-plan"]
