"""Reads what a run has left behind, from where it is: volume claims, database, detector, manager, forge."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from robotkube.foundation.database.adapters.connection import connect
from robotkube.robots.recording.core.documents import AUDITS, INDEX, RECORDINGS, SAMPLES
from scenarios.definition import Scenario, cloud_topic, pose_topic, transform_topic
from scenarios.runner import storage
from scenarios.runner.access import Access
from scenarios.runner.inputs import AuditGap, Edge, InputCounters, LedgerLine, Plan, Recording, Stored, TopicCount
from scenarios.runner.placing import LEDGER, Volumes
from scenarios.runner.waiting import RunError

DETECTOR = "event-detector"
MANAGER_PORT = 8080
DATABASE_SECONDS_MAX = 60.0
RECORDINGS_CLAIM = "recordings"


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


def ledger_file(volume: Path, run: str, topic: str) -> Path:
    """Where a player writes the ledger of a topic."""
    return volume / LEDGER / run / f"{topic.replace('/', '__')}.jsonl"


def ledger_ended(file: Path) -> bool:
    """Whether a ledger has its last line."""
    try:
        with file.open("rb") as stream:
            stream.seek(max(0, file.stat().st_size - 200))
            return b'"end"' in stream.read().rstrip().rpartition(b"\n")[2]
    except OSError:
        return False


def ledgers(
    scenario: Scenario, volumes: Mapping[str, Path], run: str, reading: Collecting
) -> dict[str, tuple[LedgerLine, ...]]:
    """The ledgers of the lidar vehicles; one that is missing or has no true end is left out and named."""
    complete = {}
    for agent in scenario.lidar_vehicles:
        for topic in (pose_topic(agent), cloud_topic(agent), transform_topic(agent)):
            file = ledger_file(volumes[agent], run, topic)
            lines = reading.read(f"ledger of {topic}", partial(_ledger, file), None, "ledgers")
            if lines is not None:
                complete[topic] = lines
    return complete


def _ledger(file: Path) -> tuple[LedgerLine, ...]:
    return storage.ledger(json.loads(line) for line in file.read_text().splitlines())


def stored(
    access: Access, scenario: Scenario, volumes: Volumes, events: Sequence[str]
) -> tuple[tuple[Recording, ...], tuple[Stored, ...], tuple[AuditGap, ...]]:
    """Recordings of the given events, all their messages, read back from database and segments, and what their audits
    name as missing."""
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
    return mine, storage.stored(samples, index, segment_finder(scenario, volumes)), storage.gaps(audits)


def segment_finder(scenario: Scenario, volumes: Volumes) -> storage.FindSegment:
    """Finds a segment's file by its volume `<node>/<volume claim>`: that of the agent whose node it is."""
    agents = {node.name: node.agent for node in scenario.nodes}
    folders: dict[str, Path | None] = {}

    def find(volume: str, path: str) -> Path | None:
        if volume not in folders:
            node, _, volume_claim = volume.partition("/")
            folders[volume] = _folder(volumes, agents.get(node), volume_claim)
        folder = folders[volume]
        return folder / path if folder else None

    return find


def _folder(volumes: Volumes, agent: str | None, volume_claim: str) -> Path | None:
    from ci.errors import SetUpError

    try:
        return volumes.volume_path(agent, volume_claim) if agent else None
    except SetUpError:
        return None
