"""Events of rules as tasks bring them: what a version's measure of success is held against.

A detector asks for something when a rule of it begins to hold; the task names rule, time and agents. Whoever else may
write tasks may say the same, so an agent that has topics of its own speaks for itself alone, and those who listen to
all speak for all.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.placement.placement import Agent
from robotkube.foundation.documents.core.times import time_ns
from robotkube.foundation.kubernetes.core.annotations import AGENTS_ANNOTATION
from robotkube.foundation.kubernetes.core.objects import object_key
from robotkube.robots.bridge.core.rights import SPEAKING_ROLES
from robotkube.robots.ros.core.topic_patterns import TopicPattern, ros_name

EVENTS_MAX = 10_000
RATE, ABSENCE = "rate", "absence"
SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class RuleEvent:
    """The beginning of one event: its `rule` and time (ns since 1970), the task's `namespace`, and the `agents` it is
    about by name (none: the one that says it). `ongoing` while its task is there: detectors withdraw it at the end."""

    rule: str
    time_ns: int
    namespace: str
    agents: tuple[str, ...] = ()
    ongoing: bool = False


def event_in(task: Mapping[str, Any]) -> RuleEvent | None:
    """The event in a TaskDescription; None when it has none that can be read. Its time is the detector's, but not later
    than the task, which the API server's clock stamped."""
    metadata = task.get("metadata", {})
    event = task.get("spec", {}).get("event", {})
    agents = str((metadata.get("annotations") or {}).get(AGENTS_ANNOTATION, "")).split()
    try:
        created = time_ns(metadata["creationTimestamp"]) + SECOND_NS  # it counts whole seconds
        begun = min(time_ns(event["time"]), created) if "time" in event else created
        return RuleEvent(str(event["rule"]), begun, str(metadata["namespace"]), tuple(agents))
    except (KeyError, TypeError, ValueError):
        return None


class RuleEvents:
    """The last EVENTS_MAX events that tasks brought, each once; `note` and `end` from any thread."""

    def __init__(self) -> None:
        self._events: deque[RuleEvent] = deque(maxlen=EVENTS_MAX)
        self._there: dict[str, RuleEvent] = {}

    def note(self, task: Mapping[str, Any]) -> None:
        """Note the event in a task, if it has one."""
        event = event_in(task)
        if event is None:
            return
        self._there[object_key(task)] = event
        if event not in self._events:
            self._events.append(event)

    def end(self, task: Mapping[str, Any]) -> None:
        """Note that a task is withdrawn, with which its event is over."""
        self._there.pop(object_key(task), None)

    def all(self) -> Sequence[RuleEvent]:
        """The events, in the order in which they came."""
        there = frozenset(tuple(self._there.values()))  # a copy first: others note meanwhile
        return tuple(replace(event, ongoing=event in there) for event in tuple(self._events))


def events_by_namespace(events: Iterable[RuleEvent], agents: Mapping[str, Agent]) -> dict[str, tuple[RuleEvent, ...]]:
    """The events by namespace of each agent that they are about, as far as who says them may say so."""
    speakers = {agent.namespace: agent for agent in agents.values()}
    about: dict[str, tuple[RuleEvent, ...]] = {}
    for event in events:
        speaker = speakers.get(event.namespace)
        if speaker is None:
            continue
        named = [agents[name] for name in event.agents if name in agents] if event.agents else [speaker]
        for agent in named:
            if agent.name == speaker.name or speaker.role not in SPEAKING_ROLES:
                about[agent.namespace] = (*about.get(agent.namespace, ()), event)
    return about


@dataclass(frozen=True)
class Watcher:
    """A release (key) whose detector makes a task of each event of `rule`, about `agents` alone (None: about any).
    Where the rule watches how messages of one `topic` come: its `kind`, below which rate it holds (`below_hz`), and
    whether it waits for agents that it lists (`lists`)."""

    rule: str
    release: str
    agents: frozenset[str] | None = None
    kind: str = ""
    topic: str = ""
    below_hz: float = 0.0
    lists: bool = False

    def watches(self, rules: Iterable[str], agent: str) -> bool:
        """Return whether it watches one of the rules for an agent."""
        return self.rule in rules and self.is_about(agent)

    def is_about(self, agent: str) -> bool:
        """Return whether it watches for the agent of a namespace."""
        return self.agents is None or agent in self.agents

    def hears(self, topic: str, agent: str, name: str) -> bool:
        """Return whether its events about the agent of a namespace, which is `name` in topics, are those of this
        topic."""
        try:
            heard = TopicPattern(self.topic).agent(topic)
        except ValueError:
            return False
        return ros_name(heard) == name if heard else heard is not None and self.release.partition("/")[0] == agent


def watchers_of(releases: Iterable[Release], agents: Mapping[str, Agent]) -> tuple[Watcher, ...]:
    """The watchers among releases, as their values say; agents by namespace."""
    return tuple(watcher for release in releases for watcher in _watchers(release, agents))


def _watchers(release: Release, agents: Mapping[str, Agent]) -> Iterable[Watcher]:
    detector = release.values.get("detector")
    if not isinstance(detector, Mapping):
        return
    reactions = [one for one in detector.get("reactions") or () if isinstance(one, Mapping)]
    asking = {reaction.get("rule") for reaction in reactions if reaction.get("kind") == "operator"}
    for rule in detector.get("rules") or ():
        if isinstance(rule, Mapping) and rule.get("name") in asking:
            named = rule.get("agents")
            about = frozenset(agents[a].namespace for a in named if a in agents) if isinstance(named, list) else None
            speaker = next((a for a in agents.values() if a.namespace == release.namespace), None)
            if speaker is not None and speaker.role in SPEAKING_ROLES:
                about = frozenset({speaker.namespace}) & about if about is not None else frozenset({speaker.namespace})
            yield Watcher(str(rule["name"]), release.key, about, **_arrivals(rule))


def _arrivals(rule: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a watcher whose rule says how the messages of a topic come, agent by agent."""
    below_hz = rule.get("start_below_hz", 0)
    if rule.get("kind") not in (RATE, ABSENCE) or rule.get("scope", "agent") != "agent":
        return {}
    return {
        "kind": rule["kind"],
        "topic": str(rule.get("topic", "")),
        "below_hz": float(below_hz) if isinstance(below_hz, int | float) else 0.0,
        "lists": isinstance(rule.get("agents"), list),
    }
