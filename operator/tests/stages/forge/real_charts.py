"""A chart with real templates in the forge's OCI registry and catalogue, and plans that deploy it."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.references import ChartReference
from tests.stages.forge.catalogue_evidence import published_chart
from tests.stages.forge.installation import Clone, Installation, message, release_files
from tests.stages.paths import CHARTS

CHART = "mqtt-bridge"
PACKED_IMAGE = "get $packed .image"  # in the library chart, whose charts let no value name an image
IMAGE = "forge.robotkube.svc.cluster.local:3000/robotkube/ros@sha256:" + "1" * 64


@dataclass(frozen=True)
class Published:
    """A chart version of the catalogue, and its evidence."""

    chart: ChartReference
    evidence: str


@contextmanager
def published(
    installation: Installation, version: str, digest: str, charts: Path = CHARTS / "apps"
) -> Iterator[Published]:
    """An entry of the bridge with evidence and one image, IMAGE; afterwards it is not in the catalogue any more, where
    managers of other tests would take it."""
    files = published_chart(CHART, version, digest, [IMAGE], charts)
    yield Published(ChartReference(CHART, version, digest), installation.publish(files))
    installation.publish(dict.fromkeys(files))


@contextmanager
def published_bridge(installation: Installation, version: str) -> Iterator[Published]:
    """A bridge whose value `image.reference` leads to any image, as strangers' charts may, in the OCI registry too."""
    with tempfile.TemporaryDirectory() as name:
        charts = Path(name)
        chart = pack(chart_with_image_value(charts), {CHART: IMAGE})
        with OciRegistry(installation.url, "gate", installation.passwords["gate"]) as registry:
            registry.push_chart("verified", chart)
        with published(installation, version, chart.digest, charts) as bridge:
            yield bridge


def chart_with_image_value(folder: Path) -> Path:
    """The bridge's chart in `folder`, changed so that the value `image.reference` names its image."""
    chart = folder / CHART
    shutil.copytree(CHARTS / "apps" / CHART, chart)
    shutil.copytree(chart / "charts" / "robotkube-app", folder / "robotkube-app")
    shutil.rmtree(chart / "charts")
    library = folder / "robotkube-app" / "templates" / "_app.tpl"
    text = library.read_text()
    assert PACKED_IMAGE in text
    library.write_text(text.replace(PACKED_IMAGE, f"(.root.Values.image).reference | default ({PACKED_IMAGE})"))
    schema = json.loads((chart / "values.schema.json").read_text())
    schema["properties"]["image"] = {"type": "object", "properties": {"reference": {"type": "string"}}}
    (chart / "values.schema.json").write_text(json.dumps(schema))
    return chart


def plan_of(manager: Clone, plan: str, deployed: Published, name: str, values: dict[str, Any]) -> str:
    """A commit of the manager that deploys the chart in the cloud."""
    chart = deployed.chart
    files = release_files(
        plan,
        name,
        chart=chart.name,
        version=chart.version,
        digest=chart.digest,
        evidence=deployed.evidence,
        values={"placement": {"agent": "cloud-0"}, **values},
    )
    return manager.commit(files, message(plan, charts=(chart,), evidence=(deployed.evidence,)), [manager.tip()])
