"""Suite `install`: the chart installs with its first test set, gets ready, keeps running under traffic, takes other
settings, upgrades from the version it replaces, stops within its grace and leaves nothing behind."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robotkube.errors import InputError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core.changed_settings import identity
from robotkube.registry.suites.core.pod_descriptions import KILLED
from robotkube.registry.suites.core.requests import TestSet
from robotkube.registry.suites.loops.installation import Installation, apply, filled_sets, install
from robotkube.registry.suites.loops.installed.changing import SettingsChange
from robotkube.registry.suites.loops.installed.soak import Soak
from robotkube.registry.suites.ports.suites import Object, PodEnd, Subject, SuiteNamespace

STOP_MARGIN_SECONDS = 20.0  # of Kubernetes itself, in addition to the pods' own grace
INSTALLS, READY, UPGRADES = "installs", "becomes-ready", "upgrades"
STOPS, CLEAN = "stops-within-its-grace", "leaves-nothing-behind"
READY_FIX = (
    "start the chart with these values yourself (helm template, kubectl apply) and correct what is named here; a "
    "process must answer its readiness probe without peers"
)
STOP_FIX = (
    "handle SIGTERM in the container's first process (PID 1 has no default action: use exec in scripts) and end within "
    "terminationGracePeriodSeconds, or raise that"
)


class InstallSuite:
    """The port Suite. `render` fills templates; `now_ns` is the wall clock in ns since 1970; `soak` keeps the chart
    running under traffic, `change` gives it other settings."""

    name = "install"
    version = "3"
    needs_namespace = True

    def __init__(self, render: Render, now_ns: Callable[[], int], soak: Soak, change: SettingsChange) -> None:
        self._render = render
        self._now_ns = now_ns
        self._soak = soak
        self._change = change

    def run(self, subject: Subject, test_namespace: SuiteNamespace | None) -> Sequence[Check]:
        """The seven checks; those that an earlier failure makes pointless are left out."""
        if test_namespace is None:
            raise InputError("the suite install needs a test namespace")
        checks, installation = self._installed(subject, test_namespace)
        if installation is None or not installation.ready:
            return checks
        checks += self._soak.checks(subject, test_namespace, self._first_set(subject, test_namespace))
        sets = filled_sets(subject.entry, test_namespace.agent, self._now_ns(), self._render)
        changed, installation = self._change.checks(subject, test_namespace, installation, sets)
        checks += changed
        checks += self._removed(installation, test_namespace)
        return [*checks, self._upgraded(subject, test_namespace)]

    def _first_set(self, subject: Subject, test_namespace: SuiteNamespace) -> TestSet:
        return filled_sets(subject.entry, test_namespace.agent, self._now_ns(), self._render)[0]

    def _installed(self, subject: Subject, test_namespace: SuiteNamespace) -> tuple[list[Check], Installation | None]:
        try:
            installation = install(subject, test_namespace, self._first_set(subject, test_namespace))
        except InputError as error:
            fix = "correct the chart or the first set of spec.suites.sets in its entry"
            return [Check(INSTALLS, False, str(error), fix)], None
        problem = installation.problem
        return [Check(INSTALLS, True), Check(READY, not problem, problem, READY_FIX if problem else "")], installation

    def _removed(self, installation: Installation, test_namespace: SuiteNamespace) -> list[Check]:
        ends = test_namespace.delete(installation.objects, _grace(test_namespace.pods()) + STOP_MARGIN_SECONDS)
        late = [words for words in map(_lateness, ends) if words]
        left = test_namespace.leftovers()
        problem = f"still there after the chart was deleted: {', '.join(left)}" if left else ""
        fix = "let the chart make no objects that its deletion does not take along" if left else ""
        return [
            Check(STOPS, not late, "\n".join(late or map(_end_in_words, ends)), STOP_FIX if late else ""),
            Check(CLEAN, not left, problem, fix),
        ]

    def _upgraded(self, subject: Subject, test_namespace: SuiteNamespace) -> Check:
        old = subject.replaced
        if old is None:
            return Check(UPGRADES, True, "nothing published that it replaces: there is nothing to upgrade from")
        try:
            before = install(old, test_namespace, self._first_set(old, test_namespace))
            if not before.ready:
                return self._no_start(old, before.problem)
            after = self._replace(subject, before, test_namespace)
        except InputError as error:
            fix = (
                "an upgrade applies the new objects over the old ones: keep selectors and names, or raise no `replaces`"
            )
            return Check(UPGRADES, False, f"from {old.artefact.version}: {error}", fix)
        if after.ready:
            return Check(UPGRADES, True, f"from {old.artefact.version}")
        return Check(UPGRADES, False, f"from {old.artefact.version}: {after.problem}", READY_FIX)

    def _no_start(self, old: Subject, problem: str) -> Check:
        words = f"version {old.artefact.version}, which it replaces, did not get ready itself: {problem}"
        return Check(UPGRADES, False, words, "withdraw that version, or replace another one")

    def _replace(self, subject: Subject, before: Installation, test_namespace: SuiteNamespace) -> Installation:
        """Apply the new objects, then delete those that are no more, as Argo CD does."""
        objects = subject.render(self._first_set(subject, test_namespace).values, subject.artefact.chart)
        after = apply(objects, test_namespace)
        kept = {identity(item) for item in objects}
        gone = [item for item in before.objects if identity(item) not in kept]
        if gone:
            test_namespace.delete(gone, _grace(test_namespace.pods()) + STOP_MARGIN_SECONDS)
        return after


def _grace(pods: Sequence[Object]) -> float:
    return max((float(pod["spec"].get("terminationGracePeriodSeconds") or 0) for pod in pods), default=0.0)


def _end_in_words(end: PodEnd) -> str:
    return f"pod {end.name} ended after {end.seconds:.0f} s of the {end.grace_seconds:.0f} s it may take"


def _lateness(end: PodEnd) -> str:
    """What was wrong with a pod's end; empty when it ended by itself."""
    if not end.gone:
        return (
            f"pod {end.name} was still there {STOP_MARGIN_SECONDS:.0f} s after its grace of {end.grace_seconds:.0f} s"
        )
    killed = [name for name, code in end.exit_codes.items() if code == KILLED]
    if killed:
        return (
            f"pod {end.name}: container {', '.join(killed)} did not end on SIGTERM within {end.grace_seconds:.0f} s "
            f"and was killed (exit code {KILLED})"
        )
    return ""
