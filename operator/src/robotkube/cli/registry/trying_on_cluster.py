"""The suites of `robotkube registry try` that need a cluster: with the rights of the kubeconfig, in test namespaces of
the command's own."""

from __future__ import annotations

import contextlib
import secrets
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.cli.platform import Platform
from robotkube.cli.registry.reaching import Reached
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.issuing import throw_away
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.suites.adapters.own_namespaces import KubernetesOwnNamespaces
from robotkube.registry.suites.cluster_suites import install_suite, interface_suite
from robotkube.registry.suites.core.own_namespaces import PREFIX
from robotkube.registry.suites.loops.cluster_namespace import SuiteNamespaceSettings
from robotkube.registry.suites.loops.own_namespace_runs import SECONDS_MAX, OwnNamespaceRuns
from robotkube.registry.suites.ports.suites import Suite

NAMES = ("interface", "install")
WITHOUT_SOAK = 0
NO_RUNNER = "the platform has no suite-runner (suites.enabled), of which node, images and test namespace are known"


@dataclass(frozen=True)
class ClusterMeans:
    """The suites that need a cluster and what runs them; `problem` says why there is none."""

    suites: Mapping[str, Suite]
    runs: OwnNamespaceRuns | None = None
    problem: str = ""


def cluster_means(reached: Reached, stack: contextlib.ExitStack) -> ClusterMeans:
    """What can be run on the cluster of the kubeconfig; namespaces are removed when `stack` ends."""
    if reached.platform is None:
        return ClusterMeans({}, problem=f"needs a cluster: {reached.problem or '--forge-url names a forge alone'}")
    try:
        return _reachable(reached.platform, stack)
    except (InputError, UnavailableError) as error:
        return ClusterMeans({}, problem=f"the cluster cannot be used: {error}")


def _reachable(platform: Platform, stack: contextlib.ExitStack) -> ClusterMeans:
    runner = platform.suite_runner()
    pool = runner.get("test_namespaces") or ()
    if not pool:
        return ClusterMeans({}, problem=NO_RUNNER)
    namespaces = KubernetesOwnNamespaces(platform.call, str(pool[0]["namespace"]))
    missing = namespaces.missing_rights(f"{PREFIX}x")
    if missing:
        return ClusterMeans({}, problem=f"your account may not: {'; '.join(missing)}. Ask for these rights, or submit")
    render = Jinja2Templates().render
    token = secrets.token_hex(4)
    runs = OwnNamespaceRuns(namespaces, _settings(runner), render, token, time.monotonic, time.time_ns, _report)
    observer = str(runner["images"]["observer"])
    suites: tuple[Suite, ...] = (interface_suite(observer), install_suite(observer, WITHOUT_SOAK))
    _report(f"interface and install run on the cluster in {PREFIX}{token}-..., for at most {SECONDS_MAX:.0f} s")
    return ClusterMeans({suite.name: suite for suite in suites}, stack.enter_context(runs))


def _settings(runner: Mapping[str, Any]) -> Callable[[str, int], SuiteNamespaceSettings]:
    images = runner["images"]

    def settings(namespace: str, domain_id: int) -> SuiteNamespaceSettings:
        agent, observer, broker = str(runner["agent"]), str(images["observer"]), str(images["broker"])
        certify = throw_away if runner.get("tls") else None
        return SuiteNamespaceSettings(namespace, domain_id, agent, observer, broker, certify=certify)

    return settings


def _report(sentence: str) -> None:
    print(f"robotkube: {sentence}", file=sys.stderr)
