"""The gate's checks of a submission before its suites run: all problems at once, each a sentence for its author.

A submission is one commit of a publisher on main of the catalogue repository, this one or an earlier one:

    charts/<chart>/<version>.yaml                              an entry with `status: {state: staged, digest, images}`
    applications/<name>.yaml                                   an application
    evidence/<chart>/<version>_<digest12>/<suite>.json         kept from an earlier publication of the same digest

Nothing else may be touched, nothing removed. Only what the submission brings counts against it, not what main had
wrong before.
"""

from __future__ import annotations

import json
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import IMAGE_PARTS, NAME, SUITE_NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping
from robotkube.foundation.forge.core.trailers import APPROVED_BY, PULL_REQUEST, trailer
from robotkube.registry.catalogue.core.catalogue import read_chart_version
from robotkube.registry.catalogue.core.sources import CatalogueSources, SourceProblem, Tools
from robotkube.registry.catalogue.core.validation import Tried, validate_sources
from robotkube.registry.charts.core.packing import ENTRY_ANNOTATION, IMAGES_FILE, PulledChart, build_tag, entry_digest
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.statements import Artefact
from robotkube.registry.evidence.core.verification_policy import PATH as POLICY
from robotkube.registry.evidence.core.verification_policy import read_verification_policy

APPLICATIONS, CHARTS, EVIDENCE, POLICIES, KEYS = "applications", "charts", "evidence", "policies", "keys"
READ_FOLDERS = (APPLICATIONS, CHARTS, POLICIES)
CHARTS_MAX = 50  # of one submission; further ones go into another
SCHEMA_FILE, VALUES_FILE = "values.schema.json", "values.yaml"
TOPIC = "submit-"

STAGING = "staging"
"""The organisation of the OCI registry from which charts are tried; the gate alone writes it."""

OWN_IMAGES = "own-images"
"""The organisation of the OCI registry from which nodes pull images of publishers; the gate alone writes it."""

_EVIDENCE_FILE = re.compile(rf"evidence/{NAME.pattern}/[^/]+_[0-9a-f]{{12}}/{SUITE_NAME.pattern}\.json", re.ASCII)
_STATUS_KEYS = ("state", "digest", "images")


def publisher_place(staging: str, account: str) -> str:
    """The organisation of the OCI registry that this publisher alone writes: `staging-publisher`. What is submitted is
    pushed there, and the gate copies it to `staging`."""
    return f"{staging}-{account.lower()}"


def pushed_place(staging: str, account: str) -> str:
    """The place to which a publisher pushes images: `staging-publisher/images`; the gate copies those of a submission
    to `own-images`, by digest, so that what nodes pull stays whatever the publisher deletes."""
    return f"{publisher_place(staging, account)}/images"


def own_images(references: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Name and digest of those images that are publishers' own: `<host>/own-images/<name>@<digest>`."""
    for text in references:
        match = IMAGE_PARTS.fullmatch(text)
        organisation, _, name = match[2].partition("/") if match else ("", "", "")
        if match and organisation == OWN_IMAGES and name:
            yield name, match[3]


@dataclass(frozen=True)
class SubmittedChart:
    """An entry of a submission; `document` is the whole ChartVersion document."""

    chart: str
    version: str
    digest: str
    images: tuple[str, ...]
    platforms: tuple[str, ...]
    document: Mapping[str, Any]

    @property
    def name(self) -> str:
        """`mqtt-bridge 0.1.0`."""
        return f"{self.chart} {self.version}"

    @property
    def path(self) -> str:
        """Path of the entry in the catalogue."""
        return f"{CHARTS}/{self.chart}/{self.version}.yaml"

    @property
    def reference(self) -> ChartReference:
        """The chart as trailers name it."""
        return ChartReference(self.chart, self.version, self.digest)

    @property
    def tag(self) -> str:
        """Its tag in the OCI registry, in both organisations."""
        return build_tag(self.version, self.digest)

    @property
    def artefact(self) -> Artefact:
        """The chart as evidence names it."""
        return Artefact(self.chart, self.version, self.digest, self.platforms[0])

    @property
    def spec(self) -> Mapping[str, Any]:
        """The entry's spec."""
        spec: Mapping[str, Any] = self.document["spec"]
        return spec


@dataclass(frozen=True)
class Proposed:
    """A commit and where main stands: `changes` path -> new text (None = removed) against its parent, `irregular`
    paths that are not ordinary text files, `on_main` whether its parent is main's tip or an ancestor; `base` and
    `main` are the catalogue's files in the parent and at main's tip."""

    parents: tuple[str, ...]
    changes: Mapping[str, str | None]
    irregular: tuple[str, ...]
    on_main: bool
    base: Mapping[str, str]
    main: Mapping[str, str]


@dataclass(frozen=True)
class Submission:
    """A submission as the catalogue alone shows it. `applications` path -> text; `evidence` path -> text, kept
    by the submitter."""

    charts: tuple[SubmittedChart, ...] = ()
    applications: Mapping[str, str] = field(default_factory=dict)
    evidence: Mapping[str, str] = field(default_factory=dict)
    problems: tuple[str, ...] = ()

    @property
    def names(self) -> str:
        """The names of its charts and applications, as one text."""
        names = [chart.name for chart in self.charts]
        names += [f"application {path.removesuffix('.yaml').rpartition('/')[2]}" for path in self.applications]
        return ", ".join(names) or "nothing"


def read_submission(proposed: Proposed, local_builds: bool, tools: Tools) -> Submission:
    """The submission with every problem that the catalogue shows; `local_builds` lets a version have a new digest;
    `tools` are what validation needs."""
    problems = [*_commit_problems(proposed), *_path_problems(proposed)]
    charts: list[SubmittedChart] = []
    for path, text in sorted(_below(proposed.changes, CHARTS).items()):
        try:
            charts.append(read_entry(text, path))
        except DocumentError as error:
            problems += [f"{error.where}: {problem}" for problem in error.problems]
    problems += _evidence_problems(proposed, charts)
    problems += _version_problems(charts, proposed.main, local_builds)
    problems += _consistency_problems(proposed, problems, tools)
    if len(charts) > CHARTS_MAX:
        problems.append(f"{len(charts)} chart versions; at most {CHARTS_MAX} in one submission, submit the rest next")
    applications = _below(proposed.changes, APPLICATIONS)
    evidence = _below(proposed.changes, EVIDENCE)
    return Submission(tuple(charts), applications, evidence, tuple(dict.fromkeys(problems)))


def _below(changes: Mapping[str, str | None], folder: str) -> dict[str, str]:
    return {path: text for path, text in changes.items() if text is not None and path.startswith(f"{folder}/")}


def _commit_problems(proposed: Proposed) -> Iterable[str]:
    if len(proposed.parents) != 1:
        yield f"the commit has {len(proposed.parents)} parents; it must have exactly one, a commit of main"
    elif not proposed.on_main:
        yield "the commit's parent is not on main; submit one commit on main's tip"
    if not proposed.changes and not proposed.irregular:
        yield "the commit changes nothing"


def _path_problems(proposed: Proposed) -> Iterable[str]:
    for path in proposed.irregular:
        yield f"{path}: not an ordinary text file (a link, a program, binary or too long)"
    for path, text in sorted(proposed.changes.items()):
        parts = path.split("/")
        if not _may_touch(parts):
            yield (
                f"{path}: a publisher may only touch {CHARTS}/<chart>/<version>.yaml, {APPLICATIONS}/<name>.yaml and "
                f"{EVIDENCE}/<chart>/<version>_<digest12>/<suite>.json; leave this file out"
            )
        elif text is None:
            yield f"{path}: a publisher removes nothing; ask a person who may write the catalogue"


def _may_touch(parts: Sequence[str]) -> bool:
    if parts[0] == CHARTS:
        return len(parts) == 3 and parts[2].endswith(".yaml")
    if parts[0] == APPLICATIONS:
        return len(parts) == 2 and parts[1].endswith(".yaml")
    return _EVIDENCE_FILE.fullmatch("/".join(parts)) is not None


def read_entry(text: str, path: str) -> SubmittedChart:
    """An entry as submitted: a ChartVersion with `status: {state: staged, digest, images}`; DocumentError otherwise."""
    version = read_chart_version(text, path)
    document = read_mapping(text, path)
    reader = Reader(path)
    status = reader.mapping(document.get("status") or {}, "status", _STATUS_KEYS)
    if status.get("state") != "staged":
        reader.problems.append(
            f"status.state: {status.get('state')!r} must be 'staged'; only the gate calls a version verified"
        )
    images = reader.sequence(status.get("images"), "status.images")
    if any(not isinstance(image, str) for image in images):
        reader.problems.append("status.images: must be a list of references (repository@sha256:...)")
    platforms = reader.sequence(document["spec"].get("platforms"), "spec.platforms")
    if len(platforms) != 1 or not isinstance(platforms[0], str):
        reader.problems.append("spec.platforms: name exactly one; suites run on one platform")
    reader.finish()
    return SubmittedChart(version.chart, version.version, version.digest, tuple(images), tuple(platforms), document)


def is_published(chart: SubmittedChart, main: Mapping[str, str]) -> bool:
    """Return whether main has the version as verified with this digest and this spec, under the policy that main has
    now. Its evidence is not checked."""
    status, spec = _published(chart.path, main)
    try:
        policy = read_verification_policy(main.get(POLICY, ""), POLICY).digest
    except DocumentError:
        return False
    wanted = ("verified", chart.digest, policy)
    return (status.get("state"), status.get("digest"), status.get("policy")) == wanted and spec == chart.spec


def _published(path: str, main: Mapping[str, str]) -> tuple[Mapping[str, Any], Any]:
    """Status and spec of an entry on main; empty when there is none that can be read."""
    if path not in main:
        return {}, None
    try:
        document = read_mapping(main[path], path)
    except DocumentError:
        return {}, None
    status = document.get("status")
    return (status if isinstance(status, dict) else {}), document.get("spec")


def _version_problems(charts: Sequence[SubmittedChart], main: Mapping[str, str], local_builds: bool) -> Iterable[str]:
    for chart in charts:
        status, _ = _published(chart.path, main)
        if not status:
            continue
        if status.get("digest") != chart.digest:
            if not local_builds:
                yield (
                    f"{chart.path}: {chart.version} is published with digest {status.get('digest')}, this is "
                    f"{chart.digest}; a version is never replaced: raise `version` in Chart.yaml and in the entry"
                )
        elif status.get("state") == "withdrawn":
            yield f"{chart.path}: {chart.name} was withdrawn; a person has to revert the withdrawal first"


def _evidence_problems(proposed: Proposed, charts: Sequence[SubmittedChart]) -> Iterable[str]:
    folders = {chart.artefact.folder for chart in charts}
    for path in _below(proposed.changes, EVIDENCE):
        if path.rpartition("/")[0] not in folders and _EVIDENCE_FILE.fullmatch(path):
            yield f"{path}: belongs to no chart digest of this submission; leave it out"


def _consistency_problems(proposed: Proposed, known: Sequence[str], tools: Tools) -> Iterable[str]:
    """Problems that the catalogue has after the submission and did not have before."""
    for path, text in sorted(_below(proposed.changes, APPLICATIONS).items()):
        if proposed.main.get(path) not in (proposed.base.get(path), text):
            yield f"{path}: changed on main since the commit's parent; submit again on main's tip"
    changed = {**_below(proposed.changes, CHARTS), **_below(proposed.changes, APPLICATIONS)}
    reported = tuple(path for path in changed if any(problem.startswith(f"{path}: ") for problem in known))
    problems = new_findings(proposed.main, {**proposed.main, **changed}, changed, tools)
    yield from (f"{path}: {text}" for path, text in problems if path not in reported)


def new_findings(
    main: Mapping[str, str], after: Mapping[str, str], changed: Container[str], tools: Tools
) -> Iterable[tuple[str, str]]:
    """Path and words of each mistake that the catalogue has in `after` and not in `main`, and of each in a file that is
    `changed`."""
    tried: Tried = {}
    before = {(finding.file, finding.key) for finding in _findings(main, tools, tried)}
    for finding in _findings(after, tools, tried):
        path = finding.file.removeprefix("/")
        if path in changed or (finding.file, finding.key) not in before:
            yield path, f"{finding.key}: {finding.text}"


def _findings(files: Mapping[str, str], tools: Tools, tried: Tried) -> Sequence[SourceProblem]:
    """Mistakes in the catalogue as if it were sources; applications that were `tried` are not tried again."""
    folders = tuple(f"{folder}/" for folder in READ_FOLDERS)
    sources = {p: _source(t, p) for p, t in files.items() if p.startswith(folders) and p.endswith(".yaml")}
    return validate_sources(CatalogueSources("", sources), tools, tried)


def _source(text: str, path: str) -> str:
    """An entry without its status; a text that cannot be read as it is."""
    if not path.startswith(f"{CHARTS}/"):
        return text
    try:
        document = read_mapping(text, path)
    except DocumentError:
        return text
    return write_mapping({key: value for key, value in document.items() if key != "status"})


def artefact_problems(chart: SubmittedChart, pulled: PulledChart) -> list[str]:
    """Differences between the entry and the chart that its digest names."""
    problems = []
    for key, wanted in (("name", chart.chart), ("version", chart.version)):
        if pulled.metadata.get(key) != wanted:
            stated = pulled.metadata.get(key)
            problems.append(f"{chart.path}: Chart.yaml of {chart.digest} has {key} {stated!r}, not {wanted!r}")
    problems += _image_problems(chart, pulled.files.get(IMAGES_FILE, b""))
    try:
        schema_text(pulled.files)
    except DocumentError as error:
        problems += [f"{chart.path}: {error.where} of {chart.digest}: {problem}" for problem in error.problems]
    annotations = read_json(pulled.manifest).get("annotations") or {}
    if annotations.get(ENTRY_ANNOTATION) != entry_digest(chart.spec):
        problems.append(
            f"{chart.path}: {chart.digest} was packed with another entry; submit it with `robotkube registry submit`"
        )
    return problems


def _image_problems(chart: SubmittedChart, data: bytes) -> Iterable[str]:
    try:
        images = read_mapping(data.decode(), IMAGES_FILE) if data else {}
    except (DocumentError, UnicodeDecodeError) as error:
        yield f"{chart.path}: {IMAGES_FILE} of {chart.digest}: {error}"
        return
    if sorted(map(str, images.values())) != sorted(chart.images):
        runs = ", ".join(sorted(map(str, images.values()))) or "none"
        yield f"{chart.path}: status.images differ from the chart's {IMAGES_FILE}, which has {runs}"
    if sorted(images) != sorted(chart.spec.get("images") or ()):
        names = ", ".join(sorted(images)) or "none"
        yield f"{chart.path}: spec.images differ from the chart's {IMAGES_FILE}, which names {names}"


def schema_path(entry: str) -> str:
    """The path of the values schema of the chart version whose entry is at `entry`."""
    return f"{entry.removesuffix('.yaml')}.schema.json"


def schema_text(files: Mapping[str, bytes]) -> str:
    """The chart's values.schema.json with its values.yaml as `default`, so that a release's values can be checked as
    Helm merges them. DocumentError names the file that is missing or cannot be read."""
    try:
        schema = read_json(files[SCHEMA_FILE])
    except KeyError as error:
        raise DocumentError(SCHEMA_FILE, ["missing; releases are checked against it, add it to the chart"]) from error
    except ValueError as error:
        raise DocumentError(SCHEMA_FILE, [f"not readable as JSON: {error}"]) from error
    if not isinstance(schema, dict):
        raise DocumentError(SCHEMA_FILE, ["must hold a JSON object"])
    values = files.get(VALUES_FILE, b"").decode(errors="replace")
    default = read_mapping(values, VALUES_FILE) if values.strip() else {}
    return json.dumps({**schema, "default": default}, indent=2, sort_keys=True) + "\n"


@dataclass(frozen=True)
class VerifiedChart:
    """A chart whose suites all passed: `envelopes` suite name (and `summary`) -> bytes, `evidence` the digest of the
    summary's bytes, `policy` that of the policy, `schema` as `schema_text` gives it."""

    submitted: SubmittedChart
    envelopes: Mapping[str, bytes]
    evidence: str
    policy: str
    schema: str


def publication_files(submission: Submission, charts: Sequence[VerifiedChart]) -> dict[str, str]:
    """Path -> text of everything that the publication writes to the catalogue."""
    files = dict(submission.applications)
    for chart in charts:
        entry = chart.submitted
        status = {
            "state": "verified",
            "digest": entry.digest,
            "images": list(entry.images),
            "evidence": chart.evidence,
            "policy": chart.policy,
        }
        files[entry.path] = write_mapping({**entry.document, "status": status})
        files[schema_path(entry.path)] = chart.schema
        files |= {f"{entry.artefact.folder}/{name}.json": data.decode() for name, data in chart.envelopes.items()}
    return files


def publication_message(
    submission: Submission, charts: Sequence[VerifiedChart], number: int, approvers: Sequence[str] = ()
) -> str:
    """`publish: <what>`, a pair of trailers per chart, the pull request, and who approved it where somebody had to."""
    lines = [f"publish: {submission.names}", ""]
    for chart in charts:
        entry = chart.submitted
        lines += [
            trailer("Chart", f"{entry.chart}@{entry.version}@{entry.digest}"),
            trailer("Evidence", chart.evidence),
        ]
    lines += [trailer("Policy", policy) for policy in sorted({chart.policy for chart in charts})]
    lines += [trailer(PULL_REQUEST, number), *(trailer(APPROVED_BY, account) for account in approvers)]
    return "\n".join(lines).rstrip() + "\n"
