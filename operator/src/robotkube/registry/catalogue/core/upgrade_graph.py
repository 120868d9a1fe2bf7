"""The upgrade graph of a chart: which version upgrades to which, from `replaces` and `skips`.

An edge goes from an older version to one that may take its place. Sound is a graph without cycles in which a way leads
from every version of a channel to the newest one of that channel. A catalogue need not have the whole history: the
oldest version may name what is not there, and so may a version that replaces or skips one that is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from robotkube.registry.catalogue.core.chart_versions import CHANNELS, ChartVersion
from robotkube.registry.catalogue.core.versions import version_key

Problem = tuple[str, str, str]
"""Version, key, text."""


def upgrades(versions: Sequence[ChartVersion]) -> dict[str, tuple[str, ...]]:
    """Version -> the versions that may take its place, oldest first; edges from unknown versions are left out."""
    followers: dict[str, set[str]] = {version.version: set() for version in versions}
    for version in versions:
        for old in (version.replaces, *version.skips):
            if old in followers:
                followers[old].add(version.version)
    return {old: tuple(sorted(new, key=version_key)) for old, new in followers.items()}


def upgrade_problems(versions: Sequence[ChartVersion]) -> Iterator[Problem]:
    """Everything that is wrong with the graph of one chart."""
    edges = upgrades(versions)
    yield from _unknown(versions, edges)
    circle = _on_cycles(edges)
    for version in sorted(circle, key=version_key):
        others = ", ".join(sorted(circle - {version}, key=version_key)) or "itself"
        yield version, "spec.replaces", f"is part of a cycle of upgrades with {others}; let only newer replace older"
    yield from _backwards(versions, circle)
    if not circle:
        yield from _dead_ends(versions, edges)


def _unknown(versions: Sequence[ChartVersion], edges: Mapping[str, Sequence[str]]) -> Iterator[Problem]:
    ordered = sorted(edges, key=version_key)
    known = ", ".join(ordered)
    for version in (version for version in versions if version.version != ordered[0]):
        if version.replaces not in edges and any(skipped in edges for skipped in version.skips):
            continue
        for key, old in [("spec.replaces", version.replaces), *(("spec.skips", skipped) for skipped in version.skips)]:
            if old and old not in edges:
                fix = "name one of them, add its file, or remove the key"
                yield version.version, key, f"there is no version {old} of {version.chart} (there are {known}); {fix}"


def _backwards(versions: Sequence[ChartVersion], circle: set[str]) -> Iterator[Problem]:
    for version in versions:
        for key, old in [("spec.replaces", version.replaces), *(("spec.skips", skipped) for skipped in version.skips)]:
            if old and version.version not in circle and version_key(old) >= version_key(version.version):
                yield version.version, key, f"{old} is not older than {version.version}; name an older version"


def _on_cycles(edges: Mapping[str, Sequence[str]]) -> set[str]:
    """Versions from which a way leads back to themselves."""
    left = _without_ends({version: set(new) for version, new in edges.items()})
    return {version for version in left if version in _reachable(left, left[version])}


def _without_ends(edges: dict[str, set[str]]) -> dict[str, set[str]]:
    """The versions from which a way leads to a cycle."""
    ends = [version for version, new in edges.items() if not new]
    into = _turned(edges)
    left = {version: set(new) for version, new in edges.items()}
    while ends:
        end = ends.pop()
        del left[end]
        for version in into[end]:
            left[version].remove(end)
            if not left[version]:
                ends.append(version)
    return left


def _turned(edges: Mapping[str, set[str]]) -> dict[str, set[str]]:
    predecessors: dict[str, set[str]] = {version: set() for version in edges}
    for version, new in edges.items():
        for other in new:
            predecessors[other].add(version)
    return predecessors


def _reachable(edges: Mapping[str, Sequence[str] | set[str]], start: Sequence[str] | set[str]) -> set[str]:
    seen: set[str] = set()
    waiting = list(start)
    while waiting:
        version = waiting.pop()
        if version not in seen:
            seen.add(version)
            waiting += edges[version]
    return seen


def _dead_ends(versions: Sequence[ChartVersion], edges: Mapping[str, Sequence[str]]) -> Iterator[Problem]:
    into = _turned({version: set(new) for version, new in edges.items()})
    for channel in CHANNELS:
        members = sorted((v.version for v in versions if v.channel == channel), key=version_key)
        if not members:
            continue
        newest = members[-1]
        arriving = _reachable(into, [newest])
        for version in members:
            if version not in arriving:
                text = f"no way of upgrades leads from {version} to {newest}, the newest version of channel {channel}"
                yield version, "spec.version", f"{text}; let a later version name it in `replaces` or `skips`"
