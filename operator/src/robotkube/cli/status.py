"""The command `robotkube status`: where main of the deployment repository stands, what is there unchecked, whether the
gate is there, and what runs that may not."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.cli import inspections
from robotkube.cli.forge_access import REPOSITORY, AccountAtForge, forge_account, reaching
from robotkube.cli.gate_presence import GatePresence
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.deployment.adapters.ssh_keys import holds
from robotkube.delivery.deployment.core.merge_records import REFERENCE
from robotkube.delivery.deployment.core.unchecked_commits import BREAK_GLASS, NO_RECORD, NOT_SIGNED, UncheckedCommit
from robotkube.delivery.deployment.loops.unchecked_commits import Trust, UncheckedWatch
from robotkube.errors import InputError
from robotkube.foundation.forge.adapters.git import GitClone, GitNotes
from robotkube.registry.evidence.adapters.dsse import TrustedKeys

ACCOUNT = "argocd"  # which reads the repository and nothing else
RECORD_SECONDS_MAX = 15.0  # the gate's records follow its merges by some seconds
ASK_SECONDS = 1.0
COLUMNS = ("commit", "how", "signed_by", "files", "reason", "problem")
WORDS: Mapping[str, tuple[str, str]] = {
    BREAK_GLASS: ("was let past the gate with people's signatures", "were let past the gate with people's signatures"),
    NOT_SIGNED: (
        "only says that it is break-glass: its signatures do not hold, so main was moved past gate and hook",
        "only say that they are break-glass: their signatures do not hold, so main was moved past gate and hook",
    ),
    NO_RECORD: (
        "has no record of the gate: main was moved past it, or the record was taken away",
        "have no record of the gate: main was moved past it, or the records were taken away",
    ),
}
STEP = "replace the files, or name the commits in policies/accepted-commits, by a pull request"


def asking(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    reaching(parser)
    parser.add_argument("--username", default=ACCOUNT, help="account that reads the deployment repository")
    parser.add_argument(
        "--keys", type=Path, metavar="FOLDER", help="public keys (*.pem) that you trust (default: the cluster's)"
    )


def show_status(options: argparse.Namespace) -> Table:
    """Show each commit of main that the gate did not check and that stands, a gate that is away, and each stranger that
    runs; refused when there is one, or when main has no records. It reads Git, the gate's Deployment and the
    Inspections alone, so it answers also while gate and inspector are away. With --forge-url the cluster is not
    asked."""
    if options.forge_url and not options.keys:
        raise InputError(
            "--forge-url needs --keys with the public keys that you trust (docs/how-to/audit-a-platform.md)"
        )
    access = forge_account(options, options.username)
    with tempfile.TemporaryDirectory(prefix="robotkube-status-") as folder:
        keys = options.keys or _cluster_keys(Platform(options), Path(folder) / "keys")
        watch = read_main(access, Path(folder), TrustedKeys(keys), time.monotonic, time.sleep)
    if options.forge_url:
        return shown(watch)
    platform = Platform(options)
    strangers = inspections.seen(platform.inspections(), time.time_ns(), platform.inspector())
    return shown(watch, strangers, platform.gate())


def shown(watch: UncheckedWatch, seen: inspections.Seen | None = None, gate: GatePresence | None = None) -> Table:
    """What stands on main unchecked, what was seen to run, and whether the gate is there; None where nobody asked."""
    at = f"main of {REPOSITORY} is at {watch.tip[:12]}"
    rows = [_row(one) for one in watch.standing]
    main = "; ".join([*_counted(watch.standing), *([watch.problem] if watch.problem else [])])
    problems = [gate.words if gate else "", f"{main}: {STEP}" if rows else main, seen.problem if seen else ""]
    tables = [*([gate.table] if gate else []), *(seen.tables if seen else ())]
    if any(problems):
        said = [at, *problems, gate.text.strip() if gate else "", seen.blind if seen else ""]
        return Table("unchecked", COLUMNS, rows, refusal="; ".join(filter(None, said)), more=tables)
    more = f"{gate.text if gate else ''}{seen.text if seen else ''}"
    return Table("unchecked", COLUMNS, rows, text=_nothing_unchecked(at, watch.before_records) + more, more=tables)


def _nothing_unchecked(at: str, before_records: int) -> str:
    text = f"{at}; everything on it was checked by the gate, or has been replaced or accepted\n"
    if before_records:
        text += f"{before_records} of its commits came before the gate's first record, which nothing vouches for\n"
    return text


def read_main(
    access: AccountAtForge,
    folder: Path,
    keys: TrustedKeys,
    clock: Callable[[], float],
    sleep: Callable[[float], None],
) -> UncheckedWatch:
    """What stands on main, read by clones in `folder`. A missing record is asked for again for RECORD_SECONDS_MAX."""
    address = (access.url, REPOSITORY, access.username, access.password)
    clone = GitClone(*address, folder / "main")
    notes = GitNotes(*address, folder / "notes", REFERENCE)
    watch = UncheckedWatch(clone, notes, Trust(REPOSITORY, keys, holds), clock, recheck_seconds=0)
    clone.fetch()
    watch.read()
    end = clock() + RECORD_SECONDS_MAX
    while watch.unrecorded and clock() < end:
        sleep(ASK_SECONDS)
        clone.fetch()
        watch.read()
    return watch


def _cluster_keys(platform: Platform, folder: Path) -> Path:
    folder.mkdir()
    for name, text in platform.evidence_keys().items():
        (folder / Path(name).name).write_text(text, encoding="utf-8")
    return folder


def _row(one: UncheckedCommit) -> dict[str, Any]:
    return {
        "commit": one.commit,
        "how": one.how,
        "time": one.time,
        "signed_by": list(one.names),
        "files": list(one.files),
        "reason": one.reason,
        "problem": one.problem,
    }


def _counted(standing: Sequence[UncheckedCommit]) -> Iterator[str]:
    """How many there are of each kind, in words."""
    for how, words in WORDS.items():
        count = sum(one.how == how for one in standing)
        if count:
            yield f"{count} commit{'s' if count > 1 else ''} {words[count > 1]}"
