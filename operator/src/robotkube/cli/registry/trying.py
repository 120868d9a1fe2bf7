"""The command `robotkube registry try PATH`: the suites that can be run here, before anything is submitted; those that
need a cluster in test namespaces of its own on the cluster of the kubeconfig.

Ends with 0 when what was run passed, 1 when a suite failed, 2 when something in the sources is wrong, 3 when a suite
came to no end, 4 when the suite `static`, which needs nothing but the program helm, was not run. Other suites that were
not run are named with the reason and change nothing of that.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.cli.output import Table, lines
from robotkube.cli.registry.pushed_images import PushedImages
from robotkube.cli.registry.reaching import Reached, reach
from robotkube.cli.registry.source_problems import check_sources
from robotkube.cli.registry.submit import IMAGES_HELP, choosing_forge
from robotkube.cli.registry.trying_on_cluster import NAMES, ClusterMeans, cluster_means
from robotkube.errors import InputError, UnavailableError
from robotkube.registry.charts.adapters.helm import LACKING, HelmProgram, find_helm
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.publication.adapters.tried_folders import find_tried, stand_ins
from robotkube.registry.publication.core.submissions import OWN_IMAGES
from robotkube.registry.publication.loops.trying import NOT_RUN, ON_THE_PLATFORM, TriedSuite, Trying
from robotkube.registry.publication.ports import ChartSource
from robotkube.registry.suites.core.image_checks import read_reference
from robotkube.registry.suites.loops.images import ImagesSuite
from robotkube.registry.suites.loops.static import StaticSuite
from robotkube.registry.suites.plain_suites import images_suite, static_suite
from robotkube.registry.suites.ports.suites import Suite

COLUMNS = ("name", "version", "suite", "outcome", "checks", "failed", "seconds")
OWN_VERSIONS = {suite.name: suite.version for suite in (StaticSuite, ImagesSuite)}
QUICK = "--quick runs nothing on a cluster"


def choosing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "path",
        nargs="?",
        type=Path,
        default=Path(),
        metavar="PATH",
        help="folder of a chart, file of an application, or a folder with charts/apps and registry",
    )
    parser.add_argument("--charts", type=Path, metavar="FOLDER", help="folder of the charts (default: charts/apps)")
    parser.add_argument("--registry", type=Path, metavar="FOLDER", help="the catalogue's sources (default: registry)")
    parser.add_argument("--images", type=Path, metavar="FILE", help=IMAGES_HELP)
    parser.add_argument("--quick", action="store_true", help="only the suites that start nothing: no cluster is used")
    choosing_forge(parser)


def try_suites(options: argparse.Namespace) -> Table:
    """Run what can be run; a row for each chart and suite."""
    tried = find_tried(options.path, options.charts, options.registry)
    check_sources(tried.names, tried.applications, tried.charts, tried.registry, "tried")
    reached = reach(options, tried.registry)
    charts = tried.read(reached.images)
    policy = tried.policy(OWN_VERSIONS)
    with _means(reached, options.quick) as trying:
        return _table(trying.run(charts, policy), charts, tried.applications)


@contextlib.contextmanager
def _means(reached: Reached, quick: bool) -> Iterator[Trying]:
    """The suites that can be run here."""
    program = find_helm()
    lacking = {} if program else dict.fromkeys(OWN_VERSIONS, LACKING)
    suites: dict[str, Suite] = {StaticSuite.name: static_suite()}
    hindrance: Callable[[ChartSource, str], str] = _unknown_images
    with contextlib.ExitStack() as stack:
        work = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="robotkube-try-")))
        if reached.forge:
            access = reached.forge
            opened = stack.enter_context(OciRegistry(access.url, access.username, access.password))
            registry = PushedImages(opened, access.username)
            suites[ImagesSuite.name] = images_suite(registry, reached.host())
            hindrance = functools.partial(_unusable_images, opened, registry)
        else:
            lacking.setdefault(ImagesSuite.name, reached.problem)
        cluster = _cluster(reached, stack, program, quick)
        lacking |= dict.fromkeys(NAMES, cluster.problem) if cluster.problem else {}
        suites |= cluster.suites
        yield Trying(suites, HelmProgram(program, work), lacking, hindrance, time.monotonic, cluster.runs)


def _cluster(reached: Reached, stack: contextlib.ExitStack, program: str, quick: bool) -> ClusterMeans:
    if not program:
        return ClusterMeans({}, problem=LACKING)
    return ClusterMeans({}, problem=QUICK) if quick else cluster_means(reached, stack)


def _unknown_images(chart: ChartSource, suite: str) -> str:
    """Why a chart's images cannot be looked up anywhere; empty when each has a digest, or the suite needs none."""
    unknown = ", ".join(stand_ins(chart)) if suite != StaticSuite.name else ""
    return f"no reference by digest of image {unknown} is known; give it in the file of --images" if unknown else ""


def _unusable_images(opened: OciRegistry, pushed: PushedImages, chart: ChartSource, suite: str) -> str:
    """Why a suite cannot use a chart's images; empty when it can, or when it is for the suite to say."""
    if suite == StaticSuite.name or stand_ins(chart):
        return _unknown_images(chart, suite)
    try:
        for reference in filter(None, map(read_reference, chart.images)):
            own = suite in NAMES and reference.repository.startswith(f"{OWN_IMAGES}/")
            there = (opened if own else pushed).manifest_digest(reference.repository, reference.digest)
            if own and not there:
                return f"nodes cannot pull {reference.repository} yet: the gate brings it there when you submit"
    except (InputError, UnavailableError) as error:
        return str(error)
    return ""


def _table(tried: Sequence[TriedSuite], charts: Sequence[ChartSource], applications: Sequence[str]) -> Table:
    images = sorted({image for chart in charts for image in stand_ins(chart)})
    if images:
        print(f"robotkube: of image {', '.join(images)} no digest is known: charts have a stand-in", file=sys.stderr)
    rows = [*(_row(one) for one in tried), *(_trial(name) for name in applications)]
    failed = [f"{one.suite} of {one.chart}" for one in tried if one.outcome == "failed"]
    unfinished = [f"{one.suite} of {one.chart}" for one in tried if one.outcome == "unfinished"]
    table = Table("suites", COLUMNS, rows)
    text = "\n".join([*lines(table), *_failures(tried), *_reserved(tried), *_not_run(rows), *_without_soak(tried)])
    refusal = f"failed: {', '.join(failed)}" if failed else ""
    unreachable = f"came to no end: {', '.join(unfinished)}" if unfinished else ""
    unproved = _reservation(tried)
    return Table("suites", COLUMNS, rows, False, refusal, unreachable, unproved, f"{text}\n")


def _reservation(tried: Sequence[TriedSuite]) -> str:
    """What was not proved, although this machine alone could: the suite that needs no platform was not run."""
    reasons = {one.chart: one.reason for one in tried if (one.suite, one.outcome) == (StaticSuite.name, NOT_RUN)}
    if not reasons:
        return ""
    return f"nothing is proved: {StaticSuite.name} of {', '.join(reasons)} was not run: {next(iter(reasons.values()))}"


def _row(one: TriedSuite) -> dict[str, Any]:
    row = {"kind": "chart", "name": one.chart, "version": one.version, "suite": one.suite, "outcome": one.outcome}
    if one.result is None:
        return {**row, "reason": one.reason}
    failed = [{"name": check.name, "found": check.found, "fix": check.fix} for check in one.result.failed]
    return {
        **row,
        "checks": len(one.result.checks),
        "failed": len(failed),
        "seconds": one.result.seconds,
        "failures": failed,
        "reservations": [{"name": check.name, "found": check.found} for check in one.result.reserved],
    }


def _failures(tried: Sequence[TriedSuite]) -> Iterator[str]:
    for one in tried:
        if one.result and one.result.failed:
            yield from ("", f"{one.suite} of {one.chart} {one.outcome}:")
            for check in one.result.failed:
                yield from (f"- {check.name}", f"  found: {check.found}", f"  do: {check.fix}")


def _reserved(tried: Sequence[TriedSuite]) -> Iterator[str]:
    """What checks that passed have not shown."""
    for one in tried:
        for check in one.result.reserved if one.result else ():
            yield from ("", f"{one.suite} of {one.chart}, {check.name}: {check.found}")


def _trial(application: str) -> dict[str, Any]:
    """Its composition for samples of its parameters, which takes the whole catalogue."""
    row = {"kind": "application", "name": application, "suite": "trial", "outcome": NOT_RUN}
    return {**row, "reason": "made by the gate when you submit"}


def _not_run(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Each reason once, with the suites and what they are of."""
    reasons: dict[str, dict[tuple[str, str], list[str]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        if row["outcome"] == NOT_RUN:
            reasons[row["reason"]][row["suite"], row["kind"]].append(row["name"])
    everything = {kind: {row["name"] for row in rows if row["kind"] == kind} for kind in ("chart", "application")}
    for reason, suites in reasons.items():
        words = [f"{suite} of {_those(names, kind, everything[kind])}" for (suite, kind), names in suites.items()]
        yield from ("", f"not run: {'; '.join(words)}: {reason}")


def _without_soak(tried: Sequence[TriedSuite]) -> Iterator[str]:
    """What the suite `install` left out."""
    names = [one.chart for one in tried if one.suite == "install" and one.result]
    if names:
        yield from ("", f"not run: the soak in install of {', '.join(names)}: {ON_THE_PLATFORM}")


def _those(names: Sequence[str], kind: str, everything: Collection[str]) -> str:
    """The names, or that it is all of several."""
    return f"every {kind}" if len(everything) > 1 and set(names) == set(everything) else ", ".join(names)
