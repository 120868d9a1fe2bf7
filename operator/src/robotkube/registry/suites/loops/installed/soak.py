"""The soak of the suite `install`: a chart that is ready keeps running under traffic on all its inputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robotkube.errors import InputError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.catalogue.core.expected_topics import DATABASE, IN, MQTT, ExpectedTopic, expected_topics
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core.memory_growth import MemoryJudgement, not_measured
from robotkube.registry.suites.core.namespace_contents import BROKER_SECRET, DATABASE_SECRET
from robotkube.registry.suites.core.requests import TestSet
from robotkube.registry.suites.core.soaked_pods import unsteady
from robotkube.registry.suites.loops.installation import named_secrets
from robotkube.registry.suites.loops.installed.memory_sampling import MemoryWatch
from robotkube.registry.suites.loops.installed.steadiness import log_lines
from robotkube.registry.suites.loops.observer_pod import ObserverPod
from robotkube.registry.suites.ports.suites import Object, Subject, SuiteNamespace

KEEPS_RUNNING = "keeps-running"
MARGIN_SECONDS = 20.0  # for the pod that sends to start, connect and end
FIX = (
    "start the chart with these values yourself, send to its inputs for that long, and correct what is named here; a "
    "process that ends or loses its readiness under traffic does so on the robot, too"
)


@dataclass(frozen=True)
class Soak:
    """A soak of `seconds` (0: none). `observer` is the reference of the image that sends, `token` gives a word that
    nobody can guess, by which the sender is known; `memory` judges growth meanwhile."""

    observer: str
    render: Render
    token: Callable[[], str]
    seconds: int
    memory: MemoryWatch | None = None

    def checks(self, subject: Subject, test_namespace: SuiteNamespace, test_set: TestSet) -> list[Check]:
        """The check of a chart that is installed with the set and ready; none without a soak."""
        if not self.seconds:
            return []
        before = test_namespace.pods()
        try:
            inputs, memory = self._measured(before, lambda: self._send(subject, test_namespace, test_set))
        except InputError as error:
            words = f"it could not be kept under traffic for {self.seconds} s: {error}"
            return [Check(KEEPS_RUNNING, False, words, "mend the chart, its entry or the first set's values")]
        after = test_namespace.pods()
        problems = [*unsteady(before, after), *memory.problems]
        if problems:
            return [Check(KEEPS_RUNNING, False, "\n".join([*problems, *log_lines(after, test_namespace)]), FIX)]
        return [Check(KEEPS_RUNNING, True, f"{self.seconds} s with traffic on {inputs} inputs; {memory.note}")]

    def _measured(self, pods: Sequence[Object], send: Callable[[], int]) -> tuple[int, MemoryJudgement]:
        if self.memory is None:
            return send(), not_measured("nothing here reads it")
        return self.memory.beside(pods, self.seconds, send)

    def _send(self, subject: Subject, test_namespace: SuiteNamespace, test_set: TestSet) -> int:
        """Send to the chart's inputs, as its entry declares them, until the time is over; how many there are."""
        if test_namespace.seconds_left < self.seconds + MARGIN_SECONDS:
            left = f"{test_namespace.seconds_left:.0f} s are left of the run"
            raise InputError(f"{left}; raise `seconds` of the suite in the verification policy")
        interfaces = (subject.entry.get("spec") or {}).get("interfaces") or []
        defaults = read_mapping(subject.files.get("values.yaml", b"").decode() or "{}", "values.yaml")
        expected = expected_topics(interfaces, overlay(defaults, test_set.values), self.render)
        secrets = named_secrets(subject.render(test_set.values, subject.artefact.chart))
        broker, database = _needed(expected, secrets)
        pod = ObserverPod(self.observer, test_namespace, broker, test_namespace.start_database() if database else None)
        pod.load(expected, self.token(), float(self.seconds))
        return sum(topic.direction == IN for topic in expected)


def _needed(expected: Sequence[ExpectedTopic], secrets: set[str]) -> tuple[bool, bool]:
    """Return whether the chart has a broker, and a database; both run already when it has."""
    media = {topic.medium for topic in expected} | secrets
    return bool(media & {MQTT, BROKER_SECRET}), bool(media & {DATABASE, DATABASE_SECRET})
