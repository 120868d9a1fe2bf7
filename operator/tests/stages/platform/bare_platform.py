"""A cluster with Argo CD and nothing of the platform yet, and charts of the platform installed on it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.choosing import Choice
from ci.cluster.embedded.provider import Embedded
from ci.cluster_contract import topology
from ci.images import preparation
from ci.installation import NO_VALUES
from ci.steps import Steps
from scenarios import definition, demo
from scenarios.runner.platform.access import Access
from tests.stages.platform.running_platform import NAME, SCENARIO, STEPS, Platform, spoken


@contextmanager
def bare_platform(config: pytest.Config, variant: str = "") -> Iterator[Platform]:
    """The cluster `test` made anew, with the machines of a variant of the paper's use case; it goes afterwards."""
    scenario = definition.load(SCENARIO, [], variant or None)
    settings = {"vehicles": str(len(scenario.vehicles))}
    with spoken(config):
        Embedded(NAME, Path()).down()
        installer = demo.bring_up(demo.Request(SCENARIO, settings, Choice(NAME), "cluster"), Steps(STEPS))
        installer.argocd(preparation.everything().references())
    platform = Platform(installer, Embedded(NAME, installer.binaries), Access(installer.kubeconfig), scenario)
    yield platform
    platform.access.disconnect()
    if os.environ.get("ROBOTKUBE_KEEP_CLUSTER") != "1":
        platform.provider.down()


def install(platform: Platform, chart: Path, values: Mapping[str, Any] = NO_VALUES) -> None:
    """`helm upgrade --install` of a chart with the images of today; returns when everything is rolled out."""
    wanted = topology.read(SCENARIO / "scenario.yaml", {"vehicles": str(len(platform.scenario.vehicles))})
    platform.installer.platform(preparation.everything().references(), wanted, chart, values)
