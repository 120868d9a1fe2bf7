"""The interface suite: a chart opens exactly what its entry declares, with every set of test values.

Per set it installs the chart in the test namespace, runs a second pod on the same node that observes it
(`interface_observer`), and compares the observation with what the entry's interfaces give for these values, and the
chart's pods with what they were before the observation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.shortening import shortened
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.catalogue.core.expected_topics import (
    DATABASE,
    MQTT,
    ExpectedTopic,
    declaration_checks,
    expected_topics,
)
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core.interface_observations import (
    bounded,
    compare,
)
from robotkube.registry.suites.core.namespace_contents import BROKER_SECRET, DATABASE_SECRET
from robotkube.registry.suites.core.requests import TestSet
from robotkube.registry.suites.loops.installation import filled_sets, install, named_secrets
from robotkube.registry.suites.loops.installed.steadiness import changes_since
from robotkube.registry.suites.loops.interface_observer import ObserverTimeouts
from robotkube.registry.suites.loops.observer_pod import ObserverPod
from robotkube.registry.suites.ports.suites import Subject, SuiteNamespace

REMOVE_SECONDS_MAX = 60.0
LEAD_NS = 5_000_000_000
TEXT_CHARACTERS_MAX = 1_500
FIX_CHANGED = (
    "start the chart with these values yourself and correct what is named here: the process has to go on without peers "
    "and with every message of its inputs; what else is named of this set may follow from it"
)


@dataclass(frozen=True)
class InterfaceSuite:
    """The port Suite for the suite `interface`. `observer` is the reference of the image with rclpy, `token` gives a
    word that nobody can guess: under it the observer is known, and a chart cannot pass its own topics off as the
    observer's."""

    observer: str
    render: Render
    now_ns: Callable[[], int]
    token: Callable[[], str]
    bounds: ObserverTimeouts = field(default_factory=ObserverTimeouts)
    name: str = "interface"
    version: str = "2"
    needs_namespace: bool = True

    def run(self, subject: Subject, test_namespace: SuiteNamespace | None) -> Sequence[Check]:
        """Every check of every set; those of the entry alone when the entry cannot be right."""
        assert test_namespace is not None, "the interface suite needs a test namespace"
        interfaces = (subject.entry.get("spec") or {}).get("interfaces") or []
        try:
            sets = filled_sets(subject.entry, test_namespace.agent, self.now_ns() + LEAD_NS, self.render)
            defaults = read_mapping(subject.files.get("values.yaml", b"").decode() or "{}", "values.yaml")
            expected = {
                test_set.name: expected_topics(interfaces, overlay(defaults, test_set.values), self.render)
                for test_set in sets
            }
        except InputError as error:
            return [_entry_check(error)]
        checks = declaration_checks(interfaces, expected)
        if any(not check.passed for check in checks):
            return checks
        for number, test_set in enumerate(sets):
            checks += self._set_checks(subject, test_namespace, test_set, expected[test_set.name], first=number == 0)
        return bounded(checks)

    def _set_checks(
        self,
        subject: Subject,
        test_namespace: SuiteNamespace,
        values: TestSet,
        expected: Sequence[ExpectedTopic],
        first: bool,
    ) -> list[Check]:
        name = f"set {values.name}: runs"
        try:
            return [Check(name, True), *self._observed(subject, test_namespace, values, expected, first)]
        except InputError as error:
            fix = "mend the chart or the set's values"
            return [Check(name, False, shortened(str(error), TEXT_CHARACTERS_MAX), fix)]

    def _observed(
        self,
        subject: Subject,
        test_namespace: SuiteNamespace,
        values: TestSet,
        expected: Sequence[ExpectedTopic],
        first: bool,
    ) -> list[Check]:
        """Install the set, observe it, and delete it again: whether its pods stayed as they were, then what they
        opened. InputError when the chart does not run or cannot be observed."""
        objects = subject.render(values.values, subject.artefact.chart)
        needed = {topic.medium for topic in expected} | named_secrets(objects)
        broker = bool(needed & {MQTT, BROKER_SECRET})
        if broker:
            test_namespace.start_broker()
        database = test_namespace.start_database() if needed & {DATABASE, DATABASE_SECRET} else None
        pod = ObserverPod(self.observer, test_namespace, broker, database, self.bounds)
        if database is not None and not first:
            pod.clear(self.token())
        log_length_before = len(test_namespace.broker_log())
        try:
            installation = install(subject, test_namespace, values)
            if not installation.ready:
                raise InputError(installation.problem)
            before = test_namespace.pods()
            observation = pod.observe(expected, self.token(), log_length_before)
            kept_running = _steadiness_check(values.name, changes_since(before, test_namespace))
            return [kept_running, *compare(values.name, expected, observation)]
        finally:
            test_namespace.delete(objects, REMOVE_SECONDS_MAX)


def _steadiness_check(set_name: str, changes: str) -> Check:
    fix = FIX_CHANGED if changes else ""
    return Check(f"set {set_name}: keeps running", not changes, shortened(changes, TEXT_CHARACTERS_MAX), fix)


def _entry_check(error: InputError) -> Check:
    problems = error.problems if isinstance(error, DocumentError) else (str(error),)
    fix = "mend spec.interfaces or the values of spec.suites.sets in the chart's entry"
    return Check(
        "the entry gives topics for its test values", False, shortened("; ".join(problems), TEXT_CHARACTERS_MAX), fix
    )
