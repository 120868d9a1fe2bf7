"""Suites in test namespaces that somebody makes with their own rights: made for the first run, emptied between runs,
removed at the end.

Everything ends with the time of all runs together, and soon after `stop`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.evidence.core.statements import SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.core.namespace_contents import HelperPod
from robotkube.registry.suites.core.own_namespaces import PREFIX, lacking
from robotkube.registry.suites.loops.cluster_namespace import ClusterTestNamespace, SuiteNamespaceSettings
from robotkube.registry.suites.loops.installation import filled_sets, named_secrets
from robotkube.registry.suites.loops.namespace_cleanup import ClusterNamespaceCleaner
from robotkube.registry.suites.loops.run import run_suite, unfinished
from robotkube.registry.suites.ports.own_namespaces import OwnNamespaces
from robotkube.registry.suites.ports.suites import Subject, Suite, SuiteAccount

SECONDS_MAX = 100.0
RUN_SECONDS_MIN = 40.0  # what has less time could be told not to get ready, when it only had no time to
EMPTY_SECONDS_MAX = 20.0
REMOVE_SECONDS_MAX = 20.0
POLL_SECONDS = 0.25
DOMAIN_IDS = (88, 89)  # below those of the platform's test namespaces; each has a namespace
MARGIN_SECONDS = 60.0
STOPPED = "it was interrupted"
SUBMIT = "submit the chart: the platform's own test namespaces take it"


class OwnNamespaceRuns:
    """Runs of suites, at most one in each namespace at a time. `settings` are what all have but name and domain;
    `token` gives a word for their names; `report` gets what is worth saying, in sentences."""

    def __init__(
        self,
        namespaces: OwnNamespaces,
        settings: Callable[[str, int], SuiteNamespaceSettings],
        render: Render,
        token: str,
        clock: Callable[[], float],
        now_ns: Callable[[], int],
        report: Callable[[str], None],
        seconds: float = SECONDS_MAX,
    ) -> None:
        self._namespaces = namespaces
        self._free = [settings(f"{PREFIX}{token}-{number}", domain) for number, domain in enumerate(DOMAIN_IDS)]
        self._render = render
        self._clock = clock
        self._now_ns = now_ns
        self._report = report
        self._seconds = seconds
        self._deadline = clock() + seconds
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._begun: set[str] = set()
        self._places = threading.Semaphore(len(self._free))

    def __enter__(self) -> OwnNamespaceRuns:
        """Remove what earlier ones left behind."""
        left = self._namespaces.remove_left_behind()
        if left:
            self._report(f"removed what an earlier try left behind: namespace {', '.join(left)}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the namespaces, and wait until they are gone."""
        self.stop()
        deadline = self._clock() + REMOVE_SECONDS_MAX
        for name in sorted(self._begun):
            self._removed(name, deadline)

    def _removed(self, name: str, deadline: float) -> None:
        try:
            self._namespaces.remove(name)
            while not self._namespaces.is_gone(name):
                if self._clock() >= deadline:
                    self._report(f"namespace {name} is still being removed")
                    return
                threading.Event().wait(POLL_SECONDS)
        except (InputError, UnavailableError) as error:
            self._report(f"namespace {name} was not removed: {error}; kubectl delete namespace {name}, or try again")

    def stop(self) -> None:
        """Have everything end that runs, and let nothing begin."""
        self._stopping.set()

    @property
    def seconds_left(self) -> float:
        """Seconds until the time of all runs is over."""
        return max(self._deadline - self._clock(), 0.0)

    def run(self, rule: SuiteRule, suite: Suite, subject: Callable[[str], Subject]) -> SuiteResult | str:
        """The result of a suite on the subject that is rendered for a namespace; a text says why it cannot be run."""
        with self._places:
            if self._stopping.is_set():
                return STOPPED
            if self.seconds_left < RUN_SECONDS_MIN:
                return self._over()
            with self._lock:
                settings = self._free.pop()
            began = self._clock()
            try:
                return self._run(rule, suite, settings, subject(settings.namespace))
            except (InputError, UnavailableError) as error:
                return unfinished(rule, str(error), self._clock() - began)
            finally:
                with self._lock:
                    self._free.append(settings)

    def _run(
        self, rule: SuiteRule, suite: Suite, settings: SuiteNamespaceSettings, subject: Subject
    ) -> SuiteResult | str:
        reason = self._unfit(subject, settings.agent)
        if reason:
            return f"{reason}; {SUBMIT}"
        self._prepare(settings)
        for image in subject.images.values():
            words = self._refused(settings, image)
            if words:
                return f"the cluster lets {image} not run in a namespace of yours: {words}; {SUBMIT}"
        objects = self._namespaces.objects(settings.namespace)
        seconds = min(float(rule.seconds), self.seconds_left)
        namespace = ClusterTestNamespace(objects, settings, seconds, _no_account, self._clock, self._pause)
        result = run_suite(rule, suite, lambda: subject, namespace, self._clock)
        was_cut = result.outcome == "unfinished" and self.seconds_left <= 0 and not self._stopping.is_set()
        return self._over(f" after {result.seconds:.0f} s of it") if was_cut else result

    def _over(self, when: str = "") -> str:
        return f"the {self._seconds:.0f} s that a try takes at most were over{when}; try this chart alone"

    def _unfit(self, subject: Subject, agent: str) -> str:
        """Why the chart cannot run in a copy; empty when it can."""
        for one in filled_sets(subject.entry, agent, self._now_ns(), self._render):
            objects = subject.render(one.values, subject.artefact.chart)
            reason = lacking(named_secrets(objects), objects)
            if reason or one.prepare_image:
                return reason or f"its set {one.name} is prepared on a volume claim, which is there alone"
        return ""

    def _prepare(self, settings: SuiteNamespaceSettings) -> None:
        """A namespace with nothing in it."""
        name = settings.namespace
        if name in self._begun:
            cleaner = ClusterNamespaceCleaner(self._namespaces.objects(name), settings, self._clock, self._pause)
            cleaner.empty(EMPTY_SECONDS_MAX)
            return
        self._begun.add(name)  # before it is made: one that is half made is removed as well
        self._namespaces.make(name, self._seconds + REMOVE_SECONDS_MAX + MARGIN_SECONDS)

    def _refused(self, settings: SuiteNamespaceSettings, image: str) -> str:
        pod = HelperPod("suite-probe", image, settings.agent, settings.domain_id)
        return self._namespaces.refusal(settings.namespace, pod.document())

    def _pause(self, seconds: float) -> None:
        if self._stopping.wait(seconds):
            raise UnavailableError(STOPPED)


def _no_account(administrator: SuiteAccount, account: SuiteAccount) -> None:
    raise InputError("a test namespace of your own has no database; submit the chart")
