"""Releases of main as their charts render them, now and before.

Each version of a release is rendered once; what main had before is rendered only when something is not as main has it
now. A release that left main counts for REMOVED_SECONDS more, while Argo CD takes it away; settings that main had
before for SETTINGS_SECONDS, while Argo CD replaces them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, overload

from robotkube.delivery.deployment.core.releases import RELEASES, Release, canonical, read_release
from robotkube.delivery.inspection.core.permitted import CHARTS_KIND, SETTINGS_KIND, ReleaseShape, place
from robotkube.delivery.inspection.ports import DeploymentHistory
from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.ports import RenderedObjects

HISTORY_COMMITS_MAX = 300
EARLIER_MAX = 4
RENDERED_MAX = 500
REMOVED_SECONDS = 180.0
SETTINGS_SECONDS = 900.0  # Argo CD looks every 5 min by itself, and tries again what failed

log = logging.getLogger(__name__)

Shape = Mapping[str, Mapping[str, Any]]


class ReleaseShapes:
    """Releases of `repository`'s main, rendered by `objects`; `clock` in seconds. Not for several threads."""

    def __init__(self, repository: DeploymentHistory, objects: RenderedObjects, clock: Callable[[], float]) -> None:
        self._repository = repository
        self._objects = objects
        self._clock = clock
        self._render = lru_cache(RENDERED_MAX)(self._rendered)
        self._tip = ""
        self._releases: dict[str, Release] = {}  # by path
        self._earlier: dict[str, list[tuple[float, Release]]] = {}  # by path, newest first, with when it was replaced
        self._due: float | None = None  # when the next of them counts no more for settings
        self._removed: dict[str, float] = {}
        self._shapes: Mapping[str, Sequence[ReleaseShape]] = {}

    def refresh(self) -> None:
        """Read main, when it has moved, and what could not be rendered the last time. UnavailableError when the forge
        does not answer."""
        tip = self._repository.fetch()
        moved = bool(tip) and tip != self._tip
        if moved:
            if not self._tip:
                self._read_history()
            self._take(self._repository.files(tip, (RELEASES,)))
            self._tip = tip
        now = self._clock()
        ended = [path for path, at in self._removed.items() if now - at > REMOVED_SECONDS]
        for path in ended:
            del self._removed[path]
        unknown = any(shape.unknown for shapes in self._shapes.values() for shape in shapes)
        if moved or ended or unknown or (self._due is not None and now > self._due):
            self._shapes = self._shaped()
            ends = (at + SETTINGS_SECONDS for known in self._earlier.values() for at, _ in known)
            self._due = min((end for end in ends if end >= now), default=None)

    def by_namespace(self) -> Mapping[str, Sequence[ReleaseShape]] | None:
        """The releases by namespace; None before main was read."""
        return self._shapes if self._tip else None

    def _shaped(self) -> dict[str, Sequence[ReleaseShape]]:
        shapes: dict[str, list[ReleaseShape]] = {}
        removed = {path: self._earlier[path][0][1] for path in self._removed if self._earlier.get(path)}
        for path, release in sorted({**removed, **self._releases}.items()):
            shapes.setdefault(release.namespace, []).append(self._shape(path, release))
        return dict(shapes)

    def _shape(self, path: str, release: Release) -> ReleaseShape:
        chart = f"{release.chart}@{release.digest}"
        others = [(at, one) for at, one in self._earlier.get(path, ()) if one != release]
        earlier = _Earlier((one for _, one in others), self._workloads)
        lately = sum(self._clock() - at <= SETTINGS_SECONDS for at, _ in others)
        try:
            return ReleaseShape(release.name, chart, self._workloads(release), earlier, lately=lately)
        except (InputError, UnavailableError) as error:
            return ReleaseShape(release.name, chart, {}, unknown=f"release {release.key}: {error}")

    def _workloads(self, release: Release) -> Shape:
        chart = ChartReference(release.chart, release.version, release.digest)
        return self._render(chart, canonical(release.values), release.plan, release.name, release.namespace)

    def _rendered(self, chart: ChartReference, values: str, plan: str, name: str, namespace: str) -> Shape:
        objects = self._objects(chart, read_json(values), plan, name, namespace)
        kept = [item for item in objects if item.get("kind") in (CHARTS_KIND, SETTINGS_KIND)]
        return {place(str(item["kind"]), str(item["metadata"]["name"])): item for item in kept}

    def _take(self, files: Mapping[str, str]) -> None:
        """Main's files as they are now. One that cannot be read counts as it was: Argo CD keeps it as well."""
        known = {path: earlier[0][1] for path, earlier in self._earlier.items() if earlier} | self._releases
        read = {path: release or known.get(path) for path, release in _read(files)}
        now = {path: release for path, release in read.items() if release is not None}
        for path, release in self._releases.items():
            if now.get(path) != release:
                self._remember(path, release)
        for path in self._releases.keys() - now.keys():
            self._removed[path] = self._clock()
        for path in now:
            self._removed.pop(path, None)
        self._releases = now

    def _remember(self, path: str, release: Release) -> None:
        others = [(at, one) for at, one in self._earlier.get(path, ()) if one != release]
        self._earlier[path] = [(self._clock(), release), *others][:EARLIER_MAX]

    def _read_history(self) -> None:
        """What the last commits brought: a process that starts may meet what is just being replaced."""
        commits = [commit for commit, _ in self._repository.headers("", HISTORY_COMMITS_MAX)]
        for commit in reversed(commits):
            try:
                changes = self._repository.commit(commit).changes
            except DocumentError as error:
                log.warning("deployment history unreadable commit=%s problem=%r", commit[:12], str(error))
                continue
            for path, release in _read({path: text for path, text in changes.items() if text is not None}):
                if release is not None:
                    self._remember(path, release)
            gone = [path for path, text in changes.items() if text is None and path in self._earlier]
            self._removed.update(dict.fromkeys(gone, self._clock()))


def _read(files: Mapping[str, str]) -> Iterator[tuple[str, Release | None]]:
    """Path and release of each release file; None for one that cannot be read."""
    for path, text in files.items():
        if not path.startswith(f"{RELEASES}/") or not path.endswith(".yaml"):
            continue
        try:
            yield path, read_release(text, path)
        except DocumentError as error:
            log.warning("release unusable path=%s problem=%r", path, str(error))
            yield path, None


class _Earlier(Sequence[Shape]):
    """Earlier versions of a release, rendered when somebody asks. One that cannot be rendered is nothing."""

    def __init__(self, releases: Iterable[Release], render: Callable[[Release], Shape]) -> None:
        self._releases = tuple(releases)
        self._render = render

    def __len__(self) -> int:
        return len(self._releases)

    @overload
    def __getitem__(self, index: int) -> Shape: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Shape]: ...
    def __getitem__(self, index: int | slice) -> Shape | Sequence[Shape]:
        if isinstance(index, slice):
            return [self[number] for number in range(len(self))[index]]
        try:
            return self._render(self._releases[index])
        except InputError:
            return {}
