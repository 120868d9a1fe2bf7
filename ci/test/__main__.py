"""`make test`: four groups, each with its time; `--fast` runs the one of them that needs no other program, and
`--thorough` three groups of slower proofs instead. Exit code 1 when anything failed.

Tests on the cluster wait a third of their time, so groups that only compute run beside them at the lowest priority;
what these print follows once they have ended.

What a group needs (Debian packages, tool chain, images) is made before its time begins, once, and cached. Tests find
the programs of the tool chain in the folder ROBOTKUBE_TOOLCHAIN_BIN. A group that runs no test has failed, and so has a
whole run during which a file that git has changed.
"""

from __future__ import annotations

import argparse
import sys

from ci.errors import SetUpError
from ci.machine import preflight
from ci.reference import principles
from ci.test import working_tree
from ci.test.groups import FAST, GROUPS, TESTS, THOROUGH, TOP, Group, Result, failures, run_all, table

FILES = Group("files", "", 60, "nothing")  # of the repository: not chosen, but compared by each run


def main() -> int:
    parser = argparse.ArgumentParser(prog="make test", description=__doc__)
    parser.add_argument("--fast", action="store_true", help="run the tests that start no other program")
    parser.add_argument("--thorough", action="store_true", help="run the slower proofs")
    every = (*GROUPS, *THOROUGH)
    parser.add_argument("--only", action="append", choices=[group.name for group in every], help="run only this group")
    parser.add_argument("places", nargs="*", default=[TESTS], help=f"folders or files of tests; all of {TESTS} if none")
    arguments = parser.parse_args()
    tier = THOROUGH if arguments.thorough else (FAST,) if arguments.fast else GROUPS
    groups = [group for group in every if group.name in arguments.only] if arguments.only else list(tier)
    before = working_tree.read(TOP)
    finished: list[Result] = []
    try:
        if any(one.needs != "nothing" for one in groups):
            preflight.require()
        run_all(groups, arguments.places, finished)
    except SetUpError as error:
        ended = {one.group.name for one in finished}
        missing = [group for group in groups if group.name not in ended]
        finished += [Result(group, 0, 1, 0, 0.0) for group in missing]
        print(f"error: {', '.join(group.name for group in missing)} cannot be run: {error}", file=sys.stderr)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    whole = not arguments.fast and not arguments.only and arguments.places == [TESTS]
    finished += compared(before, working_tree.read(TOP), whole)
    differences = principles.differences()
    if differences and any(one.group.name in ("platform", "clusters") for one in finished):
        print(f"\nTable I is not what its page states ({differences}): `make reference` writes it", flush=True)
    print("\n" + "\n".join([*failures(finished), table(finished)]), flush=True)
    return 1 if any(one.failed or not one.passed for one in finished) else 0


def compared(before: working_tree.Files, after: working_tree.Files, whole: bool) -> list[Result]:
    """Say what became of the repository's files. That some changed that git had is a failure of a `whole` run, which
    has tested no one state of them; who runs some tests may be writing."""
    if before.unread:
        print(f"\nno file was compared with what it was before the tests: {before.unread}", flush=True)
    difference = working_tree.difference(before, after)
    others = working_tree.difference_of_others(before, after)
    failed = [Result(FILES, 0, 1, 0, 0.0, {"files of the repository": difference})] if whole and difference else []
    for one in (*([] if failed else [difference]), others):
        if one:
            print(f"\nnot counted as a failure: {one}", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
