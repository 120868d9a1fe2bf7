"""The command `robotkube preflight`: whether a cluster can take the platform's chart, before or after it is installed.

It reads and changes nothing. Ends with 1 when a check failed, 3 when the API server was not reached, 4 when a check
could not look.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

from robotkube.cli.output import Table
from robotkube.delivery.preflight.adapters.chart_sources import read_chart, read_values
from robotkube.delivery.preflight.adapters.cluster_facts import ClusterFacts
from robotkube.delivery.preflight.adapters.registry_answers import RegistryQuestions
from robotkube.delivery.preflight.core.checks import findings
from robotkube.delivery.preflight.core.findings import FAILED, NOT_CHECKED, ClusterFinding, Unread
from robotkube.delivery.preflight.facts import Preflight
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


def check_cluster(options: argparse.Namespace) -> Table:
    """Run every check."""
    preflight = Preflight(
        cluster=ClusterFacts(functools.partial(client.call, client.api_client(options.kubeconfig, options.context))),
        registries=RegistryQuestions(options.registry_ca),
        chart=read_chart(options.chart),
        given=read_values(options.values) if options.values else None,
        release=options.release,
        namespace=options.platform_namespace,
        helm=find_helm(),
    )
    facts = preflight.facts()
    version = facts["version"]
    return shown(findings(facts), version.why if isinstance(version, Unread) else "")


def shown(found: Sequence[ClusterFinding], unreachable: str = "") -> Table:
    """The findings, as people and programs read them."""
    failed, unknown = (_names(found, result) for result in (FAILED, NOT_CHECKED))
    return Table(
        "checks",
        COLUMNS,
        [one.document for one in found],
        text="".join(f"{line}\n" for line in _lines(found)),
        refusal=f"{len(failed)} of {len(found)} checks failed: {', '.join(failed)}" if failed else "",
        unreachable=unreachable,
        reservation=f"{len(unknown)} of {len(found)} checks could not look: {', '.join(unknown)}" if unknown else "",
    )


def _names(found: Sequence[ClusterFinding], result: str) -> list[str]:
    return [one.check for one in found if one.result == result]


def _lines(found: Sequence[ClusterFinding]) -> Iterator[str]:
    widths = [
        max(len(text) for text in column) for column in zip(*((one.result, one.check) for one in found), strict=True)
    ]
    for one in found:
        yield f"{one.result.ljust(widths[0])}  {one.check.ljust(widths[1])}  {one.says}"
        for problem in one.problems:
            yield f"    {problem.where}: {problem.what}"
            yield f"        why: {problem.why}"
            yield f"        fix: {problem.fix}"
