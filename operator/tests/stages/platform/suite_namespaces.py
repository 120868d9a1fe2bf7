"""Suites on the running platform, asked for as the gate asks: charts in staging, requests, results."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from ci import publish
from ci.images.image_lock import lock_file, read_lock
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.evidence.core.statements import Artefact, SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.adapters.runner_protocol import SuiteRunnerClient
from robotkube.registry.suites.core.requests import SuiteRequest
from tests.stages.network.resolved_names import resolved
from tests.stages.platform.running_platform import Platform, eventually

SUITE_RUNNER = "suite-runner.robotkube.svc"
STAGING = "staging"
EMPTY_SECONDS_MAX = 120.0


def images() -> Mapping[str, str]:
    """Name -> reference of the images that the cluster has."""
    return {image.name: image.reference for image in read_lock(lock_file())}


def request(platform: Platform, chart: Path, entry: Path, rule: SuiteRule, **more: Any) -> SuiteRequest:
    """Put the chart into staging as the gate does; what it would ask about it."""
    document = yaml.safe_load(entry.read_text(encoding="utf-8"))
    packed = pack(chart, images(), document["spec"])
    forge = publish.find_forge(platform.installer.kubeconfig)
    with OciRegistry(forge.url, "gate", platform.password("gate")) as registry:
        digest = registry.push_chart(STAGING, packed, f"{packed.tag}_{packed.digest[7:19]}")
    artefact = Artefact(packed.name, packed.version, digest, "linux/amd64")
    policy = f"sha256:{secrets.token_hex(32)}"
    attempt = secrets.token_hex(8)
    return SuiteRequest(artefact, f"{STAGING}/{packed.name}", policy, rule, document, attempt=attempt, **more)


def results(platform: Platform, requests: Mapping[str, SuiteRequest], seconds: float) -> dict[str, SuiteResult]:
    """What the suite-runner says of each; all are asked for at once and run in the test namespaces of the pool."""
    where = platform.access.endpoint("suite-runner")
    token = platform.access.secret("robotkube", "suite-runner-token")["token"]
    runner = SuiteRunnerClient(replace(where, host=SUITE_RUNNER).url, token)
    by_suite: dict[str, SuiteResult] = {}

    def finished() -> bool:
        for name, asked in requests.items():
            progress = runner.run(asked)
            if progress.result is not None:
                by_suite[name] = progress.result
        return len(by_suite) == len(requests)

    try:
        with resolved(SUITE_RUNNER, where.host):
            eventually("the suite-runner has run all suites", finished, seconds)
    finally:
        runner.disconnect()
    return by_suite


def said(result: SuiteResult) -> str:
    """The failed checks in words."""
    return "\n".join(f"{check.name}: {check.found}" for check in result.failed)


def pool(platform: Platform) -> list[str]:
    """The test namespaces of the pool."""
    names = [item["metadata"]["name"] for item in platform.get("namespaces")["items"]]
    return [name for name in names if name.startswith("robotkube-suite-")]


def await_empty(platform: Platform) -> None:
    """Wait until no pod, Deployment, Secret or ConfigMap of a run is left in any test namespace."""
    namespaces = pool(platform)
    assert namespaces

    def empty() -> bool:
        return not any(_left(platform, namespace) for namespace in namespaces)

    eventually("no object of a run is left in any test namespace", empty, EMPTY_SECONDS_MAX)


def _left(platform: Platform, namespace: str) -> list[str]:
    items = platform.get("-n", namespace, "deployments,replicasets,pods,secrets,configmaps")["items"]
    names = [f"{item['kind']} {item['metadata']['name']}" for item in items]
    return [name for name in names if name != "ConfigMap kube-root-ca.crt"]
