"""Inputs of a report, what is known of a run when it has ended: plain values, gathered by `collecting` and judged by
`expectations`.

All times are integers in ns since 1970, unless a name says otherwise; None means: not seen, or not yet reached.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ci.cluster_contract.network_conditions import Measured, Traffic

NANOSECONDS = 1_000_000_000
STORY = "story"


@dataclass(frozen=True)
class LedgerLine:
    """One message a player has published: number, header.stamp, hash of the whole serialised message."""

    sequence: int
    stamp: int
    sha256: str


@dataclass(frozen=True)
class Stored:
    """One message found in storage. `sha256` is computed from the bytes read back: empty when they could not be read.

    `received` and `stored` are the recorder's times: arrival, and acknowledgement by the database (large messages
    only). `position`: x and y in m of a pose.
    """

    recording: str
    topic: str
    stamp: int
    received: int
    sha256: str
    stored: int | None = None
    volume: str | None = None
    position: tuple[float, float] | None = None


@dataclass(frozen=True)
class Recording:
    """A recording's provenance."""

    name: str
    task: str
    event: str


@dataclass(frozen=True)
class Edge:
    """A rule's rising (`start`) or falling (`stop`) edge as the event detector reports it."""

    id: str
    rule: str
    edge: str
    agents: tuple[str, ...]
    time: int
    stamp: int
    distance_m: float | None
    trace: str
    task: str | None
    done: int | None
    error: str | None = None


@dataclass(frozen=True)
class Plan:
    """A plan as the manager reports it. One that a manager found on main when it began has no times."""

    plan: str
    subject: str
    cause: str
    tasks: tuple[str, ...]
    events: tuple[str, ...]
    started: int | None
    proposed: int | None
    merged: int | None
    observed: int | None
    pull_request: int | None
    commit: str | None
    changed: tuple[str, ...]
    created: tuple[str, ...]
    removed: tuple[str, ...]
    error: str | None = None


@dataclass(frozen=True)
class PullRequestOfRun:
    """A pull request of the deployment repository; `commit` is what the forge says was merged."""

    number: int
    title: str
    merged: bool
    commit: str | None


@dataclass(frozen=True)
class Commit:
    """A commit of main, with its trailers by name without `RobotKube-` and the paths it touches."""

    sha: str
    parents: tuple[str, ...]
    author: str
    subject: str
    time: int
    trailers: Mapping[str, tuple[str, ...]]
    paths: tuple[str, ...]


@dataclass(frozen=True, order=True)
class ReleasedChart:
    """A chart that a release on main named during the run: by digest, with the evidence that the release named."""

    chart: str
    version: str
    digest: str
    evidence: str
    release: str


@dataclass(frozen=True)
class TopicCount:
    """Counters of one topic at the event detector's input: per unix second of arrival, and per age in whole ms;
    `age_quantiles_ms`: p50 and p99 of the ages per second, empty when the detector does not offer them."""

    received: int
    dropped: int
    seconds: Mapping[int, int]
    ages_ms: Mapping[int, int]
    age_quantiles_ms: Mapping[int, tuple[int, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class InputCounters:
    """One reading of the counters; `started` tells whether two readings are of one process."""

    started: int
    topics: Mapping[str, TopicCount]


@dataclass(frozen=True)
class BrokerMessages:
    """Messages of a topic that the observer got from the broker in one batch."""

    time: int
    topic: str
    count: int


@dataclass(frozen=True)
class BrokerResult:
    """A result of a perception service that crossed the broker: the text of a std_msgs/String."""

    time: int
    topic: str
    text: str


@dataclass(frozen=True)
class BrokerLog:
    """What the observer saw, and from when to when it was subscribed; `gaps` counts lost connections in between."""

    since: int
    until: int
    gaps: int
    messages: tuple[BrokerMessages, ...]
    results: tuple[BrokerResult, ...] = ()


@dataclass(frozen=True)
class CoresUsed:
    """Cores by component on average from each of `times` to the next: one value less than there are times."""

    times: tuple[int, ...]
    components: Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class PodOfRun:
    """A pod's life as the watch saw it."""

    namespace: str
    name: str
    uid: str
    created: int
    running: int | None = None
    ready: int | None = None
    deleted: int | None = None


@dataclass(frozen=True)
class TaskCondition:
    """A condition of a task as the watch saw it change."""

    time: int
    type: str
    status: str
    reason: str
    message: str


@dataclass(frozen=True)
class TaskLife:
    """A task's life as the watch saw it. `parent` is the key of the task that launched its operator, or empty."""

    key: str
    created: int
    spec: Mapping[str, Any]
    parent: str = ""
    conditions: tuple[TaskCondition, ...] = ()
    deleted: int | None = None


@dataclass(frozen=True)
class StepDone:
    """A step of the story: when it began, when what it leads to was seen (None: not within its bound), what it did."""

    name: str
    what: str
    began: int
    done: int | None


@dataclass(frozen=True)
class MainState:
    """One commit of main: the tasks that each release names."""

    commit: str
    tasks: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class AuditGap:
    """Messages of a topic that the audit of a recording says are missing: where and why, how many (None: nobody can
    know), and between which stamps, both included."""

    recording: str
    topic: str
    where: str
    why: str
    count: int | None
    first: int
    last: int


@dataclass(frozen=True)
class HoleDone:
    """A hole in coverage as it was asked for, and when it began, in s since the start (None: it was not opened)."""

    at_seconds: float
    seconds: float
    began_seconds: float | None


@dataclass(frozen=True)
class NetworkOfRun:
    """The cable of an agent that had conditions: what was asked for by the keys of the scenario, where in the path it
    acts, what a probe measured before the run, and what `up` and `down` carried during it."""

    agent: str
    asked: Mapping[str, float]
    acts: tuple[str, ...]
    measured: Measured | None
    traffic: Mapping[str, Traffic]
    holes: tuple[HoleDone, ...]
    relay_dropped: int


@dataclass(frozen=True)
class RunInputs:
    """Everything the report is computed from. `releases_*` map a release to a digest of its specification; `summaries`
    maps the digest of each verification summary in the catalogue to the digest of the chart that it is about, empty
    when it is not believed; `history` has main's commits of the run, the one before it first; `gaps` is what the audits
    of the recordings name; `missing` names the fields here that could not be read, or not whole, and STORY when the run
    broke off."""

    run: str
    provider: str
    started: int
    ended: int
    ledgers: Mapping[str, tuple[LedgerLine, ...]]
    stored: tuple[Stored, ...]
    recordings: tuple[Recording, ...]
    edges: tuple[Edge, ...]
    plans: tuple[Plan, ...]
    pull_requests: tuple[PullRequestOfRun, ...]
    commits: tuple[Commit, ...]
    input_before: InputCounters | None
    input_after: InputCounters | None
    broker: BrokerLog | None
    pods: tuple[PodOfRun, ...]
    releases_before: Mapping[str, str]
    releases_after: Mapping[str, str]
    released: tuple[ReleasedChart, ...] = ()
    summaries: Mapping[str, str] = field(default_factory=dict)
    cpu_core_seconds: Mapping[str, float] = field(default_factory=dict)
    cores: CoresUsed | None = None
    set_up_seconds: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    steps: tuple[StepDone, ...] = ()
    tasks: tuple[TaskLife, ...] = ()
    history: tuple[MainState, ...] = ()
    gaps: tuple[AuditGap, ...] = ()
    cables: tuple[NetworkOfRun, ...] = ()
    missing: frozenset[str] = frozenset()
