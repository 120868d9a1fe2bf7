"""The plan that repairs a broken main, and what people's edits add to other plans."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256

from robotkube.delivery.deployment.core.commit_messages import REPAIR, REVERT, CommitMessage
from robotkube.delivery.deployment.core.releases import RELEASES, read_tree
from robotkube.delivery.manager.core.plans import Plan
from robotkube.delivery.manager.loops.main_reader import MainReader
from robotkube.registry.charts.core.references import ChartReference

PATHS_NAMED_MAX = 5


def stamp(now_ns: int) -> str:
    """The time as plans' ids begin with it: `YYYYMMDD-HHMMSS` (UTC)."""
    return datetime.fromtimestamp(now_ns / 1e9, UTC).strftime("%Y%m%d-%H%M%S")


class MainRepair:
    """The repair of a broken main. `foreign`: namespaces of other managers' agents, which are theirs to repair."""

    def __init__(self, main: MainReader, foreign: frozenset[str] = frozenset()) -> None:
        self._main = main
        self._foreign = foreign
        self._refused = self._refused_plan = ""

    @property
    def broken(self) -> str:
        """The faults of main in words for a task's status; empty when nothing is broken."""
        tree = self._main.tree
        if not tree.problems:
            return ""
        commits = ", ".join(commit[:12] for commit in self._main.reverted(tree.suspects)) or "unknown"
        named = "; ".join(tree.problems[:PATHS_NAMED_MAX])
        return f"main is broken since commit {commits}: {named}; nothing else is merged until it is repaired"

    def plan(self, now_ns: int) -> Plan | None:
        """The plan that repairs main in this manager's namespaces; None when there is nothing to do, or when the gate
        refused to repair this very commit."""
        if not self._main.tree.problems or self._refused == self._main.tip:
            return None
        files = {path: text for path, text in self._main.repair().items() if self._may_write(path)}
        if not files:
            return None
        base = self._main.tip
        content = "\n".join(f"{path} {text!r}" for path, text in sorted(files.items()))
        identifier = f"{stamp(now_ns)}-{sha256((base + content).encode()).hexdigest()[:6]}"
        return Plan(identifier, base, (), files, self._message(identifier, files))

    def refused(self, plan: Plan) -> None:
        """Note that the gate refused this repair; it is not proposed again for the same commit."""
        self._refused, self._refused_plan = plan.base, plan.id

    def forget(self, plans: Collection[str]) -> None:
        """Repair also what one of these plans was refused for."""
        if self._refused_plan in plans:
            self._refused = self._refused_plan = ""

    def _may_write(self, path: str) -> bool:
        parts = path.split("/")
        return len(parts) != 3 or parts[1] not in self._foreign

    def _message(self, plan: str, files: Mapping[str, str | None]) -> CommitMessage:
        restored = read_tree({path: text for path, text in files.items() if text is not None}).releases
        evidence = {ChartReference(r.chart, r.version, r.digest): r.evidence for r in restored.values()}
        named = sorted(files)[:PATHS_NAMED_MAX]
        return CommitMessage(
            verb="deploy",
            area=REPAIR,
            reason=f"{', '.join(named)} as main had it before",
            plan=plan,
            kinds=(REPAIR,),
            charts=tuple(sorted(evidence)),
            evidence=tuple(evidence[chart] for chart in sorted(evidence)),
            reverts=self._main.reverted(files),
        )

    def describe(self, plan: Plan) -> str:
        """The pull request's body (Markdown)."""
        lines = [f"Plan `{plan.id}` on `{plan.base[:12]}`.", "", "## Broken", ""]
        lines += [f"- {' '.join(problem.split())}" for problem in self._main.tree.problems]
        lines += ["", "## Repaired", ""]
        lines += [f"- `{path}` {'goes' if text is None else 'comes back'}" for path, text in sorted(plan.files.items())]
        lines += ["", *(f"Undoes {commit}." for commit in plan.message.reverts)]
        return "\n".join(lines) + "\n"

    def named(self, plan: Plan) -> Plan:
        """The plan with the commits of people whose edits it writes over."""
        reverts = self._main.reverted(change.path for change in plan.changes)
        if not reverts or plan.message.reverts:
            return plan
        kinds = tuple(sorted({*plan.message.kinds, REVERT}))
        return replace(plan, message=replace(plan.message, kinds=kinds, reverts=reverts))


def repaired(plan: Plan) -> tuple[str, ...]:
    """Keys of the releases that a repair touches."""
    return tuple(
        path.removeprefix(f"{RELEASES}/").removesuffix(".yaml")
        for path in sorted(plan.files)
        if path.startswith(f"{RELEASES}/")
    )
