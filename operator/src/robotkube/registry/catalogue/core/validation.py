"""Every mistake in the sources of a catalogue, all at once: each with its file, its key and how to repair it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.wrong_keys import NOTHING_WRONG, WrongKeys, wrong_keys
from robotkube.registry.catalogue.core.applications import Application, ChartRequirement, read_application_partly
from robotkube.registry.catalogue.core.catalogue import RELEASE_POLICY, VERIFICATION_POLICY, read_release_policy
from robotkube.registry.catalogue.core.chart_validation import (
    chart_problems,
    folder_findings,
    interface_names,
    readable_parts,
)
from robotkube.registry.catalogue.core.chart_versions import ChartVersion, read_chart_version_partly
from robotkube.registry.catalogue.core.guarantees import shortfall
from robotkube.registry.catalogue.core.message_types.carried import link_problems
from robotkube.registry.catalogue.core.sources import CatalogueSources, ChartFolder, SourceProblem, Tools, findings_of
from robotkube.registry.catalogue.core.template_validation import application_problems, name_problems
from robotkube.registry.catalogue.core.upgrade_graph import upgrade_problems
from robotkube.registry.catalogue.core.versions import in_range, version_key
from robotkube.registry.evidence.core.verification_policy import read_verification_policy

COMPARED = (
    "metadata",
    "path",
    *(f"spec.{key}" for key in ("version", "channel", "replaces", "skips", "provides", "guarantees")),
)
"""Keys of a chart version by which other documents are judged."""
BESIDES = ("README.md", "schemas/")
APPLICATION_FORMAT = "application"
"""`format` of a parameter whose value names an application of the catalogue."""


@dataclass
class _Readable:
    """What could be read; `broken` are charts of which a file could not, `partly` documents that could in part, with
    their keys that are wrong, by path."""

    applications: dict[str, Application] = field(default_factory=dict)
    charts: dict[str, list[ChartVersion]] = field(default_factory=dict)
    broken: set[str] = field(default_factory=set)
    names: set[str] = field(default_factory=set)
    partly: dict[str, tuple[Application | ChartVersion, WrongKeys]] = field(default_factory=dict)

    def is_compared(self, path: str) -> bool:
        """Return whether of a chart version that could be read in part nothing is wrong by which others are judged."""
        return path in self.partly and not any(map(self.partly[path][1].touch, COMPARED))


Tried = dict[str, list[tuple[str, str]]]
"""Text of an application -> what its templates said, without folders of charts: then nothing but the text decides."""


def validate_sources(sources: CatalogueSources, tools: Tools, tried: Tried | None = None) -> list[SourceProblem]:
    """The findings, by file, in the order in which the keys are checked. What was `tried` already is not tried again,
    and what is tried is added; only where there are no folders of charts."""
    tried = {} if tried is None or sources.folders else tried
    findings = list(sources.findings)
    readable = _Readable()
    for path in sorted(sources.files):
        findings += _read(path, sources, readable)
    findings += [sources.finding(path, "file", "missing; write it") for path in _missing(sources)]
    for application in readable.applications.values():
        path = f"applications/{application.name}.yaml"
        problems = _application(path, application, NOTHING_WRONG, readable, sources, tools, tried)
        findings += [sources.finding(path, key, text) for key, text in problems]
    for chart, versions in readable.charts.items():
        findings += _versions(chart, versions, readable, sources, tools)
    for path in readable.partly:
        findings += [sources.finding(path, *problem) for problem in _part(path, readable, sources, tools)]
    findings += folder_findings(sources, readable.charts, readable.broken)
    return sorted(dict.fromkeys(findings), key=lambda finding: finding.file)


def _read(path: str, sources: CatalogueSources, readable: _Readable) -> list[SourceProblem]:
    text = sources.files[path]
    parts = path.removesuffix(".yaml").split("/")
    try:
        if not path.endswith(".yaml"):
            return _foreign(path, sources)
        if parts[0] == "applications" and len(parts) == 2:
            readable.names.add(parts[1])
            _read_application(text, path, parts[1], readable)
        elif parts[0] == "charts" and len(parts) == 3:
            _read_chart_version(text, path, parts[1], readable)
        elif path == RELEASE_POLICY:
            read_release_policy(text, path)
        elif path == VERIFICATION_POLICY:
            read_verification_policy(text, path)
        else:
            return _foreign(path, sources)
    except DocumentError as error:
        if parts[0] == "charts" and not readable.is_compared(path):
            readable.broken.add(parts[1])
        return findings_of(sources, path, error)
    return []


def _read_application(text: str, path: str, name: str, readable: _Readable) -> None:
    """Note the application, or the parts of it that can be read; DocumentError names what cannot."""
    application, problems = read_application_partly(text, path)
    if problems:
        readable.partly[path] = application, wrong_keys(problems)
        raise DocumentError(path, problems)
    readable.applications[name] = application


def _read_chart_version(text: str, path: str, chart: str, readable: _Readable) -> None:
    """Note the chart version, or the parts of it that can be read; DocumentError names what cannot."""
    version, problems = read_chart_version_partly(text, path, False)
    if problems:
        readable.partly[path] = version, wrong_keys(problems)
    if not problems or readable.is_compared(path):
        readable.charts.setdefault(chart, []).append(version)
    if problems:
        raise DocumentError(path, problems)


def _foreign(path: str, sources: CatalogueSources) -> list[SourceProblem]:
    if path in BESIDES or path.startswith(BESIDES):
        return []
    places = (
        "applications/<name>.yaml, charts/<chart>/<version>.yaml, policies/release.yaml, policies/verification.yaml"
    )
    return [sources.finding(path, "file", f"is none of {places}; move it or remove it")]


def _missing(sources: CatalogueSources) -> list[str]:
    return [path for path in (RELEASE_POLICY, VERIFICATION_POLICY) if path not in sources.files]


def _part(path: str, readable: _Readable, sources: CatalogueSources, tools: Tools) -> Iterator[tuple[str, str]]:
    """Mistakes in the parts of a document that could be read."""
    document, wrong = readable.partly[path]
    if isinstance(document, Application):
        return wrong.free(_application(path, document, wrong, readable, sources, tools, {}))
    _, chart, file = path.split("/")
    folder = sources.folders.get(chart)
    same = folder if folder and folder.version == file.removesuffix(".yaml") else None
    of_parts = chart_problems(readable_parts(document, wrong), same, tools)
    return wrong.free([*interface_names(document, tools), *of_parts])


def _application(
    path: str,
    application: Application,
    wrong: WrongKeys,
    readable: _Readable,
    sources: CatalogueSources,
    tools: Tools,
    tried: Tried,
) -> Iterator[tuple[str, str]]:
    broken = [problem.removeprefix("schema: ") for problem in tools.check_schema(application.parameters)]
    yield from (("spec.parameters", f"no JSON Schema: {problem:.300}; correct it") for problem in broken)
    folders: dict[str, Sequence[ChartFolder]] = {}
    for index, service in enumerate(application.services):
        if wrong.touch(f"spec.services[{index}].chart"):
            continue
        problems = list(_requirement(service.chart, readable))
        yield from ((f"spec.services[{index}].chart{key}", text) for key, text in problems)
        folders[service.name] = _folders(service.chart, readable, sources)
    if not application.services and not application.links:
        yield "spec.services", "neither services nor links: a task for it would ask for nothing; add one"
    yield from _bridging(application, readable)
    yield from link_problems(application)
    if broken:
        yield from name_problems(application, tools, wrong)
        return
    yield from _own_values(application.parameters, tools)
    yield from _named_applications(application.parameters, readable)
    text = sources.files[path]
    if text not in tried:
        tried[text] = application_problems(application, folders, tools, wrong)
    yield from tried[text]


def _own_values(parameters: Mapping[str, Any], tools: Tools) -> Iterator[tuple[str, str]]:
    """Defaults and examples that the parameters' own schema refuses: a task without the parameter would be refused."""
    shared = {key: parameters[key] for key in ("$defs", "definitions") if key in parameters}
    for name, schema in parameters.get("properties", {}).items():
        if not isinstance(schema, Mapping):
            continue
        given = [("default", schema["default"])] if "default" in schema else []
        given += [(f"examples[{index}]", one) for index, one in enumerate(schema.get("examples", ()))]
        for key, value in given:
            for problem in tools.validate({**schema, **shared}, value)[:1]:
                yield f"spec.parameters.properties.{name}.{key}", f"{problem:.300}; correct it, or the schema beside it"


def _requirement(wanted: ChartRequirement, readable: _Readable) -> Iterator[tuple[str, str]]:
    """Problems of a requirement that no version of any chart meets."""
    if readable.broken and (not wanted.name or wanted.name in readable.broken):
        return
    if wanted.name:
        candidates = readable.charts.get(wanted.name, [])
        where = f"chart {wanted.name}"
        charts = ", ".join(sorted(readable.charts)) or "none"
        if not candidates:
            yield ".name", f"there is no chart {wanted.name!r} (there are: {charts}); name one of them or add its file"
    else:
        candidates = [v for versions in readable.charts.values() for v in versions if wanted.provides in v.provides]
        where = f"a chart that provides {wanted.provides}"
        given = (
            ", ".join(sorted({word for c in readable.charts.values() for v in c for word in v.provides})) or "nothing"
        )
        if not candidates:
            yield ".provides", f"no chart provides {wanted.provides!r} (there is: {given}); use or add one that does"
    matching = [version for version in candidates if in_range(version.version, wanted.version)]
    if candidates and not matching:
        versions = ", ".join(sorted({v.version for v in candidates}, key=version_key))
        yield ".version", f"no version of {where} is in {wanted.version!r} (there are {versions}); widen the range"
    if matching:
        yield from _guarantees(wanted, matching)


def _guarantees(wanted: ChartRequirement, matching: Sequence[ChartVersion]) -> Iterator[tuple[str, str]]:
    for index, requirement in enumerate(wanted.requirements):
        missing = [(v, shortfall(requirement, v.guarantees)) for v in matching]
        if all(text for _, text in missing):
            reasons = "; ".join(f"{version.chart} {version.version} {text}" for version, text in missing[:5])
            yield f".requirements[{index}]", f"no version meets {requirement}: {reasons}; ask for less or add a version"


def _folders(wanted: ChartRequirement, readable: _Readable, sources: CatalogueSources) -> list[ChartFolder]:
    """The charts next to the registry that the service may get."""
    folders = []
    for folder in sources.folders.values():
        if not in_range(folder.version, wanted.version):
            continue
        version = next((v for v in readable.charts.get(folder.name, ()) if v.version == folder.version), None)
        if version is None:
            if wanted.name == folder.name and folder.name in readable.broken:
                folders.append(folder)
        elif wanted.name == folder.name or (wanted.provides and wanted.provides in version.provides):
            folders.append(_with_entry(folder, version, readable))
    return folders


def _with_entry(folder: ChartFolder, version: ChartVersion, readable: _Readable) -> ChartFolder:
    """The folder with what can be read of the entry."""
    path = f"charts/{version.chart}/{version.version}.yaml"
    if path in readable.partly:
        version = readable_parts(version, readable.partly[path][1])
    return replace(folder, interfaces=version.interfaces, entry_images=version.images)


def _bridging(application: Application, readable: _Readable) -> Iterator[tuple[str, str]]:
    if application.bridges and len(application.services) != 1:
        text = f"a bridge needs exactly one service, has {len(application.services)}"
        yield "spec.services", f"{text}; keep one or do not provide link/{application.bridges[0]}"
    for index, link in enumerate(application.links):
        names = sorted(a.name for a in readable.applications.values() if link.kind in a.bridges)
        if link.kind != "ros" and len(names) != 1 and readable.names == set(readable.applications):
            text = f"exactly one application must provide link/{link.kind}, found {', '.join(names) or 'none'}"
            yield f"spec.links[{index}].kind", f"{text}; add it or remove the others"


def _named_applications(parameters: Mapping[str, Any], readable: _Readable) -> Iterator[tuple[str, str]]:
    properties = parameters.get("properties")
    for name, schema in (properties if isinstance(properties, Mapping) else {}).items():
        if not isinstance(schema, Mapping) or schema.get("format") != APPLICATION_FORMAT:
            continue
        for key in ("default", "const", "enum", "examples"):
            values = schema.get(key, [])
            for value in values if isinstance(values, list) else [values]:
                if value not in readable.names:
                    known = ", ".join(sorted(readable.names))
                    text = f"there is no application {value!r:.60} (there are {known}); name one of them"
                    yield f"spec.parameters.properties.{name}.{key}", text


def _versions(
    chart: str, versions: Sequence[ChartVersion], readable: _Readable, sources: CatalogueSources, tools: Tools
) -> Iterator[SourceProblem]:
    for version in versions:
        path = f"charts/{chart}/{version.version}.yaml"
        if path in readable.partly:
            continue
        folder = sources.folders.get(chart)
        same = folder if folder and folder.version == version.version else None
        for key, text in chart_problems(version, same, tools):
            yield sources.finding(path, key, text)
    if chart not in readable.broken:
        for number, key, text in upgrade_problems(versions):
            yield sources.finding(f"charts/{chart}/{number}.yaml", key, text)
