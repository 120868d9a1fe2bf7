"""The commands `robotkube break-glass sign FILE` and `push FILE`: main takes a change without the gate, which is away,
because two registered people have signed it within 15 minutes.

The first person signs a commit of a clone of the deployment repository, which stands on main's tip, and hands over FILE
(and the commit, by a branch); the second reads what it changes and signs FILE as well; one of them pushes.
"""

from __future__ import annotations

import argparse
import getpass
import sys
from datetime import UTC, datetime
from pathlib import Path

from robotkube.cli.forge_access import REPOSITORY, forge_account, reaching
from robotkube.cli.output import Table
from robotkube.delivery.deployment.adapters.ssh_keys import holds, sign
from robotkube.delivery.deployment.core.break_glass import (
    PEOPLE_MIN,
    PUSH_OPTION,
    SIGNERS_PATH,
    TIME_FORMAT,
    EmergencyChange,
    read_change,
    read_signers,
    write_change,
)
from robotkube.errors import InputError, RefusalError
from robotkube.foundation.forge.adapters.git import WorkingClone

MAIN = "refs/heads/main"
DIFFERENCES_SHOWN_MAX = 500
COLUMNS = ("repository", "parent", "tree", "time", "reason", "signed_by")


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="the change with its signatures")
    parser.add_argument("--as", dest="name", required=True, metavar="NAME", help=f"your name in {SIGNERS_PATH}")
    parser.add_argument("--repository", type=Path, default=Path(), metavar="FOLDER", help="your clone (default: here)")


def signing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `sign`."""
    _common(parser)
    parser.add_argument("--key", type=Path, required=True, metavar="KEY", help="your private key (ssh-ed25519)")
    parser.add_argument("--commit", metavar="REVISION", help="what to begin with, when FILE is not there: a commit")
    parser.add_argument("--reason", metavar="TEXT", help="why (default: the first line of that commit's message)")


def sign_change(options: argparse.Namespace) -> Table:
    """Begin FILE with a commit, or read it, show what it changes, and add a signature; the change as it is then."""
    clone = WorkingClone(options.repository)
    change = _read(options.file) if options.file.exists() else _begun(clone, options)
    if options.file.exists() and options.commit:
        raise InputError(f"{options.file}: is there already; leave --commit out to sign it, or name another file")
    patch = clone.differences(change.parent, change.tree)
    print("\n".join(patch[:DIFFERENCES_SHOWN_MAX]), file=sys.stderr)
    if len(patch) > DIFFERENCES_SHOWN_MAX:
        print(f"... and {len(patch) - DIFFERENCES_SHOWN_MAX} lines more", file=sys.stderr)
    registered = read_signers(clone.file(change.parent, SIGNERS_PATH))
    key, signature = sign(options.key, change.statement, lambda: getpass.getpass(f"passphrase of {options.key}: "))
    if key not in registered.get(options.name, ()):
        people = ", ".join(sorted(registered)) or "nobody"
        problem = f"{options.key} is no key of {options.name!r} in {SIGNERS_PATH} on main, which names {people}"
        raise RefusalError("NotRegistered", problem)
    signed = change.signed_by(options.name, signature)
    options.file.write_text(write_change(signed), encoding="utf-8")
    return _table(signed)


def _begun(clone: WorkingClone, options: argparse.Namespace) -> EmergencyChange:
    if not options.commit:
        raise InputError(f"{options.file}: is not there; begin it with --commit REVISION")
    commit = clone.change(options.commit)
    now = datetime.now(UTC).strftime(TIME_FORMAT)
    reason = options.reason or commit.subject
    change = EmergencyChange(REPOSITORY, commit.parent, commit.tree, now, reason, {})
    return read_change(write_change(change), "the change")  # refuses a reason that cannot be written


def _read(path: Path) -> EmergencyChange:
    try:
        return read_change(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error


def pushing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `push`."""
    _common(parser)
    reaching(parser)
    parser.add_argument("--dry-run", action="store_true", help="only make the commit, and check the signatures")


def push_change(options: argparse.Namespace) -> Table:
    """Make the signed commit and push it to main; RefusalError with the forge's words when its hook refuses it."""
    clone = WorkingClone(options.repository)
    change = _read(options.file)
    registered = read_signers(clone.file(change.parent, SIGNERS_PATH))
    good = [n for n, s in change.signatures.items() if holds(s, registered.get(n, ()), change.statement)]
    wrong = sorted(set(change.signatures) - set(good))
    if wrong:
        raise RefusalError("WrongSignature", f"{options.file}: what {', '.join(wrong)} signed is not this change")
    if len(good) < PEOPLE_MIN:
        problem = f"{options.file}: signed by {', '.join(good) or 'nobody'}; {PEOPLE_MIN} registered people are needed"
        raise RefusalError("TooFewSignatures", problem)
    if options.name not in registered:
        people = ", ".join(sorted(registered))
        problem = f"{options.name!r} may not push it: {SIGNERS_PATH} on main names {people}"
        raise RefusalError("NotRegistered", problem)
    # the time that was signed: the same change is the same commit, so a push that was cut off can be made again
    seconds = int(datetime.strptime(change.time, TIME_FORMAT).replace(tzinfo=UTC).timestamp())
    commit = clone.commit(change.parent, change.tree, change.message, options.name, seconds)
    if not options.dry_run:
        access = forge_account(options, options.name)
        url = f"{access.url}/{change.repository}.git"
        clone.push(url, (access.username, access.password), commit, MAIN, [PUSH_OPTION])
    return _table(change, commit="" if options.dry_run else commit)


def _table(change: EmergencyChange, **more: str) -> Table:
    row = {name: getattr(change, name) for name in COLUMNS[:-1]}
    row = {**row, "signed_by": sorted(change.signatures), **more}
    return Table("change", tuple(row), [row], single=True)
