"""The commands `robotkube registry list|search|show|graph|validate`: entries of the catalogue, and faults of its
sources.

Entries are those of the platform when one is reachable, else, or with `--local`, those of the sources in `registry`;
`--registry` names another folder of sources.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.cli.registry.source_problems import source_problems
from robotkube.errors import InputError, RefusalError, UnavailableError, did_you_mean
from robotkube.registry.catalogue.adapters.source_folders import read_sources
from robotkube.registry.catalogue.core.catalogue import read_catalogue
from robotkube.registry.catalogue.core.chart_versions import CHANNELS, STATES
from robotkube.registry.catalogue.core.entry_documents import SOURCE, UNVERIFIED, entry_documents
from robotkube.registry.catalogue.core.search import Criteria, Entry, dot, find, read_guarantee, search, upgrade_rows

REGISTRY = Path("registry")
CHARTS = Path("charts/apps")
PROBLEMS_SHOWN_MAX = 10
COLUMNS = ("kind", "name", "version", "channel", "state", "provides", "declared", "description")


def choosing_sources(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say where the entries come from."""
    places = parser.add_mutually_exclusive_group()
    places.add_argument("--registry", type=Path, metavar="FOLDER", help="sources in this folder")
    places.add_argument("--local", action="store_true", help=f"sources in the folder {REGISTRY}")
    places.add_argument(
        "--platform",
        action="store_true",
        help=f"the platform's catalogue, or nothing (default: that when a platform answers, else {REGISTRY})",
    )


def searching(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `search`: all that are given must hold."""
    choosing_sources(parser)
    parser.add_argument("text", nargs="?", default="", metavar="TEXT", help="part of a name or description")
    parser.add_argument("--provides", default="", metavar="CAPABILITY", help="such as recording or recording/pose")
    parser.add_argument(
        "--needs", default="", metavar="WORD", help="a chart, capability, bridge, medium or type of topic"
    )
    parser.add_argument("--guarantee", default="", metavar="GUARANTEE", help="such as stop-time or 'stop-time<=3s'")
    parser.add_argument("--channel", default="", choices=CHANNELS)
    parser.add_argument("--state", default="", choices=(*STATES, SOURCE, UNVERIFIED))


def naming(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `show`."""
    choosing_sources(parser)
    parser.add_argument("name", metavar="NAME[@VERSION]", help="an application or a chart")


def drawing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `graph`."""
    choosing_sources(parser)
    parser.add_argument("charts", nargs="*", metavar="CHART", help="only these charts")
    parser.add_argument("--dot", action="store_true", help="as a graph for Graphviz instead of a table")


def validating(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `validate`."""
    parser.add_argument("--registry", type=Path, default=REGISTRY, metavar="FOLDER", help="sources (default: registry)")
    parser.add_argument(
        "--charts", type=Path, default=None, help="folder of the charts (default: charts/apps beside it)"
    )


def search_entries(options: argparse.Namespace) -> Table:
    """List the entries that meet all criteria."""
    guarantee = read_guarantee(options.guarantee) if options.guarantee else ""
    criteria = Criteria(options.text, options.provides, options.needs, guarantee, options.channel, options.state)
    return _table(search(_entries(options), criteria))


def _table(entries: Sequence[Entry]) -> Table:
    return Table("entries", COLUMNS, [{**entry, "declared": _declared(entry)} for entry in entries])


def _declared(entry: Entry) -> list[str]:
    """The declared guarantees in short; the table's heading says what they are worth."""
    bounds = {"atMost": "<=", "atLeast": ">="}
    return [
        f"{g['name']}{bounds[bound]}{g[bound]:g}{g['unit']}"
        for g in entry.get("guarantees", ())
        for bound in bounds
        if bound in g
    ]


def list_entries(options: argparse.Namespace) -> Table:
    """List every entry."""
    return _table(_entries(options))


def show_entry(options: argparse.Namespace) -> Table:
    """Show one entry whole; both, when an application and a chart have the name."""
    entries = find(_entries(options), options.name)
    return Table("entries", COLUMNS, entries, single=len(entries) == 1)


def show_graph(options: argparse.Namespace) -> Table:
    """List the versions of charts and the upgrades between them. RefusalError: one that is named is not there."""
    every = upgrade_rows(_entries(options))
    known = sorted({row["chart"] for row in every})
    if missing := sorted({*options.charts} - {*known}):
        instead = f"{did_you_mean(missing[0], known)}there are {', '.join(known) or 'none'}"
        raise RefusalError("UnknownChart", f"the catalogue has no chart {', '.join(missing)}; {instead}")
    rows = [row for row in every if not options.charts or row["chart"] in options.charts]
    columns = ("chart", "version", "channel", "state", "replaces", "skips", "upgrades_to")
    return Table("versions", columns, rows, text=dot(rows) if options.dot else "")


def _entries(options: argparse.Namespace) -> Sequence[Entry]:
    if options.registry or options.local:
        return _of_sources(options.registry or REGISTRY)
    named = options.platform or options.kubeconfig or options.context
    try:
        entries: Sequence[Entry] = Platform(options).page("/catalogue")["entries"]
    except (InputError, UnavailableError) as error:
        if named or not REGISTRY.is_dir():
            raise
        print(f"robotkube: from the sources in {REGISTRY}, since no platform answers: {error}", file=sys.stderr)
        return _of_sources(REGISTRY)
    if REGISTRY.is_dir() and not named:
        print(f"robotkube: from the platform's catalogue; --local: from the sources in {REGISTRY}", file=sys.stderr)
    return entries


def _of_sources(folder: Path) -> Sequence[Entry]:
    sources = read_sources(folder)
    catalogue = read_catalogue(sources.files, published=False)
    problems = [*map(str, sources.findings), *(f"{folder}/{problem}" for problem in catalogue.problems)]
    for problem in problems[:PROBLEMS_SHOWN_MAX]:
        print(f"robotkube: left out: {problem}", file=sys.stderr)
    return entry_documents(catalogue, published=False)


def validate_registry(options: argparse.Namespace) -> Table:
    """List every mistake in the sources; refused when there is one."""
    charts = options.charts or options.registry.parent / CHARTS
    sources = read_sources(options.registry, charts)
    findings = source_problems(sources)
    rows = [{"file": finding.file, "key": finding.key, "problem": finding.text} for finding in findings]
    files = len(sources.files)
    mistakes = "mistake" if len(findings) == 1 else "mistakes"
    print(
        f"robotkube: {files} files, {len(sources.folders)} charts beside them, {len(findings)} {mistakes}",
        file=sys.stderr,
    )
    refusal = f"{options.registry}: {len(findings)} {mistakes}" if findings else ""
    text = "".join(f"{finding}\n" for finding in findings) or "no mistakes\n"
    return Table("mistakes", ("file", "key", "problem"), rows, refusal=refusal, text=text)
