"""Measures of a version's results, and what each says about a release that got the version."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from robotkube.delivery.manager.core.updates.cluster_health import (
    HEALTHY,
    NEVER_NS,
    SECOND_NS,
    ClusterHealth,
    ReleaseHealth,
)
from robotkube.delivery.manager.core.updates.probe_answers import ProbeAnswers
from robotkube.delivery.manager.core.updates.rule_events import ABSENCE, RATE, Watcher
from robotkube.registry.catalogue.core.success.measures import SuccessMeasure, TopicRate
from robotkube.robots.ros.core.topic_patterns import AGENT


@dataclass(frozen=True)
class Fault:
    """What makes an update fail: since when (ns since 1970), and in words."""

    since_ns: int
    text: str


@dataclass(frozen=True)
class Judged:
    """A release that is judged: its key, the namespace of its agent, since when it could run as main has it, since when
    it is healthy and was so first (None: it is not, or was not yet); times in ns since 1970."""

    key: str
    namespace: str
    begin_ns: int
    healthy_ns: int | None
    first_ns: int | None


@dataclass(frozen=True)
class Answer:
    """The answer of one measure. `faults`: what it found; `ends_ns`: when it has held for its time; `terms`: what must
    hold, in words; `unseen`: why nobody measures it, empty when somebody does."""

    faults: tuple[Fault, ...]
    ends_ns: int
    terms: str
    unseen: str = ""


def answers_of(measure: SuccessMeasure | None, release: Judged, cluster: ClusterHealth, now_ns: int) -> list[Answer]:
    """The answers of all measures of a version about a release at a time (ns since 1970)."""
    if measure is None:
        return []
    answers = []
    if measure.no_event_of:
        rules = ", ".join(measure.no_event_of)
        watched = [
            [w for w in cluster.watchers if w.watches([rule], release.namespace)] for rule in measure.no_event_of
        ]
        watch = _Watch(frozenset(measure.no_event_of), watched, measure.seconds, f"an event of {rules}")
        unseen = f"nobody watches it for events of {rules}"
        answers.append(_of_events(watch, unseen, release, cluster, now_ns))
    answers += [_of_rate(rate, measure.seconds, release, cluster, now_ns) for rate in measure.rates]
    if measure.probes_of:
        answers.append(_of_probes(measure, release, cluster))
    return answers


@dataclass(frozen=True)
class _Watch:
    """A watch for events: of `rules`, by one of the watchers of each group in `watched`, for so many `seconds`; `what`
    must not be, in words."""

    rules: frozenset[str]
    watched: Sequence[Sequence[Watcher]]
    seconds: int
    what: str

    def watched_ns(self, healthy_ns: int, cluster: ClusterHealth) -> int | None:
        """The time since which somebody healthy of each group watches a release that is healthy since then; None when
        there is nobody in one of them."""
        begin_ns = healthy_ns
        for group in self.watched:
            if not group:
                return None
            begin_ns = max(begin_ns, min(_healthy_ns(cluster.health.get(w.release)) for w in group))
        return begin_ns


def _of_rate(rate: TopicRate, seconds: int, release: Judged, cluster: ClusterHealth, now_ns: int) -> Answer:
    """The answer of rules about a topic: `rate` says that it comes too slowly, `absence` that it does not come at all,
    which `rate` does not know of a topic that it never heard."""
    ros_name = cluster.ros_names.get(release.namespace, "")
    topic = rate.topic.replace(AGENT, ros_name)
    hearing = [w for w in cluster.watchers if w.kind and w.is_about(release.namespace)]
    hearing = [w for w in hearing if w.hears(topic, release.namespace, ros_name)]
    slow = [w for w in hearing if w.kind == RATE and w.below_hz >= rate.at_least_hz]
    absent = [w for w in hearing if w.kind == ABSENCE and w.lists]
    watch = _Watch(frozenset(w.rule for w in (*slow, *absent)), [slow, absent], seconds, f"{topic} below {rate.hertz}")
    unseen = f"nobody measures {topic}: it takes a rule rate with start_below_hz of {rate.at_least_hz:g} or more and a "
    unseen += "rule absence with the agent in its list, whose reactions are tasks"
    answer = _of_events(watch, unseen, release, cluster, now_ns)
    events = [e for e in cluster.events.get(release.namespace, ()) if e.rule in watch.rules and e.ongoing]
    if not answer.unseen and any(event.time_ns < release.begin_ns for event in events):
        return replace(answer, unseen=f"{topic} was below {rate.hertz} before the update already, and is")
    return answer


def _of_events(watch: _Watch, unseen: str, release: Judged, cluster: ClusterHealth, now_ns: int) -> Answer:
    """An event of a rule is a fault while the release is healthy; one that began before, since the update, is one when
    it still goes on at the end of the time. The time counts from when who watches is healthy, too."""
    terms = f"without {watch.what} for {watch.seconds} s"
    if release.healthy_ns is None:
        return Answer((), NEVER_NS, terms)
    watched_ns = watch.watched_ns(release.healthy_ns, cluster)
    begin_ns = release.healthy_ns if watched_ns is None else watched_ns
    ends_ns = begin_ns + watch.seconds * SECOND_NS
    faults = tuple(
        Fault(event.time_ns, f"had an event of rule {event.rule} after the update")
        for event in cluster.events.get(release.namespace, ())
        if event.rule in watch.rules and release.healthy_ns <= event.time_ns <= ends_ns
    )
    if watched_ns is None:
        return Answer(faults, release.healthy_ns, terms, unseen)
    if now_ns >= ends_ns:
        faults += tuple(_lasting(watch.rules, release, cluster))
    return Answer(faults, ends_ns, terms)


def _lasting(rules: frozenset[str], release: Judged, cluster: ClusterHealth) -> Iterable[Fault]:
    """The events that go on since between the update and the first time that the release was healthy: a topic that is
    too slow from the start has been so since the old pod ended."""
    for event in cluster.events.get(release.namespace, ()):
        began_with_it = release.begin_ns <= event.time_ns < (release.first_ns or release.begin_ns)
        if event.rule in rules and event.ongoing and began_with_it:
            yield Fault(event.time_ns, f"has an event of rule {event.rule} that goes on since the update")


def _healthy_ns(health: ReleaseHealth | None) -> int:
    if health is None or health.state != HEALTHY:
        return NEVER_NS
    return health.since_ns or 0


def _of_probes(measure: SuccessMeasure, release: Judged, cluster: ClusterHealth) -> Answer:
    """A readiness probe that says no within the time after the release was first healthy is a fault, and a container
    that restarts is one from the update on."""
    named = ", ".join(measure.probes_of)
    terms = f"with probes of {named} that say yes for {measure.seconds} s"
    answers = cluster.probes.get(release.key, ProbeAnswers())
    ends_ns = NEVER_NS if release.first_ns is None else release.first_ns + measure.seconds * SECOND_NS
    faults = tuple(_faults(measure, answers, release, ends_ns))
    missing = [name for name in measure.probes_of if name not in answers.containers]
    if missing and release.healthy_ns is not None:
        unseen = f"nobody asks {', '.join(missing)}: no pod of it has such a container with a readiness probe"
        return Answer(faults, release.healthy_ns, terms, unseen)
    return Answer(faults, max(ends_ns, (release.healthy_ns or 0) + measure.seconds * SECOND_NS), terms)


def _faults(measure: SuccessMeasure, answers: ProbeAnswers, release: Judged, ends_ns: int) -> Iterable[Fault]:
    for fault in answers.faults:
        first_ns = release.begin_ns if fault.at_any_time else release.first_ns
        if fault.container in measure.probes_of and first_ns is not None and first_ns <= fault.time_ns <= ends_ns:
            yield Fault(fault.time_ns, f"had container {fault.container}, which {fault.text} after the update")
