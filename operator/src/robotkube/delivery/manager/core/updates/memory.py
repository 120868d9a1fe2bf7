"""The memory of updates: what main's commits say about those that were made and taken back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Self

from robotkube.delivery.deployment.core.releases import Release

Pin = tuple[str, str]
"""Chart and version."""


@dataclass(frozen=True)
class ChartUpdate:
    """The last update of a chart on main: its target, per release what it replaced, when (ns since 1970) and by which
    commit, and its commits."""

    version: str
    digest: str
    before: Mapping[str, Pin] = field(default_factory=dict)
    at_ns: Mapping[str, int] = field(default_factory=dict)
    commits: tuple[str, ...] = ()
    made_by: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class UpdateMemory:
    """The updates in main's commits: the last run by chart; digests that were reverted, with the reason; `kept_back`:
    digest -> namespaces of the agents for whom alone it was taken back, with the reason."""

    runs: Mapping[str, ChartUpdate] = field(default_factory=dict)
    barred: Mapping[str, str] = field(default_factory=dict)
    kept_back: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def updated(self, chart: str, target: tuple[str, str], before: Mapping[str, Pin], made: tuple[str, int]) -> Self:
        """The memory after a commit that updated the releases in `before` to `target` (version and digest); `made` is
        the commit's id and its time in ns."""
        known = self.runs.get(chart)
        run = known if known is not None and known.digest == target[1] else ChartUpdate(*target)
        times = {**run.at_ns, **dict.fromkeys(before, made[1])}
        made_by = {**run.made_by, **dict.fromkeys(before, made[0])}
        run = ChartUpdate(*target, {**run.before, **before}, times, (*run.commits, made[0]), made_by)
        return replace(self, runs={**self.runs, chart: run})

    def reverted(self, chart: str, keys: Iterable[str], why: str) -> Self:
        """The memory after a commit that reverted the last update of a chart for `keys`; its others are still due."""
        run = self.runs.get(chart)
        if run is None:
            return self
        left = {key: pin for key, pin in run.before.items() if key not in set(keys)}
        return replace(
            self, runs={**self.runs, chart: replace(run, before=left)}, barred={**self.barred, run.digest: why}
        )

    def taken_back(self, chart: str, keys: Iterable[str], why: str) -> Self:
        """The memory after a commit that took the last update of a chart back for the agents of `keys` alone."""
        run = self.runs.get(chart)
        gone = set(keys) & set(run.before) if run is not None else set()
        if run is None or not gone:
            return self
        left = {key: pin for key, pin in run.before.items() if key not in gone}
        agents = dict.fromkeys((key.partition("/")[0] for key in gone), why)
        kept_back = {**self.kept_back, run.digest: {**self.kept_back.get(run.digest, {}), **agents}}
        return replace(self, runs={**self.runs, chart: replace(run, before=left)}, kept_back=kept_back)

    def keeps_back(self, digest: str, release: Release) -> str:
        """The reason why the release's agent does not get this digest again; empty when it may."""
        return self.kept_back.get(digest, {}).get(release.namespace, "")

    def policy_changed(self) -> Self:
        """The memory after people changed policies/updates.yaml: what was reverted may be tried again."""
        return replace(self, barred={}, kept_back={})
