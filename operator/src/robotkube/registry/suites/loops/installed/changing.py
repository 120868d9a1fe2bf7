"""The change of the suite `install`: a running chart is given other settings, and seen with them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.catalogue.core.chart_versions import RESTART
from robotkube.registry.catalogue.core.expected_topics import expected_topics
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.registry.evidence.core.statements import NOT_SHOWN, Check
from robotkube.registry.suites.core import changed_settings
from robotkube.registry.suites.core.changed_settings import Topics
from robotkube.registry.suites.core.requests import TestSet
from robotkube.registry.suites.core.soaked_pods import came, ends, unsteady
from robotkube.registry.suites.loops.installation import Installation, install
from robotkube.registry.suites.loops.installed.steadiness import log_lines
from robotkube.registry.suites.loops.observer_pod import ObserverPod
from robotkube.registry.suites.ports.suites import Object, Subject, SuiteNamespace

TAKES_SETTINGS = "takes-changed-settings"
NOT_TRIED = f"{NOT_SHOWN} no value of another test set shows itself in the ROS graph without another pod"
FIX = (
    "let the process take changed settings as the entry's `settings` says: `watched`, it follows the ConfigMap that "
    "ROBOTKUBE_CONFIGMAP names and is not ready until the newest are at work; `restart`, the pod is replaced"
)


FIX_ENDED = "the process ended by itself while it was looked at with other settings: its log says why; correct it"


@dataclass(frozen=True)
class OtherSettings:
    """Values to change to: the set with them, whether they are another pod template, and the ROS topics that are open
    before and shall be open afterwards."""

    to: TestSet
    new_pod: bool
    before: Topics
    after: Topics


@dataclass(frozen=True)
class SettingsChange:
    """The change of a chart from its first test set's values to other ones. `observer` is the reference of the image
    that looks at the ROS graph, `token` gives a word that nobody can guess."""

    observer: str
    render: Render
    token: Callable[[], str]

    def checks(
        self, subject: Subject, test_namespace: SuiteNamespace, installation: Installation, sets: Sequence[TestSet]
    ) -> tuple[list[Check], Installation]:
        """The check of a chart that is installed with the first of `sets` and ready, and what is installed afterwards;
        none when its entry does not say how it takes settings."""
        if not changed_settings.declared(subject.entry):
            return [], installation
        try:
            change = self._change(subject, installation, sets)
            if change is None:
                return [Check(TAKES_SETTINGS, True, NOT_TRIED)], installation
            before = test_namespace.pods()
            after = install(subject, test_namespace, change.to)
            problem = after.problem or self._problem(test_namespace, change, before)
        except InputError as error:
            return [Check(TAKES_SETTINGS, False, f"its settings could not be changed: {error}", FIX)], installation
        seen = "a new pod has them" if change.new_pod else self._seen(subject, sets, change.to)
        check = _refusal(problem, before, test_namespace) if problem else Check(TAKES_SETTINGS, True, seen)
        here = {changed_settings.identity(item) for item in after.objects}
        left = [item for item in installation.objects if changed_settings.identity(item) not in here]
        return [check], Installation([*after.objects, *left])

    def _change(self, subject: Subject, installation: Installation, sets: Sequence[TestSet]) -> OtherSettings | None:
        """The first change that shows what the entry says: a new pod, or other topics of the same one."""
        before = self._topics(subject, sets[0].values)
        for to in _candidates(sets):
            try:
                objects = subject.render(to.values, subject.artefact.chart)
                moves = changed_settings.moves_pod(installation.objects, objects)
                change = OtherSettings(to, bool(moves), before, self._topics(subject, to.values))
            except InputError:
                continue
            if changed_settings.declared(subject.entry) == RESTART and moves is not None:
                return replace(change, new_pod=True)
            if moves is False and changed_settings.differ(change.before, change.after):
                return change
        return None

    def _topics(self, subject: Subject, values: Mapping[str, Any]) -> Topics:
        interfaces = (subject.entry.get("spec") or {}).get("interfaces") or []
        values = overlay(_defaults(subject), values)
        return changed_settings.visible(expected_topics(interfaces, values, self.render))

    def _seen(self, subject: Subject, sets: Sequence[TestSet], to: TestSet) -> str:
        """What topics have shown, and of which values they say nothing."""
        every = [_defaults(subject), *(test_set.values for test_set in sets)]
        account = changed_settings.account(
            sets[0].values, to.values, every, lambda values: self._topics(subject, values)
        )
        return "; ".join(filter(None, (f"it opened the topics of {to.name}, and its pod stayed", account)))

    def _problem(self, test_namespace: SuiteNamespace, change: OtherSettings, before: Sequence[Object]) -> str:
        """What is wrong with the pods, or with the topics that they have open now; empty when nothing is."""
        after = test_namespace.pods()
        if change.new_pod:
            return "" if came(before, after) else "its pod is the one from before, which started with other settings"
        observation = ObserverPod(self.observer, test_namespace, False, None).look(change.after, self.token())
        unseen = changed_settings.unseen(change.before, change.after, observation.endpoints)
        return "\n".join([*unsteady(before, test_namespace.pods()), *unseen])


def _defaults(subject: Subject) -> Mapping[str, Any]:
    return read_mapping(subject.files.get("values.yaml", b"").decode() or "{}", "values.yaml")


def _refusal(problem: str, before: Sequence[Object], test_namespace: SuiteNamespace) -> Check:
    """The check that failed; a process that ended is another thing than one that does not follow."""
    after = test_namespace.pods()
    if not ends(before, after):
        return Check(TAKES_SETTINGS, False, problem, FIX)
    return Check(TAKES_SETTINGS, False, "\n".join([problem, *log_lines(after, test_namespace)]), FIX_ENDED)


def _candidates(sets: Sequence[TestSet]) -> Iterator[TestSet]:
    """The other sets, then the first one with one value of another: what it needs is there."""
    yield from sets[1:]
    first = replace(sets[0], prepare_image="", config_maps={})
    for path, values in changed_settings.variations(first.values, [other.values for other in sets[1:]]):
        yield replace(first, name=path, values=values)
