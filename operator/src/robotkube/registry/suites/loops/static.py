"""The static suite: reads the chart and what Helm makes of it; nothing is installed.

Checks of the schema, of the values, of the entry, of the renderings, of the objects: all of them, whatever the others
found, so that an author sees every problem at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.shortening import shortened
from robotkube.foundation.documents.core.value_templates import Render as Fill
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.catalogue.core.chart_versions import WATCHED
from robotkube.registry.catalogue.core.expected_topics import expected_topics
from robotkube.registry.catalogue.core.message_types.published import type_problems
from robotkube.registry.charts.core import values_schemas
from robotkube.registry.charts.core.packing import CHART_FILE
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core import changed_settings, static_checks
from robotkube.registry.suites.core.pod_security import mapping
from robotkube.registry.suites.core.requests import TestSet
from robotkube.registry.suites.core.static_checks import Rendering, check
from robotkube.registry.suites.loops.installation import filled_sets
from robotkube.registry.suites.ports.suites import Subject, SuiteNamespace
from robotkube.robots.ros.core.known_types import instead

AGENT = "agent-00"
START_NS = 1_800_000_000_000_000_000
RELEASE = "release-of-the-suite"
PLAN = "20260101-000000-abcdef"
SCHEMA_FILE, VALUES_FILE = "values.schema.json", "values.yaml"
TEXT_CHARACTERS_MAX = 1_500
SETTINGS = "settings"
SETTINGS_FIX = (
    "write the same in both: `settings: watched` or `settings: restart` in the entry's spec and in the chart's "
    "templates/_app.tpl, where the library chart reads it"
)

Violations = Callable[[Mapping[str, Any], Any], Sequence[tuple[tuple[str | int, ...], str]]]
"""Schema and value -> path and message of every place that breaks it."""


@dataclass(frozen=True)
class Chart:
    """The files of a chart that are read here, parsed; `problems` names those that could not be."""

    metadata: Mapping[str, Any]
    values: Mapping[str, Any]
    schema: Mapping[str, Any]
    problems: tuple[str, ...]


class StaticSuite:
    """Suite `static`: `violations` validates values, `fill` fills the templates of the test sets."""

    name = "static"
    version = "4"
    needs_namespace = False

    def __init__(self, violations: Violations, fill: Fill) -> None:
        self._violations = violations
        self._fill = fill

    def run(self, subject: Subject, test_namespace: SuiteNamespace | None = None) -> list[Check]:
        """Every check, about thirty."""
        chart = read_chart(subject.files)
        sets, unfilled = self._sets(subject)
        renderings, problems = self._renderings(subject, sets)
        return [
            check("files", chart.problems, "repair the file"),
            *self._schema_checks(chart),
            self._values_check(chart),
            self._sets_check(chart, sets, unfilled),
            *entry_checks(chart, subject, renderings),
            self._types_check(chart, subject, sets),
            check("renders", problems, "repair the template or the test values until helm template takes them"),
            *self._repeated(subject, sets, renderings),
            self._settings_check(subject, sets, renderings),
            *static_checks.object_checks(renderings),
        ]

    def _sets(self, subject: Subject) -> tuple[list[TestSet], list[str]]:
        try:
            return filled_sets(subject.entry, AGENT, START_NS, self._fill), []
        except InputError as error:
            return [], [str(error)]

    def _schema_checks(self, chart: Chart) -> list[Check]:
        broken = [message for path, message in self._violations(chart.schema, {}) if message.startswith("schema:")]
        strict = values_schemas.strictness_problems(chart.schema)
        documented = values_schemas.undescribed(chart.schema)
        unknown = values_schemas.unknown_values(chart.schema, chart.values)
        described = [f"{path}: no description" for path in documented]
        described += [f"{path}: is in {VALUES_FILE}, but not in {SCHEMA_FILE}" for path in unknown]
        return [
            check("schema-valid", broken, f"repair {SCHEMA_FILE}"),
            check(
                "schema-strict",
                strict,
                "write additionalProperties: false beside `properties`; true where any key is meant",
            ),
            check("values-documented", described, f"give the key a description in {SCHEMA_FILE}"),
        ]

    def _values_check(self, chart: Chart) -> Check:
        problems = [
            f"{VALUES_FILE}: {_path(path)}: {message}"
            for path, message in self._violations(chart.schema, chart.values)
            if not values_schemas.must_be_given(chart.schema, path, _at(chart.values, path))
        ]
        return check(
            "values-valid", problems, 'give a default the schema allows, or "" and `required` for what must be given'
        )

    def _sets_check(self, chart: Chart, sets: Sequence[TestSet], unfilled: Sequence[str]) -> Check:
        problems = list(unfilled)
        if sets and len(sets) < 2:
            problems.append("the entry has one test set, two are needed")
        for test_set in sets:
            values = values_schemas.overlay(chart.values, test_set.values)
            violations = self._violations(chart.schema, values)
            problems += [f"set {test_set.name}: {_path(path)}: {message}" for path, message in violations]
        return check("test-sets", problems, "correct spec.suites.sets of the entry")

    def _types_check(self, chart: Chart, subject: Subject, sets: Sequence[TestSet]) -> Check:
        """Every type is known to who must open it: the chart's images, or the observer of the suite `interface`."""
        spec = mapping(subject.entry.get("spec"))
        problems: list[str] = []
        for test_set in sets:
            values = values_schemas.overlay(chart.values, test_set.values)
            try:
                topics = expected_topics(spec.get("interfaces") or [], values, self._fill)
            except InputError:
                continue  # for the suite `interface` to say
            problems += [f"interface {name}: {text}" for name, text in type_problems(topics, spec.get("images") or [])]
        return check("message-types", problems, f"{instead()}, or leave the topic out of the chart's interfaces")

    def _renderings(self, subject: Subject, sets: Sequence[TestSet]) -> tuple[list[Rendering], list[str]]:
        renderings = []
        problems = [] if sets else ["there is no test set to render with"]
        for test_set in sets:
            try:
                renderings.append(_render(subject, test_set, {}))
            except InputError as error:
                problems.append(f"set {test_set.name}: {_short(error)}")
        return renderings, problems

    def _repeated(self, subject: Subject, sets: Sequence[TestSet], first: Sequence[Rendering]) -> list[Check]:
        """The same values with a plan; and once more as they are, when more than the plan came out differently."""
        known = {rendering.test_set: rendering for rendering in first}
        changing = []
        planned = []
        for test_set in [test_set for test_set in sets if test_set.name in known]:
            try:
                with_plan = _render(subject, test_set, {"plan": PLAN})
                planned += static_checks.plan_problems(known[test_set.name], with_plan, PLAN)
                if not static_checks.same_but_plan(known[test_set.name], with_plan):
                    changing += _changing(known[test_set.name], _render(subject, test_set, {}))
            except InputError as error:
                planned.append(f"set {test_set.name}: with global.plan: {_short(error)}")
        return [
            check("renders-the-same-twice", changing, "leave out times, random texts and lookups"),
            check(
                "plan", planned, "take the ConfigMap from robotkube-app.configmap, and let the schema have global.plan"
            ),
        ]

    def _settings_check(self, subject: Subject, sets: Sequence[TestSet], renderings: Sequence[Rendering]) -> Check:
        """The pod template follows a changed value as the entry says."""
        settings = changed_settings.declared(subject.entry)
        if not settings:
            return Check(SETTINGS, True, "advice: the entry does not say how changed settings are taken", SETTINGS_FIX)
        moved: dict[str, bool] = {}
        if sets and renderings and renderings[0].test_set == sets[0].name:
            moved = self._moved(subject, renderings[0], [test_set.values for test_set in sets], settings)
        return check(SETTINGS, changed_settings.disagreements(settings, moved), SETTINGS_FIX)

    def _moved(
        self, subject: Subject, first: Rendering, values_of_sets: Sequence[Mapping[str, Any]], settings: str
    ) -> dict[str, bool]:
        """Path of a changed value -> whether it gives another pod template; without those that change nothing, or that
        cannot stand with the first set's other values. Ends with the first that decides."""
        moved: dict[str, bool] = {}
        for path, values in changed_settings.variations(values_of_sets[0], values_of_sets[1:]):
            try:
                moves = changed_settings.moves_pod(first.objects, subject.render(values, RELEASE))
            except InputError:
                continue
            if moves is not None:
                moved[path] = moves
            if settings == WATCHED and moves is False:
                break
        return moved


def entry_checks(chart: Chart, subject: Subject, renderings: Sequence[Rendering]) -> list[Check]:
    """Chart and catalogue entry agree."""
    resources = [
        problem for rendering in renderings[:1] for problem in static_checks.resource_problems(rendering, subject.entry)
    ]
    return [
        check(
            "identity",
            static_checks.identity_problems(chart.metadata, subject.entry),
            "give both the same name and version",
        ),
        check(
            "entry-images", static_checks.image_problems(subject.images, subject.entry), "name the same images in both"
        ),
        check(
            "entry-resources", resources, "write the requests of one pod into the entry, which releases are placed by"
        ),
        check(
            "entry-success",
            static_checks.unanswered_probes(renderings, subject.entry),
            "name containers of the chart's pod in spec.success.probesOf, or give them a readinessProbe",
        ),
    ]


def read_chart(files: Mapping[str, bytes]) -> Chart:
    """Chart.yaml, values.yaml and values.schema.json out of the chart's files."""
    problems: list[str] = []

    def read(path: str, parse: Callable[[str, str], Any]) -> Mapping[str, Any]:
        try:
            document = parse(files[path].decode(), path)
        except KeyError:
            problems.append(f"{path}: missing")
        except (InputError, ValueError) as error:
            problems.append(
                _short(error) if isinstance(error, InputError) else f"{path}: not readable: {_short(error)}"
            )
        else:
            if isinstance(document, Mapping):
                return document
            problems.append(f"{path}: must hold a mapping")
        return {}

    problems += [
        f"{path}: definitions of kinds are not part of an application" for path in files if path.startswith("crds/")
    ]
    return Chart(
        metadata=read(CHART_FILE, read_mapping),
        values=read(VALUES_FILE, read_mapping),
        schema=read(SCHEMA_FILE, lambda text, path: read_json(text)),
        problems=tuple(problems),
    )


def _render(subject: Subject, test_set: TestSet, more: Mapping[str, Any]) -> Rendering:
    values = values_schemas.overlay(test_set.values, {"global": more} if more else {})
    objects = subject.render(values, RELEASE)
    agent = mapping(test_set.values.get("placement")).get("agent", "")
    return Rendering(test_set.name, subject.artefact.chart, RELEASE, str(agent), objects)


def _changing(first: Rendering, second: Rendering) -> list[str]:
    differs = first.objects != second.objects
    return [f"set {first.test_set}: two renderings with the same values differ"] if differs else []


def _at(value: Any, path: Sequence[str | int]) -> Any:
    for part in path:
        value = value[part]
    return value


def _path(path: Sequence[str | int]) -> str:
    return "values" + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)


def _short(error: Exception) -> str:
    return shortened(" ".join(str(error).split()), TEXT_CHARACTERS_MAX)
