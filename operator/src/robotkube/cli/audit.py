"""The command `robotkube audit`: what ran, for whom and on what evidence, and what was manipulated.

It reads clones of both repositories and the OCI registry, or a folder that was saved of them, and nothing else. Ends
with 0 when nothing was found, 1 with findings, 2 on wrong usage or an unknown subject, 3 when forge or registry do not
answer.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from robotkube.cli.output import Table, lines
from robotkube.cli.platform import Platform
from robotkube.cli.terminal.printing import printable
from robotkube.cli.terminal.tables import shortened
from robotkube.delivery.audit.adapters.html_page import page
from robotkube.delivery.audit.adapters.manifests import RegistryManifests, SavedManifests, SavingManifests
from robotkube.delivery.audit.loops.auditor import Auditor, Sources
from robotkube.delivery.deployment.adapters.ssh_keys import holds
from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.forge.adapters.git import GitHistory, fetch_history
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.evidence.adapters.dsse import TrustedKeys

DEPLOYMENT, CATALOGUE = "robotkube/deployment", "robotkube/catalogue"
ACCOUNT = "manager"
DEPLOYMENT_FOLDER, CATALOGUE_FOLDER, REGISTRY_FOLDER = "deployment.git", "catalogue.git", "oci"
FINDINGS_SHOWN_MAX = 200


def auditing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "subject",
        nargs="?",
        default="",
        metavar="RELEASE|TASK|TRACE|POD|DIGEST",
        help="also an event, a plan or a commit (default: all of main)",
    )
    parser.add_argument("--keys", type=Path, required=True, metavar="FOLDER", help="public keys (*.pem) that you trust")
    parser.add_argument("--offline", type=Path, metavar="DIR", help="read what was saved there, and nothing else")
    parser.add_argument("--save", type=Path, metavar="DIR", help="keep what was read, for --offline")
    parser.add_argument(
        "--since",
        action="append",
        default=[],
        metavar="COMMIT",
        help="a tip that an earlier audit named; it must still be on main, older findings are left out; repeatable",
    )
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a page for people there, too")
    parser.add_argument("--forge-url", metavar="URL", help="the forge (default: that of the kubeconfig's cluster)")
    parser.add_argument("--forge-ca", type=Path, metavar="FILE", help="who signed its certificate, besides the usual")
    parser.add_argument("--username", default=ACCOUNT, help="account at --forge-url that may read both repositories")
    parser.add_argument("--password-file", type=Path, metavar="FILE", help="file with its password")


def audit(options: argparse.Namespace) -> Table:
    """Audit one subject, or all of main."""
    if options.offline and (options.save or options.forge_url):
        raise InputError("--offline reads a folder and nothing else: leave out --save and --forge-url")
    if options.forge_url and not options.password_file:
        raise InputError("--forge-url needs --password-file with the password of --username")
    keys = TrustedKeys(options.keys)
    with _sources(options, keys) as sources:
        document = Auditor(sources, int(time.time())).audit(options.subject)
    if options.html:
        _write_page(options.html, document)
    count = len(document["findings"])
    refusal = f"{count} finding{'s' if count > 1 else ''}; what each means: docs/reference/audit.md" if count else ""
    short = text(document, shortened)
    return Table("audit", (), [document], single=True, refusal=refusal, text=text(document), terminal_text=short)


def _write_page(path: Path, document: Mapping[str, Any]) -> None:
    try:
        path.write_bytes(page(document).encode("utf-8", "backslashreplace"))
    except OSError as error:
        raise InputError(f"--html {path}: {error.strerror}") from error


@contextmanager
def _sources(options: argparse.Namespace, keys: TrustedKeys) -> Iterator[Sources]:
    """The sources of an audit: the folder of --offline, or copies of both repositories and the registry."""
    if options.offline:
        yield _saved(options.offline, keys, options.since)
        return
    url, username, password = _access(options)
    with tempfile.TemporaryDirectory(prefix="robotkube-audit-") as temporary:
        folder = options.save or Path(temporary)
        former = [
            fetch_history(url, repository, username, password, folder / name)
            for repository, name in ((DEPLOYMENT, DEPLOYMENT_FOLDER), (CATALOGUE, CATALOGUE_FOLDER))
        ]
        with OciRegistry(url, username, password) as registry:
            manifests = SavingManifests(RegistryManifests(registry), folder / REGISTRY_FOLDER)
            yield Sources(
                GitHistory(folder / DEPLOYMENT_FOLDER),
                GitHistory(folder / CATALOGUE_FOLDER),
                keys,
                holds,
                manifests,
                url,
                options.since,
                [tip for tip in former if tip],
                _report,
            )
            if options.save:
                manifests.save()


def _saved(folder: Path, keys: TrustedKeys, since: Sequence[str]) -> Sources:
    """What was saved in a folder; without the registry's part that is not looked at."""
    if not folder.is_dir():
        raise InputError(f"--offline {folder}: no such folder; make it with `robotkube audit --save {folder}`")
    registry = folder / REGISTRY_FOLDER
    return Sources(
        GitHistory(folder / DEPLOYMENT_FOLDER),
        GitHistory(folder / CATALOGUE_FOLDER),
        keys,
        holds,
        SavedManifests(registry) if registry.is_dir() else None,
        str(registry) if registry.is_dir() else "",
        since,
        (),
        _report,
    )


def _access(options: argparse.Namespace) -> tuple[str, str, str]:
    """The forge's URL and an account."""
    if not options.forge_url:
        return Platform(options).forge_account(options.username)
    try:
        password = options.password_file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--password-file {options.password_file}: cannot be read: {error}") from error
    trust(options.forge_ca)
    return options.forge_url.rstrip("/"), options.username, password


def _report(line: str) -> None:
    print(f"robotkube: {line}", file=sys.stderr, flush=True)


def text(document: Mapping[str, Any], digest: Callable[[str], str] = str) -> str:
    """The document for people; `digest` gives the form in which digests are shown."""
    without_record = _without_record(document)
    parts = [
        *_section(
            "what ran", ("from", "until", "release", "chart", "digest", "asked_by", "nodes"), _ran(document, digest)
        ),
        *_section("who asked, who approved", ("time", "commit", "subject", "asked_by", "checked"), _changes(document)),
        *_section("which events led to it", ("commit", "task", "event", "rule", "trace"), _events(document)),
        *_section("what policies asked for", ("asked_for", "by", "approved_by", "time", "where"), _policies(document)),
        *(
            _section("commits without the gate's record", ("commit", "how", "signed_by", "made_good"), without_record)
            if without_record
            else []
        ),
        *_section("what had been verified", ("chart", "digest", "suite", "result", "key"), _verified(document, digest)),
        *_section(
            "which applications had been checked",
            ("application", "digest", "result", "key", "charts"),
            _tried(document, digest),
        ),
        *_findings(document),
        "cannot be told",
        *(f"  {sentence}" for sentence in document["cannot_be_told"]),
    ]
    return printable("".join(f"{part}\n" for part in parts))


def _section(title: str, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> list[str]:
    return [
        title,
        *(f"  {line}" for line in lines(Table(title, columns, rows)) if rows),
        *([] if rows else ["  nothing"]),
        "",
    ]


def _ran(document: Mapping[str, Any], digest: Callable[[str], str]) -> list[Mapping[str, Any]]:
    return [
        {
            **run,
            "until": run["until"] or "now",
            "chart": f"{run['chart']} {run['version']}",
            "digest": digest(run["digest"]),
            "asked_by": run["tasks"] or _applications(run["policies"]),
            "nodes": run["observed"]["nodes"] if run["observed"] else None,
        }
        for run in document["ran"]
    ]


def _changes(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [
        {
            **change,
            "commit": _short(change["commit"]),
            "asked_by": [
                *(task["task"] for task in change["tasks"]),
                *(_applications(change["policies"]) or (() if change["tasks"] else change["causes"])),
            ],
            "checked": "the first commit" if change["seed"] else _checked(change["checked"]),
        }
        for change in document["changes"]
    ]


def _applications(policies: Sequence[Mapping[str, Any]]) -> list[str]:
    """What policies asked for, in few words."""
    return list(dict.fromkeys(f"policy {row['application']}" for row in policies))


def _events(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """A row for each task of each commit."""
    return [{**task, "commit": _short(change["commit"])} for change in document["changes"] for task in change["tasks"]]


def _policies(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """A row for each entry of a policy that asked for something, or stopped to."""
    rows: dict[tuple[str, str], Mapping[str, Any]] = {}
    for row in (row for part in ("ran", "changes") for one in document[part] for row in one["policies"]):
        rows[row["entry"], row["commit"]] = {
            **row,
            "asked_for": row["entry"] if row["stands"] else f"no more: {row['entry']}",
            "by": row["author"] or "not known",
            "where": f"{row['repository']} {_short(row['commit'])}"
            + (f" #{row['pull_request']}" if row["pull_request"] else "")
            + ("" if row["key"] else ", not signed"),
        }
    return list(rows.values())


def _without_record(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """A row for each commit without a record, but the first one: who signed it, and what became of it."""
    return [
        {
            "commit": _short(change["commit"]),
            "how": "break-glass" if change["break_glass"] else "no record",
            "signed_by": change["signed_by"],
            "made_good": f"{change['made_good']['how']} by {_short(change['made_good']['commit'])}"
            if change["made_good"]
            else "no",
        }
        for change in document["changes"]
        if change["checked"] is None and not change["seed"]
    ]


def _checked(record: Mapping[str, Any] | None) -> str:
    if record is None:
        return "no record"
    people = ", ".join(record["approved_by"])
    return f"#{record['pull_request']} of {record['author']}, " + (f"approved by {people}" if people else record["way"])


def _verified(document: Mapping[str, Any], digest: Callable[[str], str]) -> list[Mapping[str, Any]]:
    rows: list[Mapping[str, Any]] = []
    for chart in document["verified"]:
        head = {"chart": f"{chart['chart']} {chart['version']}", "digest": digest(chart["digest"]), "key": chart["key"]}
        rows += [{**head, "suite": suite["suite"], "result": suite["result"].lower()} for suite in chart["suites"]]
        rows += [{**head, "suite": "summary", "result": chart["problem"] or "holds"}]
    return rows


def _tried(document: Mapping[str, Any], digest: Callable[[str], str]) -> list[Mapping[str, Any]]:
    return [
        {
            **row,
            "digest": digest(row["digest"]),
            "result": row["problem"] or "holds",
            "charts": [chart.rpartition("@")[0] for chart in row["charts"]],
        }
        for row in document["applications"]
    ]


def _findings(document: Mapping[str, Any]) -> list[str]:
    """The findings, those about the subject first and marked with a star."""
    findings = sorted(document["findings"], key=lambda one: not one["concerns"])
    parts = [f"findings: {len(findings)}"]
    for one in findings[:FINDINGS_SHOWN_MAX]:
        star = "*" if one["concerns"] else " "
        parts += [
            f"{star} {one['finding']} ({one['place']}, {one['where']})",
            f"    {one['what']}",
            f"    {one['means']}",
        ]
    if len(findings) > FINDINGS_SHOWN_MAX:
        parts.append(f"  and {len(findings) - FINDINGS_SHOWN_MAX} others; all of them: --output json, or --html FILE")
    return [*parts, ""]


def _short(commit: str) -> str:
    return commit[:12]
