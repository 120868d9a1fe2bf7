"""Files of the deployment repository as values: HelmRelease, OCIRepository and their YAML text.

    releases/<namespace>/<release>.yaml           HelmRelease    (helm.toolkit.fluxcd.io/v2)
    sources/<namespace>/<chart>-<digest12>.yaml   OCIRepository  (source.toolkit.fluxcd.io/v1)

Reading is strict: every key is known, path and content agree, chart annotation and chartRef agree. What is written here
reads back equal, byte for byte.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import (
    CHARTS_URL,
    DIGEST,
    DOCUMENTS_CACHED_MAX,
    EVIDENCE,
    NAME,
    PLAN,
    TASK,
    TOKEN,
    VERSION,
)
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping

APPLICATION_NAME_MAX = 53  # Helm's bound on release names; the Argo CD Application's name keeps to it as well
RELEASE_API = "helm.toolkit.fluxcd.io/v2"
SOURCE_API = "source.toolkit.fluxcd.io/v1"
RELEASES = "releases"
SOURCES = "sources"
INTERVAL = "10m"


_LISTS = {"tasks": TASK, "events": TOKEN, "rules": TOKEN, "traces": TOKEN, "applications": NAME}
_PARAMETERS = "parameters"
_SINGLE = {"chart": NAME, "chart-version": VERSION, "chart-digest": DIGEST, "plan": PLAN, "evidence": EVIDENCE}


@dataclass(frozen=True, order=True)
class TaskCause:
    """A task that a release or a commit answers: `task` is `<namespace>/<name>`, `application` the one it asked for,
    `parameters` the canonical JSON of the object it asked with."""

    task: str
    event: str
    rule: str
    trace: str
    application: str
    parameters: str = "{}"


@dataclass(frozen=True)
class Release:
    """One release file. `values` are the chart's values (JSON values); `causes` is empty when only the initial
    configuration asks for it; `plan` is the plan that last changed it; `evidence` the digest of the verification
    summary of its chart, or `none`."""

    namespace: str
    name: str
    chart: str
    version: str
    digest: str
    values: Mapping[str, Any]
    causes: tuple[TaskCause, ...] = ()
    plan: str = ""
    evidence: str = "none"

    @property
    def key(self) -> str:
        """`<namespace>/<release>`, as tasks' statuses name it."""
        return f"{self.namespace}/{self.name}"

    @property
    def path(self) -> str:
        """The path of the file in the repository."""
        return f"{RELEASES}/{self.namespace}/{self.name}.yaml"

    @property
    def source_name(self) -> str:
        """Name of the OCIRepository it points to."""
        return source_name(self.chart, self.digest)

    def same_but_plan(self, other: Release) -> bool:
        """Return whether both ask for the same, whichever plan wrote them."""
        return self._content == other._content

    @property
    def _content(self) -> tuple[Any, ...]:
        return (
            self.namespace,
            self.name,
            self.chart,
            self.version,
            self.digest,
            self.evidence,
            self.causes,
            self.values,
        )


@dataclass(frozen=True)
class Source:
    """One OCIRepository file: a chart by manifest digest; `url` is oci://host/organisation/chart."""

    namespace: str
    chart: str
    digest: str
    url: str
    insecure: bool = True

    @property
    def name(self) -> str:
        """Name of the object: chart and the digest's first 12 digits."""
        return source_name(self.chart, self.digest)

    @cached_property
    def path(self) -> str:
        """The path of the file in the repository."""
        return f"{SOURCES}/{self.namespace}/{self.name}.yaml"


ChartOf = tuple[str, str, str]
"""A chart that runs in a namespace: namespace, chart, digest."""


def chart_of(release: Release) -> ChartOf:
    """The chart that a release runs in its namespace."""
    return release.namespace, release.chart, release.digest


@lru_cache(DOCUMENTS_CACHED_MAX)
def source_of(chart: ChartOf, registry: str) -> Source:
    """The source that carries a chart; `registry` is oci://host/organisation."""
    return _one(Source(*chart, f"{registry}/{chart[1]}"))


@lru_cache(DOCUMENTS_CACHED_MAX)
def _one(source: Source) -> Source:
    """One object for equal sources: those of main and those that are needed are compared with each plan."""
    return source


def source_name(chart: str, digest: str) -> str:
    """The name of a chart's OCIRepository: `<chart>-<digest12>`."""
    return f"{chart}-{digest.removeprefix('sha256:')[:12]}"


def application_name(namespace: str, name: str) -> str:
    """Name of the Argo CD Application of a release; DocumentError when it would be longer than allowed."""
    joined = f"{namespace}-{name}"
    if len(joined) > APPLICATION_NAME_MAX:
        problem = f"Argo CD Application name {joined!r} has {len(joined)} characters, at most {APPLICATION_NAME_MAX}"
        raise DocumentError(f"{namespace}/{name}", [f"{problem} are allowed; shorten the release's name"])
    return joined


def write_release(release: Release) -> str:
    """The release file's text."""
    annotations = {
        "chart": release.chart,
        "chart-version": release.version,
        "chart-digest": release.digest,
        "plan": release.plan,
        "evidence": release.evidence,
    }
    if release.causes:
        annotations |= {
            "tasks": " ".join(c.task for c in release.causes),
            "events": " ".join(c.event for c in release.causes),
            "rules": " ".join(c.rule for c in release.causes),
            "traces": " ".join(c.trace for c in release.causes),
            "applications": " ".join(c.application for c in release.causes),
            _PARAMETERS: "[" + ",".join(c.parameters for c in release.causes) + "]",
        }
    return write_mapping(
        {
            "apiVersion": RELEASE_API,
            "kind": "HelmRelease",
            "metadata": {
                "annotations": {f"robotkube.io/{key}": value for key, value in annotations.items()},
                "name": release.name,
                "namespace": release.namespace,
            },
            "spec": {
                "chartRef": {"kind": "OCIRepository", "name": release.source_name},
                "interval": INTERVAL,
                "values": release.values,
            },
        }
    )


def write_source(source: Source) -> str:
    """The source file's text."""
    spec: dict[str, Any] = {"interval": INTERVAL, "ref": {"digest": source.digest}, "url": source.url}
    if source.insecure:
        spec["insecure"] = True
    metadata = {"name": source.name, "namespace": source.namespace}
    return write_mapping({"apiVersion": SOURCE_API, "kind": "OCIRepository", "metadata": metadata, "spec": spec})


@lru_cache(DOCUMENTS_CACHED_MAX)
def read_release(text: str, path: str) -> Release:
    """The release in `text`, found at `path`; DocumentError lists every problem."""
    document = read_mapping(text, path)
    reader = Reader(path)
    metadata, spec = _outer(reader, document, RELEASE_API, "HelmRelease")
    reader.mapping(metadata, "metadata", ["name", "namespace", "annotations"])
    single, causes = _annotations(reader, metadata.get("annotations"))
    reader.mapping(spec, "spec", ["chartRef", "interval", "values"])
    reader.equal(spec.get("interval"), "spec.interval", INTERVAL)
    values = spec.get("values")
    if values is not None and not isinstance(values, Mapping):
        reader.problems.append("spec.values: must be a mapping")
    release = Release(
        namespace=reader.text(metadata.get("namespace"), "metadata.namespace", NAME),
        name=reader.text(metadata.get("name"), "metadata.name", NAME),
        chart=single["chart"],
        version=single["chart-version"],
        digest=single["chart-digest"],
        values=values if isinstance(values, Mapping) else {},
        causes=causes,
        plan=single["plan"],
        evidence=single["evidence"],
    )
    reader.equal(spec.get("chartRef"), "spec.chartRef", {"kind": "OCIRepository", "name": release.source_name})
    if not reader.problems:
        reader.equal(path, "path", release.path)
        application_name(release.namespace, release.name)
    reader.finish()
    return release


def _outer(
    reader: Reader, document: Mapping[str, Any], api: str, kind: str
) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    reader.mapping(document, "", ["apiVersion", "kind", "metadata", "spec"])
    reader.equal(document.get("apiVersion"), "apiVersion", api)
    reader.equal(document.get("kind"), "kind", kind)
    metadata = document.get("metadata")
    spec = document.get("spec")
    return (metadata if isinstance(metadata, Mapping) else {}), (spec if isinstance(spec, Mapping) else {})


def _annotations(reader: Reader, value: Any) -> tuple[dict[str, str], tuple[TaskCause, ...]]:
    prefix = "robotkube.io/"
    path = "metadata.annotations"
    annotations = reader.mapping(
        value if value is not None else {},
        path,
        [prefix + k for k in _SINGLE],
        [prefix + k for k in (*_LISTS, _PARAMETERS)],
    )
    single = {
        key: reader.text(annotations.get(prefix + key), f"{path}.{prefix}{key}", pattern)
        for key, pattern in _SINGLE.items()
    }
    lists = {
        key: _words(reader, annotations.get(prefix + key), f"{path}.{prefix}{key}", pattern)
        for key, pattern in _LISTS.items()
    }
    lists[_PARAMETERS] = _objects(reader, annotations.get(prefix + _PARAMETERS), f"{path}.{prefix}{_PARAMETERS}")
    if len({len(words) for words in lists.values()}) > 1:
        counts = ", ".join(f"{key} {len(words)}" for key, words in lists.items())
        reader.problems.append(
            f"{path}: tasks, events, rules, traces, applications and parameters must be equally many, found {counts}"
        )
        return single, ()
    order = ("tasks", "events", "rules", "traces", "applications", _PARAMETERS)
    return single, tuple(TaskCause(*row) for row in zip(*(lists[key] for key in order), strict=True))


def _words(reader: Reader, value: Any, path: str, pattern: re.Pattern[str]) -> list[str]:
    if value is None:
        return []
    if not isinstance(value, str) or not value:
        reader.problems.append(f"{path}: must be words separated by single spaces")
        return []
    return [reader.text(word, path, pattern) for word in value.split(" ")]


def canonical(value: Mapping[str, Any]) -> str:
    """The one JSON text of a mapping: keys sorted, no spaces, ASCII only."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _objects(reader: Reader, value: Any, path: str) -> list[str]:
    """A JSON list of objects, each as its canonical text; the whole must be written canonically itself."""
    if value is None:
        return []
    try:
        parsed = read_json(value) if isinstance(value, str) else None
        objects = [canonical(item) for item in parsed] if isinstance(parsed, list) else []
    except (ValueError, TypeError):
        objects = []
    if not objects or not all(text.startswith("{") for text in objects) or value != "[" + ",".join(objects) + "]":
        reader.problems.append(f"{path}: must be a JSON list of objects, keys sorted, without spaces")
        return []
    return objects


@lru_cache(DOCUMENTS_CACHED_MAX)
def read_source(text: str, path: str) -> Source:
    """The source in `text`, found at `path`; DocumentError lists every problem."""
    document = read_mapping(text, path)
    reader = Reader(path)
    metadata, spec = _outer(reader, document, SOURCE_API, "OCIRepository")
    reader.mapping(metadata, "metadata", ["name", "namespace"])
    reader.mapping(spec, "spec", ["interval", "ref", "url"], ["insecure"])
    reader.equal(spec.get("interval"), "spec.interval", INTERVAL)
    reference = reader.mapping(spec.get("ref") or {}, "spec.ref", ["digest"])
    url = reader.text(spec.get("url"), "spec.url", CHARTS_URL)
    if not isinstance(spec.get("insecure", False), bool):
        reader.problems.append("spec.insecure: must be true or false")
    source = Source(
        namespace=reader.text(metadata.get("namespace"), "metadata.namespace", NAME),
        chart=url.rpartition("/")[2],
        digest=reader.text(reference.get("digest"), "spec.ref.digest", DIGEST),
        url=url,
        insecure=spec.get("insecure", False) is True,
    )
    reader.equal(metadata.get("name"), "metadata.name", source.name)
    if not reader.problems:
        reader.equal(path, "path", source.path)
    reader.finish()
    return _one(source)


@dataclass(frozen=True)
class Tree:
    """The two folders of the deployment repository by path; `problems` are of files that could not be read or that
    contradict others, `suspects` the paths concerned, both sides of a contradiction (a file that is missing, too)."""

    releases: Mapping[str, Release]
    sources: Mapping[str, Source]
    problems: tuple[str, ...] = ()
    suspects: tuple[str, ...] = ()

    @cached_property
    def users(self) -> Mapping[ChartOf, int]:
        """The number of releases in a namespace that run each chart."""
        return Counter(map(chart_of, self.releases.values()))

    def wrong_sources(self, registry: str) -> tuple[Mapping[ChartOf, Source], frozenset[str]]:
        """The sources that the releases need (charts are in `registry`, oci://host/organisation) and that are missing
        or other than that; the paths of those that nothing needs."""
        if registry not in self._wrong:
            needed = {chart: source_of(chart, registry) for chart in self.users}
            present = ((chart, source, self.sources.get(source.path)) for chart, source in needed.items())
            wrong = {chart: source for chart, source, now in present if now is not source and now != source}
            self._wrong[registry] = wrong, frozenset(self.sources) - {source.path for source in needed.values()}
        return self._wrong[registry]

    @cached_property
    def _wrong(self) -> dict[str, tuple[Mapping[ChartOf, Source], frozenset[str]]]:
        return {}


def read_tree(files: Mapping[str, str]) -> Tree:
    """The tree of the files below releases/ and sources/ (path -> text). Broken files and broken relations become
    problems: a missing source, two releases with one Argo CD Application name, a path that is not a release or source
    file."""
    releases: dict[str, Release] = {}
    sources: dict[str, Source] = {}
    problems: list[tuple[str, Sequence[str]]] = []
    for path in sorted(path for path in files if not path.endswith("/.gitkeep")):
        try:
            if path.startswith(f"{RELEASES}/"):
                releases[path] = read_release(files[path], path)
            elif path.startswith(f"{SOURCES}/"):
                sources[path] = read_source(files[path], path)
        except DocumentError as error:
            problems += [(f"{error.where}: {problem}", [path]) for problem in error.problems]
    problems += _relations(releases, sources)
    suspects = {path for _, paths in problems for path in paths}
    return Tree(releases, sources, tuple(text for text, _ in problems), tuple(sorted(suspects)))


def _relations(releases: Mapping[str, Release], sources: Mapping[str, Source]) -> list[tuple[str, Sequence[str]]]:
    problems: list[tuple[str, Sequence[str]]] = []
    names: dict[str, str] = {}
    for path, release in releases.items():
        wanted = f"{SOURCES}/{release.namespace}/{release.source_name}.yaml"
        source = sources.get(wanted)
        if source is None:
            problems.append((f"{path}: its source {wanted} is missing or not readable", [path, wanted]))
        elif source.digest != release.digest:
            text = f"{path}: chart digest {release.digest} differs from {wanted} ({source.digest})"
            problems.append((text, [path, wanted]))
        name = application_name(release.namespace, release.name)
        if name in names:
            text = f"{path}: Argo CD Application name {name!r} is taken by {names[name]}; rename one release"
            problems.append((text, [path, names[name]]))
        names.setdefault(name, path)
    return problems
