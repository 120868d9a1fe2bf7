"""The status of a detector: `/status` as JSON, `/metrics` in Prometheus' text form. Any thread may read it.

Labels take values of closed lists: topic patterns, rules and reactions of the settings, never agents or events.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robotkube.foundation.runtime.loops.settings_report import SettingsReport
from robotkube.robots.detector.core.settings import STATES
from robotkube.robots.detector.loops.subscription import SOURCE_STATES, source_state
from robotkube.robots.reactions.loops.delivery_journal import MEMORY_ONLY

if TYPE_CHECKING:
    from robotkube.robots.detector.loops.detector import EventDetector
    from robotkube.robots.rules.core import RuleEngine

PROBLEMS_MAX = 50
PREFIX = "robotkube_detector_"
TOPIC_GAUGES = (
    "subscriptions", "matched_sources", "stale_topics", "mismatched_topics", "buffer_messages", "buffer_bytes",
)  # fmt: skip

METRICS: Mapping[str, tuple[str, str, str]] = {
    "info": ("gauge", "state", "1 for the state that the detector is in."),
    "ready": ("gauge", "", "1 while it is ready."),
    "settings_refused": ("gauge", "", "1 while the newest settings are refused and older ones are at work."),
    "subscriptions": ("gauge", "topic", "Topics that are subscribed to, by pattern."),
    "matched_sources": ("gauge", "topic", "Publishers that are connected."),
    "stale_topics": ("gauge", "topic", "Topics that have been silent for longer than stale_seconds."),
    "sources": ("gauge", "state", "Topics whose stamps are in that state."),
    "mismatched_topics": ("gauge", "topic", "Topics with a publisher whose type or quality of service does not fit."),
    "incompatible_total": ("counter", "topic", "Publishers that the middleware refused because of their quality."),
    "missed_deadlines_total": ("counter", "topic", "Deadlines asked for that passed without a message."),
    "lost_liveliness_total": ("counter", "topic", "Publishers that gave no sign of life for as long as their lease."),
    "received_total": ("counter", "topic", "Messages received."),
    "malformed_total": ("counter", "topic", "Messages whose stamp could not be read."),
    "lost_total": ("counter", "topic", "Messages that were pushed out before they were received."),
    "buffer_messages": ("gauge", "topic", "Messages in the ring buffers."),
    "buffer_bytes": ("gauge", "topic", "Bytes in the ring buffers."),
    "late_total": ("counter", "topic", "Messages older than the window."),
    "ahead_total": ("counter", "topic", "Messages whose stamp was too far ahead to be believed."),
    "duplicates_total": ("counter", "topic", "Messages that were there already."),
    "jumps_total": ("counter", "topic", "Jumps of a topic's time."),
    "evicted_total": ("counter", "topic", "Messages that left a buffer because of a bound."),
    "events_total": ("counter", "", "Edges that were dispatched."),
    "active_events": ("gauge", "rule", "Events that last."),
    "unreadable_total": ("counter", "", "Messages whose fields a rule could not read."),
    "unseen_total": ("counter", "reason", "Messages that rules read and did not see."),
    "rule_apart_total": (
        "counter",
        "rule",
        "Comparisons left out: agents heard of at once with stamps too far apart.",
    ),
    "rule_ignored_total": ("counter", "rule", "Messages of more agents than a rule looks at."),
    "rules_wait_seconds": ("gauge", "", "How much later rules look at messages, since a source sends out of order."),
    "rule_suspended": ("gauge", "rule", "1 while a rule of kind cel or python is suspended."),
    "rule_dropped_total": ("counter", "rule", "Messages that a rule of kind cel or python was not evaluated for."),
    "reaction_delivered_total": ("counter", "reaction", "Edges that were delivered."),
    "reaction_retries_total": ("counter", "reaction", "Attempts that were repeated."),
    "reaction_dead_total": ("counter", "reaction", "Edges that were given up."),
    "reaction_waiting": ("gauge", "reaction", "Edges on their way."),
    "reaction_journal_entries": ("gauge", "", "Edges on their way that a restart would find on the disk."),
    "reaction_journal_unkept_total": ("counter", "", "Edges that were in memory only, since the disk refused."),
}
"""Name without prefix -> kind, label, meaning."""


@dataclass
class SettingsRefusal:
    """The last refusal of settings: `error` is empty while the newest ones are at work."""

    error: str = ""
    time: int = 0
    count: int = 0


@dataclass
class DetectorStatus:
    """The pages of one detector. `unreachable`: the reason why it waits for something else, such as the broker;
    `journal`: the document of the delivery journal; `report`: whether the newest settings are at work."""

    detector: EventDetector
    clock_ns: Callable[[], int]
    refusal: SettingsRefusal = field(default_factory=SettingsRefusal)
    unreachable: Callable[[], str] = str
    journal: Callable[[], Mapping[str, Any]] = lambda: MEMORY_ONLY
    report: SettingsReport = field(default_factory=SettingsReport)

    def not_ready(self) -> str:
        """The reason why it is not ready, in words; empty when it is."""
        return self.detector.not_ready or self.report.complaint or self.unreachable()

    def document(self) -> dict[str, Any]:
        """The document of `GET /status`."""
        detector = self.detector
        refusal = self.refusal
        reached = self.detector.reached
        engine = detector.engine
        workers = detector.workers
        problems = list(engine.problems.items())[:PROBLEMS_MAX]
        return {
            "name": detector.settings.name,
            "state": reached.state,
            "state_asked": reached.asked,
            "state_since": reached.since,
            "not_ready": self.not_ready(),
            "started": detector.started,
            "now": self.clock_ns(),
            "settings": {"applied": detector.applied, "refused": refusal.error, "refusals": refusal.count},
            "buffer": {"bytes": detector.pool.bytes, "bytes_max": detector.settings.buffer_bytes},
            "topics": {
                name: {**topic, "unseen": dict(detector.unseen.of(name))}
                for name, topic in detector.topics.document().items()
            },
            "topic_problems": dict(detector.topics.problems),
            "rules": {
                "names": [rule.name for rule in engine.rules],
                "active": [{"id": e.id, "rule": e.rule, "agents": list(e.agents)} for e in engine.active],
                "wait_seconds": detector.wait_ns / 1e9,
                "unseen": dict(detector.unseen.totals),
                "apart": apart_documents(engine)[:PROBLEMS_MAX],
                "problems": [{"rule": r, "topic": t, "problem": text} for (r, t), text in problems],
                "workers": {} if workers is None else workers.document(),
            },
            "reactions": detector.dispatcher.document(),
            "reactions_journal": dict(self.journal()),
            "dead_letters": detector.dispatcher.box.documents(),
            "recordings": {
                recordings.plan.recording: recordings.counts() for recordings in detector.recordings.at_work
            },
        }

    def metrics(self) -> str:
        """The text of `GET /metrics`."""
        series_by_name: dict[str, list[str]] = {name: [] for name in METRICS}
        for name, label, value in self._values():
            key = METRICS[name][1]
            labels = f'{{{key}="{_escaped(label)}"}}' if key else ""
            series_by_name[name].append(f"{PREFIX}{name}{labels} {value}")
        lines: list[str] = []
        for name, series in series_by_name.items():
            if series:
                kind, _, text = METRICS[name]
                lines += [f"# HELP {PREFIX}{name} {text}", f"# TYPE {PREFIX}{name} {kind}", *series]
        return "\n".join([*lines, *self._recordings()]) + "\n"

    def _values(self) -> Iterator[tuple[str, str, float]]:
        detector = self.detector
        yield from (("info", state, int(state == detector.reached.state)) for state in STATES)
        yield "ready", "", int(not self.not_ready())
        yield "settings_refused", "", int(bool(self.refusal.error))
        yield "events_total", "", detector.dispatcher.dispatched
        yield "unreadable_total", "", sum(detector.engine.counts.malformed.copy().values())
        yield from (("unseen_total", reason, count) for reason, count in detector.unseen.totals.items())
        yield from (("rule_apart_total", rule, apart.total) for rule, apart in detector.engine.apart.items())
        yield from (("rule_ignored_total", rule, count) for rule, count in detector.engine.ignored.items())
        yield "rules_wait_seconds", "", detector.wait_ns / 1e9
        now = self.clock_ns()
        states = Counter(source_state(topic, now) for topic in list(detector.topics.topics.values()))
        yield from (("sources", state, states[state]) for state in SOURCE_STATES)
        for pattern, sums in self._topics().items():
            yield from ((name, pattern, value) for name, value in sums.items())
        active = [edge.rule for edge in detector.engine.active]
        yield from (("active_events", rule.name, active.count(rule.name)) for rule in detector.engine.rules)
        workers = {} if detector.workers is None else detector.workers.document()
        for rule, worker in workers.items():
            yield "rule_suspended", rule, int(worker["state"] == "suspended")
            yield "rule_dropped_total", rule, worker["dropped"]
        journal = self.journal()
        yield "reaction_journal_entries", "", journal["kept"]
        yield "reaction_journal_unkept_total", "", journal["unkept"]
        for reaction, counts in detector.dispatcher.document().items():
            yield "reaction_waiting", reaction, counts["waiting"]
            yield from ((f"reaction_{key}_total", reaction, counts[key]) for key in ("delivered", "retries", "dead"))

    def _topics(self) -> dict[str, dict[str, int]]:
        """Topic pattern -> gauges of its topics now, and counters since the start."""
        topics = self.detector.topics
        sums = {
            pattern: dict.fromkeys(TOPIC_GAUGES, 0) | {f"{name}_total": value for name, value in counted.items()}
            for pattern, counted in topics.pattern_counters.read().items()
        }
        for topic in topics.document().values():
            values = (1, topic["matched"], int(topic["stale"]), int(bool(topic["problem"])))
            for key, value in zip(TOPIC_GAUGES, values, strict=False) if topic["pattern"] in sums else ():
                sums[topic["pattern"]][key] += value
        for pattern, buffer in topics.buffers_by_pattern():
            if pattern in sums:
                sums[pattern]["buffer_messages"] += len(buffer)
                sums[pattern]["buffer_bytes"] += buffer.bytes
        return sums

    def _recordings(self) -> Iterator[str]:
        for recordings in self.detector.recordings.at_work:
            label = f'recording="{_escaped(recordings.plan.recording)}"'
            yield f"robotkube_recorder_waiting_writes{{{label}}} {recordings.waiting}"
            for key, value in recordings.counts().items():
                yield f"robotkube_recorder_{key}_total{{{label}}} {value}"


def apart_documents(engine: RuleEngine) -> list[dict[str, Any]]:
    """The pairs that rules did not compare, since their stamps were too far apart: rule, agents, how often, and the
    seconds between the stamps at last."""
    return [
        {"rule": rule, "agents": list(agents), "count": count, "seconds": seconds}
        for rule, apart in engine.apart.items()
        for agents, (count, seconds) in sorted(apart.seconds().items())
    ]


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")
