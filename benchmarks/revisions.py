"""Benchmarks of this checkout and of an earlier revision, in turns, so that slow minutes of the machine meet both.

    ci/python -m benchmarks.revisions REVISION --only event-detector --only registry [--rounds 2]

Each round runs a benchmark here and then in a working tree of the revision, with its own Python environment and tool
chain. What a benchmark calls its own figure is compared, by name; of all of them less is better. A figure is worse when
its best round here is beyond the revision's worst by more than NOISE. Exit code 1 when one is. The rounds go to
build/reports/revisions.json.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from ci.errors import SetUpError
from ci.folders import PROJECT

Round = Mapping[str, float]
"""Figures of one run by name."""

NOISE = 0.1
ROUNDS = 2
SECONDS_MAX = 3600
REPORT = PROJECT / "build" / "reports" / "revisions.json"
RESULT = Path("build/reports/benchmarks.json")
NUMBERED = re.compile(r" of \d+$")  # `p99 of 1412`: how many were measured differs from run to run


@dataclass(frozen=True)
class Difference:
    """One figure, each of its rounds here and at the revision."""

    name: str
    unit: str
    ours: tuple[float, ...]
    before: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """The best round here by the best of the revision."""
        return min(self.ours) / min(self.before) if min(self.before) else float("inf")

    @property
    def worse(self) -> bool:
        """Return whether every round here is beyond every round of the revision by more than noise."""
        return min(self.ours) > max(self.before) * (1 + NOISE)


@contextmanager
def working_tree(revision: str) -> Iterator[Path]:
    """A working tree of the revision while it is needed."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "before"
        git = ["git", "-C", str(PROJECT), "worktree"]
        added = subprocess.run(
            [*git, "add", "--quiet", "--detach", str(tree), revision], capture_output=True, text=True, check=False
        )
        if added.returncode:
            raise SetUpError(f"revision {revision} cannot be measured: {added.stderr.strip()}")
        try:
            yield tree
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=False)


def measured(tree: Path, benchmark: str) -> tuple[Round, Mapping[str, str]]:
    """The figures that one benchmark of a tree gives, and their units. A bound that fails is no error here."""
    module = "benchmarks" if (tree / "benchmarks").is_dir() else "ci.benchmarks"
    (tree / RESULT).unlink(missing_ok=True)
    subprocess.run(
        [str(tree / "ci" / "python"), "-m", module, "--only", benchmark], cwd=tree, timeout=SECONDS_MAX, check=False
    )
    if not (tree / RESULT).exists():
        raise SetUpError(f"{benchmark} gave no result in {tree}: what it printed says why")
    rows = json.loads((tree / RESULT).read_text(encoding="utf-8"))
    names = [NUMBERED.sub("", row["name"]) for row in rows]
    return (
        {name: row["ours"] for name, row in zip(names, rows, strict=True)},
        {name: row["unit"] for name, row in zip(names, rows, strict=True)},
    )


def differences(ours: Sequence[Round], before: Sequence[Round], units: Mapping[str, str]) -> list[Difference]:
    """The figures that all rounds of both have; what only one of them has cannot be compared."""
    names = [name for name in units if all(name in one for one in (*ours, *before))]
    return [
        Difference(name, units[name], tuple(our[name] for our in ours), tuple(one[name] for one in before))
        for name in names
    ]


def in_turns(tree: Path, benchmark: str, rounds: int) -> list[Difference]:
    """One benchmark, here and there, as many times."""
    ours: list[Round] = []
    before: list[Round] = []
    units: Mapping[str, str] = {}
    for _ in range(rounds):
        here, units = measured(PROJECT, benchmark)
        ours.append(here)
        before.append(measured(tree, benchmark)[0])
    return differences(ours, before, units)


def row(one: Difference) -> str:
    """One line of the table."""
    values = f"{min(one.ours):>9.2f} {min(one.before):>9.2f} {one.unit:<6} {one.ratio:>6.2f}"
    rounds = " ".join(f"{value:.2f}" for value in (*one.ours, *one.before))
    return f"{one.name:<48} {values}  {'WORSE' if one.worse else 'ok':<5}  {rounds}"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.revisions", description=__doc__)
    parser.add_argument("revision", help="the revision to compare with")
    parser.add_argument("--only", action="append", required=True, help="a benchmark that both revisions have")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"how often each is run (default {ROUNDS})")
    arguments = parser.parse_args()
    compared: list[Difference] = []
    try:
        with working_tree(arguments.revision) as tree:
            for benchmark in arguments.only:
                compared += in_turns(tree, benchmark, arguments.rounds)
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    print(f"\n{'':<48} {'ours':>9} {'before':>9} {'':<6} {'ratio':>6}         rounds: ours, before")
    print("\n".join(row(one) for one in compared))
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    REPORT.write_text(json.dumps([asdict(one) for one in compared], indent=1) + "\n", encoding="utf-8")
    worse = sum(one.worse for one in compared)
    print(f"{REPORT.relative_to(PROJECT)}: {worse} of {len(compared)} worse than at {arguments.revision}")
    return 1 if worse or not compared else 0


if __name__ == "__main__":
    sys.exit(main())
