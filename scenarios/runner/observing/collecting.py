"""Reads what a run has left behind, from where it is: volume claims, database, detector, manager, forge."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ci.cluster_contract.provider import Volumes
from ci.errors import SetUpError
from robotkube.foundation.database.adapters.connection import connect
from robotkube.robots.recording.core.documents import AUDITS, INDEX, RECORDINGS, SAMPLES
from scenarios.definition import Scenario, cloud_topic, pose_topic, transform_topic
from scenarios.runner.inputs import AuditGap, Edge, InputCounters, LedgerLine, Plan, Recording, Stored, TopicCount
from scenarios.runner.observing import storage
from scenarios.runner.platform.access import Access
from scenarios.runner.platform.placing import LEDGER, VOLUME_CLAIM
from scenarios.runner.waiting import RunError

DETECTOR = "event-detector"
MANAGER_PORT = 8080
DATABASE_SECONDS_MAX = 60.0
RECORDINGS_CLAIM = "recordings"
LAST_LINE_BYTES_MAX = 200  # of a ledger


class Collecting:
    """Reads one source after the other and goes on when one cannot be read: `warnings` say what, `missing` names the
    fields of RunInputs that are not whole, so that no expectation treats them as empty."""

    def __init__(self, warn: Callable[[str], None]) -> None:
        self._warn = warn
        self.missing: set[str] = set()

    def read(self, what: str, source: Callable[[], Any], otherwise: Any, *fields: str) -> Any:
        """What `source` gives; whatever it raises is a warning, and `otherwise` is taken for these fields."""
        try:
            return source()
        except Exception as error:  # of any library: a report that is lost cannot be collected again
            self._lost(what, error, fields)
            return otherwise

    def read_each(self, what: str, items: Iterable[Any], form: Callable[[Any], Any], *fields: str) -> tuple[Any, ...]:
        """Those of `items` that can be read; the others are warnings."""
        readable = []
        for item in items:
            try:
                readable.append(form(item))
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                self._lost(f"{what} {_name(item)}", error, fields)
        return tuple(readable)

    def _lost(self, what: str, error: Exception, fields: tuple[str, ...]) -> None:
        self.missing.update(fields)
        self._warn(f"{what}: {type(error).__name__}: {error}")


def _name(item: object) -> str:
    """The name of a document that cannot be read: by its name if it has one, else by its beginning."""
    document = item if isinstance(item, Mapping) else {}
    return str(document.get("plan") or document.get("id") or repr(item))[:80]


def detector_pod(access: Access, scenario: Scenario) -> str:
    """Name of the pod of the operator's event detector."""
    namespace = scenario.story.recording_agent
    names = [
        pod.metadata.name
        for pod in access.pods(namespace)
        if (pod.metadata.labels or {}).get("app.kubernetes.io/instance") == DETECTOR
        and pod.metadata.deletion_timestamp is None
    ]
    if len(names) != 1:
        raise RunError(
            f"release {namespace}/{DETECTOR} has {len(names)} pods, and must have one\n{access.state([namespace])}"
        )
    return str(names[0])


def input_counters(access: Access, scenario: Scenario) -> InputCounters:
    """One reading of the counters at the event detector's input."""
    document = access.pod_json(scenario.story.recording_agent, detector_pod(access, scenario), "input")
    return InputCounters(
        int(document["started"]), {topic: _count(values) for topic, values in document["topics"].items()}
    )


def edges(access: Access, scenario: Scenario, reading: Collecting) -> tuple[Edge, ...]:
    """The edges that the event detector remembers."""
    document = access.pod_json(scenario.story.recording_agent, detector_pod(access, scenario), "events")
    return reading.read_each("event", document["events"], read_edge, "edges")


def plans(access: Access, reading: Collecting) -> tuple[Plan, ...]:
    """The plans that the manager remembers."""
    document = access.service_json("manager", "plans", MANAGER_PORT)
    return reading.read_each("plan", document["plans"], read_plan, "plans")


def read_edge(values: Mapping[str, Any]) -> Edge:
    """An edge from its JSON form; KeyError, TypeError or ValueError when it has another one."""
    return Edge(
        id=values["id"],
        rule=values["rule"],
        edge=values["edge"],
        agents=tuple(values["agents"]),
        time=_moment(values, "time"),
        stamp=_moment(values, "stamp"),
        distance_m=values.get("distance_m"),
        trace=values["trace"],
        task=values.get("task"),
        done=_moment_or_none(values, "done"),
        error=values.get("error"),
    )


def read_plan(values: Mapping[str, Any]) -> Plan:
    """A plan from its JSON form; KeyError, TypeError or ValueError when it has another one."""
    return Plan(
        plan=values["plan"],
        subject=values["subject"],
        cause=values["cause"],
        tasks=tuple(values["tasks"]),
        events=tuple(values["events"]),
        started=_moment_or_none(values, "started"),
        proposed=_moment_or_none(values, "proposed"),
        merged=_moment_or_none(values, "merged"),
        observed=_moment_or_none(values, "observed"),
        pull_request=values.get("pull_request"),
        commit=values.get("commit"),
        changed=tuple(values["changed"]),
        created=tuple(values["created"]),
        removed=tuple(values["removed"]),
        error=values.get("error"),
    )


def _moment_or_none(values: Mapping[str, Any], key: str) -> int | None:
    return None if values.get(key) is None else _moment(values, key)


def _moment(values: Mapping[str, Any], key: str) -> int:
    if type(values[key]) is not int:
        raise ValueError(f"{key} is {values[key]!r:.40}, and must be ns since 1970")
    return int(values[key])


def _count(values: Mapping[str, Any]) -> TopicCount:
    return TopicCount(
        int(values["received"]),
        int(values["dropped"]),
        {int(second): int(count) for second, count in values["seconds"]},
        {int(age): int(count) for age, count in values["ages_ms"]},
        {int(second): (int(p50), int(p99)) for second, p50, p99 in values.get("age_quantiles_ms", ())},
    )


def ledger_file(run: str, topic: str) -> str:
    """The path of the ledger that a player writes of a topic, in the volume claim of its agent."""
    return f"{LEDGER}/{run}/{topic.replace('/', '__')}.jsonl"


def ledger_ended(volumes: Volumes, agent: str, file: str) -> bool:
    """Return whether a ledger has its last line."""
    return b'"end"' in volumes.end_of((agent, VOLUME_CLAIM), file, LAST_LINE_BYTES_MAX).rstrip().rpartition(b"\n")[2]


def ledgers(scenario: Scenario, volumes: Volumes, run: str, reading: Collecting) -> dict[str, tuple[LedgerLine, ...]]:
    """The ledgers of the lidar vehicles; one that is missing or has no true end is left out and named."""
    complete = {}
    for agent in scenario.lidar_vehicles:
        for topic in (pose_topic(agent), cloud_topic(agent), transform_topic(agent)):
            source = partial(_ledger, volumes, agent, ledger_file(run, topic))
            lines = reading.read(f"ledger of {topic}", source, None, "ledgers")
            if lines is not None:
                complete[topic] = lines
    return complete


def _ledger(volumes: Volumes, agent: str, file: str) -> tuple[LedgerLine, ...]:
    text = volumes.fetch((agent, VOLUME_CLAIM), file).read_text()
    return storage.ledger(json.loads(line) for line in text.splitlines())


def stored(
    access: Access, scenario: Scenario, find: storage.FindSegment, events: Sequence[str]
) -> tuple[tuple[Recording, ...], tuple[Stored, ...], tuple[AuditGap, ...]]:
    """Recordings of the given events, all their messages, read back from database and the segments that `find` finds,
    and what their audits name as missing."""
    namespace = scenario.story.recording_agent
    with tempfile.TemporaryDirectory(prefix="database-") as folder:
        account = access.database_account(namespace, Path(folder))
        try:
            database = connect(account, DATABASE_SECONDS_MAX)
            known = [storage.recording(document) for document in database[RECORDINGS].find()]
            mine = tuple(recording for recording in known if recording.event in events)
            names = {"recording": {"$in": [recording.name for recording in mine]}}
            samples, index = list(database[SAMPLES].find(names)), list(database[INDEX].find(names))
            audits = list(database[AUDITS].find(names))
            database.client.close()
        except Exception as error:
            raise RunError(f"database {account.host}:{account.port} as {account.username}: {error}") from error
    return mine, storage.stored(samples, index, find), storage.gaps(audits)


def segment_finder(agents: Mapping[str, str], volumes: Volumes) -> storage.FindSegment:
    """Finds a segment's file by its volume `<node>/<volume claim>`: that of the agent whose node it is. `agents`: by
    node."""
    used: dict[tuple[str, str], bool] = {}

    def find(volume: str, path: str) -> Path | None:
        node, _, name = volume.partition("/")
        claim = agents.get(node, ""), name
        if claim not in used:
            used[claim] = bool(claim[0]) and _usable(volumes, claim)
        return _fetched(volumes, claim, path) if used[claim] else None

    return find


def _usable(volumes: Volumes, claim: tuple[str, str]) -> bool:
    try:
        volumes.use([claim])
    except SetUpError:
        return False
    return True


def _fetched(volumes: Volumes, claim: tuple[str, str], path: str) -> Path | None:
    try:
        return volumes.fetch(claim, path)
    except SetUpError:
        return None
