"""The command `robotkube registry submit CHART...`: pack, push, propose to the catalogue, await the verdict.

Ends with 0 when everything is published, 1 when the gate refused (its report is on stderr), 2 when something in the
sources is wrong, 3 when the forge is out of reach or the gate did not decide in time.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.cli.registry.result_lines import ResultLines
from robotkube.cli.registry.source_problems import check_sources
from robotkube.errors import InputError, RobotKubeError
from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.documents.core.times import second_text
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from robotkube.foundation.forge.ports.pull_requests import PullRequest
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.evidence.core.statements import NONE
from robotkube.registry.publication.adapters import submission_folders as folders
from robotkube.registry.publication.core.report_results import ReportedResult
from robotkube.registry.publication.core.submissions import SubmittedChart
from robotkube.registry.publication.loops.submitting import PLANNED, REFUSED, SubmissionOutcome, Submitting
from robotkube.registry.publication.ports import SubmittedSources

CATALOGUE = "robotkube/catalogue"
ACCOUNT = "publisher"
WAIT_SECONDS = 1800.0
IMAGES_HELP = "YAML: image name -> reference by digest (default: images.yaml of the catalogue's sources)"


@dataclass(frozen=True)
class ForgeAccess:
    """The address at which the forge is reached from here, and the publisher's account."""

    url: str
    username: str
    password: str


def submitting(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("charts", nargs="*", metavar="CHART", help="name of a chart in the folder of charts")
    parser.add_argument("--application", action="append", default=[], metavar="NAME", help="publish this as well")
    parser.add_argument("--all", action="store_true", help="all charts and applications of the folders")
    parser.add_argument("--charts", dest="charts_folder", type=Path, default=Path("charts/apps"), metavar="FOLDER")
    parser.add_argument("--registry", type=Path, default=Path("registry"), metavar="FOLDER", help="catalogue's sources")
    parser.add_argument("--images", type=Path, metavar="FILE", help=IMAGES_HELP)
    choosing_forge(parser)
    parser.add_argument(
        "--kept", type=Path, metavar="FOLDER", help="reuse and keep evidence here, for the same digests"
    )
    parser.add_argument("--wait", type=float, default=WAIT_SECONDS, metavar="SECONDS", help="for the gate's verdict")
    parser.add_argument(
        "--watch", action="store_true", help="write each suite's result to stdout as it comes, the verdict last"
    )
    parser.add_argument("--again", action="store_true", help="also what is published, such as after a change of keys")
    parser.add_argument("--dry-run", action="store_true", help="only show what would be submitted")


def choosing_forge(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say which forge, and as whom."""
    parser.add_argument("--forge-url", metavar="URL", help="the forge (default: that of the kubeconfig's cluster)")
    parser.add_argument("--forge-ca", type=Path, metavar="FILE", help="who signed its certificate, besides the usual")
    parser.add_argument("--username", default=ACCOUNT, help="account at --forge-url")
    parser.add_argument("--password-file", type=Path, metavar="FILE", help="file with its password")


def submit(options: argparse.Namespace) -> Table | None:
    """Submit charts and applications; a row for each. With --watch a line for each result instead."""
    if not (options.charts or options.application or options.all):
        raise InputError("nothing to submit: name charts, applications (--application NAME), or --all")
    access, images = _access(options)
    names = folders.all_charts(options.charts_folder) if options.all else options.charts
    applications = folders.all_applications(options.registry) if options.all else options.application
    check_sources(names, applications, options.charts_folder, options.registry, "submitted")
    sources = folders.read_sources(names, applications, options.charts_folder, options.registry, images, options.kept)
    lines = ResultLines(options.output, sys.stdout, lambda: second_text(time.time_ns())) if options.watch else None
    outcome = submit_sources(
        access,
        sources,
        _write_line,
        options.wait,
        options.dry_run,
        options.again,
        report_result=lines.result if lines else None,
    )
    if options.kept:
        folders.write_kept(options.kept, outcome.evidence)
    if outcome.text:
        print(outcome.text, file=sys.stderr)
    if lines is None:
        return _table(outcome)
    lines.verdict(outcome.verdict, outcome.url)
    if outcome.verdict == REFUSED:
        raise RobotKubeError(_refusal(outcome))
    return None


def submit_sources(
    access: ForgeAccess,
    sources: SubmittedSources,
    report_line: Callable[[str], None],
    wait_seconds: float = WAIT_SECONDS,
    dry_run: bool = False,
    again: bool = False,
    opened: Callable[[PullRequest], None] = lambda pull: None,
    report_result: Callable[[ReportedResult], None] | None = None,
) -> SubmissionOutcome:
    """Submit to the forge and wait for the verdict: the command without reading sources and showing results. `opened`
    is called with the pull request before the verdict is waited for, `report_result` with each suite's result."""
    with _connected(access, report_line, opened, report_result) as submitter:
        return submitter.submit(sources, wait_seconds, dry_run, again)


@contextmanager
def _connected(
    access: ForgeAccess,
    report_line: Callable[[str], None],
    opened: Callable[[PullRequest], None],
    report_result: Callable[[ReportedResult], None] | None,
) -> Iterator[Submitting]:
    account = (access.username, access.password)
    with (
        tempfile.TemporaryDirectory(prefix="robotkube-submit-") as folder,
        OciRegistry(access.url, *account) as oci_registry,
    ):
        clone = GitClone(access.url, CATALOGUE, *account, Path(folder))
        writer = ProposalWriter(Path(folder), *account, access.username, time.time)
        forge = GiteaForge(access.url, CATALOGUE, *account)
        try:
            yield Submitting(
                clone,
                writer,
                forge,
                oci_registry,
                access.username,
                time.monotonic,
                time.sleep,
                report_line,
                opened,
                report_result=report_result,
            )
        finally:
            forge.disconnect()


def _access(options: argparse.Namespace) -> tuple[ForgeAccess, dict[str, str]]:
    """The forge, and references of images: the cluster's, overridden by those of the file."""
    given = folders.known_images(options.images, options.registry)
    if options.forge_url:
        return forge_access(options), given
    platform = Platform(options)
    return forge_access(options), {**platform.images(), **platform.service_images(), **given}


def forge_access(options: argparse.Namespace) -> ForgeAccess:
    """The forge of --forge-url, --username and --password-file, else that of the kubeconfig's cluster."""
    if not options.forge_url:
        return ForgeAccess(*Platform(options).forge_account(ACCOUNT))
    if not options.password_file:
        raise InputError("--forge-url needs --password-file with the password of --username")
    try:
        password = options.password_file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--password-file {options.password_file}: cannot be read: {error}") from error
    trust(options.forge_ca)
    return ForgeAccess(options.forge_url.rstrip("/"), options.username, password)


def _write_line(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _table(outcome: SubmissionOutcome) -> Table:
    rows = [_row(chart, outcome) for chart in outcome.charts]
    rows += [
        {"kind": "application", "name": path.removesuffix(".yaml").rpartition("/")[2], "verdict": outcome.verdict}
        for path in outcome.applications
    ]
    rows += [{"kind": "chart", "name": name, "verdict": "unchanged"} for name in outcome.unchanged]
    refusal = _refusal(outcome) if outcome.verdict == REFUSED else ""
    return Table("submitted", ("kind", "name", "verdict", "digest", "evidence"), rows, refusal=refusal)


def _refusal(outcome: SubmissionOutcome) -> str:
    return f"refused by the gate, see its report above and at {outcome.url}"


def _row(chart: SubmittedChart, outcome: SubmissionOutcome) -> dict[str, Any]:
    summary = f"{chart.artefact.folder}/summary.json"
    evidence = summary if summary in outcome.evidence and outcome.verdict != PLANNED else NONE
    return {
        "kind": "chart",
        "name": chart.name,
        "verdict": outcome.verdict,
        "digest": chart.digest,
        "evidence": evidence,
        "pull_request": outcome.url,
    }
