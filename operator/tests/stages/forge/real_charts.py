"""A chart with real templates in the forge's OCI registry and catalogue, and plans that deploy it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.references import ChartReference
from tests.stages.forge.catalogue_evidence import published_chart
from tests.stages.forge.installation import Clone, Installation, message, release_files
from tests.stages.paths import CHARTS

CHART = "mqtt-bridge"
IMAGE = "forge.robotkube.svc.cluster.local:3000/robotkube/ros@sha256:" + "1" * 64


@dataclass(frozen=True)
class Published:
    """A chart version of the catalogue, and its evidence."""

    chart: ChartReference
    evidence: str


@contextmanager
def published(installation: Installation, version: str, digest: str) -> Iterator[Published]:
    """An entry of the bridge with evidence and one image, IMAGE; afterwards it is not in the catalogue any more, where
    managers of other tests would take it."""
    files = published_chart(CHART, version, digest, [IMAGE])
    yield Published(ChartReference(CHART, version, digest), installation.publish(files))
    installation.publish(dict.fromkeys(files))


@contextmanager
def published_bridge(installation: Installation, version: str) -> Iterator[Published]:
    """The bridge as it is packed, in the OCI registry as well."""
    chart = pack(CHARTS / "apps" / CHART, {"ros": IMAGE})
    with OciRegistry(installation.url, "gate", installation.passwords["gate"]) as registry:
        registry.push_chart("verified", chart)
    with published(installation, version, chart.digest) as bridge:
        yield bridge


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
