"""The command `robotkube preflight`: whether a cluster can take the platform's chart, before or after it is installed.

It reads and changes nothing; with --probe, pods try out on each Node what cannot be read, in a namespace of their own
that goes with them. Ends with 1 when a check failed, 3 when the API server was not reached, 4 when a check
could not look.
"""

from __future__ import annotations

import argparse
import functools
import secrets
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.cli.output import Table
from robotkube.delivery.preflight.adapters.chart_sources import read_chart, read_values
from robotkube.delivery.preflight.adapters.cluster_facts import ClusterFacts
from robotkube.delivery.preflight.adapters.interrupts import interruptible, shielded
from robotkube.delivery.preflight.adapters.probe_cluster import KubernetesProbeCluster
from robotkube.delivery.preflight.adapters.registry_answers import RegistryQuestions
from robotkube.delivery.preflight.core.checks import CHECKS, ClusterCheck, findings
from robotkube.delivery.preflight.core.findings import FAILED, NOT_CHECKED, ClusterFinding, Unread
from robotkube.delivery.preflight.core.probing.checks import PROBE_CHECKS
from robotkube.delivery.preflight.core.probing.objects import namespace_of
from robotkube.delivery.preflight.core.probing.outcomes import Probed, ready_nodes
from robotkube.delivery.preflight.core.probing.targets import probe_target
from robotkube.delivery.preflight.facts import Preflight
from robotkube.delivery.preflight.loops.probing import NODES_MAX, ProbeClock, Probing
from robotkube.delivery.preflight.ports import ProbeCluster
from robotkube.errors import RobotKubeError
from robotkube.foundation.kubernetes.adapters import client
from robotkube.registry.charts.adapters.helm import find_helm

CHART = Path("charts/robotkube")
COLUMNS = ("check", "result", "says")


def asking(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--chart", type=Path, default=CHART, metavar="PATH", help=f"folder or archive of the chart (default: {CHART})"
    )
    parser.add_argument(
        "-f",
        "--values",
        type=Path,
        action="append",
        metavar="FILE",
        help="values for the chart, as helm takes them, also several (default: those of the release that is there)",
    )
    parser.add_argument(
        "--release", default="robotkube", metavar="NAME", help="name of the release (default: robotkube)"
    )
    parser.add_argument(
        "--registry-ca", type=Path, metavar="FILE", help="PEM of a further authority that registries of images have"
    )
    parser.add_argument(
        "--probe",
        action="store_true",
        help="start pods on each Node as well, in namespace <platform's>-probe, and remove them again: images, disks, "
        "names, clocks, the broker, NetworkPolicies (at most 60 s)",
    )


def check_cluster(options: argparse.Namespace) -> Table:
    """Run every check."""
    call = functools.partial(client.call, client.api_client(options.kubeconfig, options.context))
    preflight = Preflight(
        cluster=ClusterFacts(call),
        registries=RegistryQuestions(options.registry_ca),
        chart=read_chart(options.chart),
        given=read_values(options.values) if options.values else None,
        release=options.release,
        namespace=options.platform_namespace,
        helm=find_helm(),
    )
    facts = preflight.facts()
    checks: Sequence[ClusterCheck] = CHECKS
    if options.probe:
        namespace = namespace_of(options.platform_namespace)
        cluster = KubernetesProbeCluster(call, namespace, secrets.token_hex(8))
        facts["probed"] = probed(facts, cluster, namespace)
        checks = (*CHECKS, *PROBE_CHECKS)
    version = facts["version"]
    return shown(findings(facts, checks), version.why if isinstance(version, Unread) else "")


def probed(facts: Mapping[str, Any], cluster: ProbeCluster, namespace: str) -> Probed | Unread:
    """What pods found out; why there are none, when a fact that they need was not read, or the API server refuses."""
    needed = [facts[name] for name in ("version", "nodes", "rendering", "settings", "installed")]
    unread = [fact.why for fact in needed if isinstance(fact, Unread)]
    if unread:
        return Unread(unread[0])
    _, nodes, rendering, settings, installed = needed
    target = probe_target(rendering, settings, namespace, installed=installed)
    chosen, unasked = ready_nodes(nodes, NODES_MAX)
    print(f"pods start on {len(chosen)} Nodes, in namespace {namespace}, and go again: at most 60 s", file=sys.stderr)
    probing = Probing(cluster, target, chosen, unasked, ProbeClock(time.monotonic, time.sleep), shielded, _warn)
    try:
        with interruptible():
            return probing.run()
    except RobotKubeError as error:
        return Unread(str(error))


def _warn(sentence: str) -> None:
    print(f"warning: {sentence}", file=sys.stderr)


def shown(findings: Sequence[ClusterFinding], unreachable: str = "") -> Table:
    """The findings, as people and programs read them."""
    failed, unknown = (_names(findings, result) for result in (FAILED, NOT_CHECKED))
    return Table(
        "checks",
        COLUMNS,
        [finding.document for finding in findings],
        text="".join(f"{line}\n" for line in _lines(findings)),
        refusal=f"{len(failed)} of {len(findings)} checks failed: {', '.join(failed)}" if failed else "",
        unreachable=unreachable,
        reservation=f"{len(unknown)} of {len(findings)} checks could not look: {', '.join(unknown)}" if unknown else "",
    )


def _names(findings: Sequence[ClusterFinding], result: str) -> list[str]:
    return [finding.check for finding in findings if finding.result == result]


def _lines(findings: Sequence[ClusterFinding]) -> Iterator[str]:
    widths = [
        max(len(text) for text in column)
        for column in zip(*((finding.result, finding.check) for finding in findings), strict=True)
    ]
    for one in findings:
        yield f"{one.result.ljust(widths[0])}  {one.check.ljust(widths[1])}  {one.says}"
        for problem in one.problems:
            yield f"    {problem.where}: {problem.what}"
            yield f"        why: {problem.why}"
            yield f"        fix: {problem.fix}"
