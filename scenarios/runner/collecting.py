"""Reads what a run has left behind, from where it is: claims, database, detector, manager, forge."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.adapters.mongodb_pymongo import Account, connect
from robotkube.domain.errors import RobotKubeError
from robotkube.domain.recordings import INDEX, RECORDINGS, SAMPLES
from scenarios.definition import Scenario, cloud_topic, pose_topic, transform_topic
from scenarios.runner import storage
from scenarios.runner.access import Access
from scenarios.runner.inputs import Edge, InputCounters, LedgerLine, Plan, Recording, Stored, TopicCount
from scenarios.runner.placing import LEDGER, Volumes
from scenarios.runner.waiting import RunError

DETECTOR = "event-detector"
MANAGER_PORT = 8080
DATABASE_SECONDS_MAX = 60.0
RECORDINGS_CLAIM = "recordings"


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


def edges(access: Access, scenario: Scenario) -> tuple[Edge, ...]:
    """The edges that the event detector remembers."""
    document = access.pod_json(scenario.story.recording_agent, detector_pod(access, scenario), "events")
    return tuple(read_edge(values) for values in document["events"])


def plans(access: Access) -> tuple[Plan, ...]:
    """The plans that the manager remembers."""
    document = access.service_json("manager", "plans", MANAGER_PORT)
    return tuple(read_plan(values) for values in document["plans"])


def read_edge(values: Mapping[str, Any]) -> Edge:
    """An edge from its JSON form."""
    return Edge(
        id=values["id"],
        rule=values["rule"],
        edge=values["edge"],
        agents=tuple(values["agents"]),
        time=values["time"],
        stamp=values["stamp"],
        distance_m=values.get("distance_m"),
        trace=values["trace"],
        task=values.get("task"),
        done=values.get("done"),
        error=values.get("error"),
    )


def read_plan(values: Mapping[str, Any]) -> Plan:
    """A plan from its JSON form."""
    return Plan(
        plan=values["plan"],
        subject=values["subject"],
        cause=values["cause"],
        tasks=tuple(values["tasks"]),
        events=tuple(values["events"]),
        started=values["started"],
        proposed=values.get("proposed"),
        merged=values.get("merged"),
        observed=values.get("observed"),
        pull_request=values.get("pull_request"),
        commit=values.get("commit"),
        changed=tuple(values["changed"]),
        created=tuple(values["created"]),
        removed=tuple(values["removed"]),
        error=values.get("error"),
    )


def _count(values: Mapping[str, Any]) -> TopicCount:
    return TopicCount(
        int(values["received"]),
        int(values["dropped"]),
        {int(second): int(count) for second, count in values["seconds"]},
        {int(age): int(count) for age, count in values["ages_ms"]},
    )


def ledger_file(claim: Path, run: str, topic: str) -> Path:
    """Where a player writes the ledger of a topic."""
    return claim / LEDGER / run / f"{topic.replace('/', '__')}.jsonl"


def ledger_ended(file: Path) -> bool:
    """Whether a ledger has its last line."""
    try:
        with file.open("rb") as stream:
            stream.seek(max(0, file.stat().st_size - 200))
            return b'"end"' in stream.read().rstrip().rpartition(b"\n")[2]
    except OSError:
        return False


def ledgers(
    scenario: Scenario, claims: Mapping[str, Path], run: str, warn: Callable[[str], None]
) -> dict[str, tuple[LedgerLine, ...]]:
    """The ledgers of the lidar vehicles; one that is missing or has no true end is left out and named."""
    found = {}
    for agent in scenario.lidar_vehicles:
        for topic in (pose_topic(agent), cloud_topic(agent), transform_topic(agent)):
            file = ledger_file(claims[agent], run, topic)
            try:
                found[topic] = storage.ledger(json.loads(line) for line in file.read_text().splitlines())
            except (OSError, ValueError, KeyError) as error:
                warn(f"ledger of {topic}: {error}")
    return found


def stored(
    access: Access, scenario: Scenario, volumes: Volumes, events: Sequence[str]
) -> tuple[tuple[Recording, ...], tuple[Stored, ...]]:
    """Recordings of the given events, and all their messages, read back from database and segments."""
    namespace = scenario.story.recording_agent
    secret, address = access.secret(namespace, "database-account"), access.endpoint("database")
    account = Account(
        address.host,
        address.port,
        secret["database"],
        secret["username"],
        secret["password"],
        secret["authenticationDatabase"],
    )
    try:
        database = connect(account, DATABASE_SECONDS_MAX)
        known = [storage.recording(document) for document in database[RECORDINGS].find()]
        mine = tuple(recording for recording in known if recording.event in events)
        names = {"recording": {"$in": [recording.name for recording in mine]}}
        samples, index = list(database[SAMPLES].find(names)), list(database[INDEX].find(names))
        database.client.close()
    except Exception as error:
        raise RunError(f"database {account.host}:{account.port} as {account.username}: {error}") from error
    return mine, storage.stored(samples, index, segment_finder(scenario, volumes))


def segment_finder(scenario: Scenario, volumes: Volumes) -> storage.FindSegment:
    """Finds a segment's file by its volume `<node>/<claim>`: the claim of the agent whose node it is."""
    agents = {node.name: node.agent for node in scenario.nodes}
    folders: dict[str, Path | None] = {}

    def find(volume: str, path: str) -> Path | None:
        if volume not in folders:
            node, _, claim = volume.partition("/")
            folders[volume] = _folder(volumes, agents.get(node), claim)
        folder = folders[volume]
        return folder / path if folder else None

    return find


def _folder(volumes: Volumes, agent: str | None, claim: str) -> Path | None:
    from ci.errors import SetUpError

    try:
        return volumes.volume_path(agent, claim) if agent else None
    except SetUpError:
        return None


def attempt(what: str, read: Callable[[], Any], otherwise: Any, warn: Callable[[str], None]) -> Any:
    """What `read` gives; on failure a warning and `otherwise`, so that the report shows what is known."""
    try:
        return read()
    except (RunError, RobotKubeError, KeyError, TypeError, ValueError) as error:
        warn(f"{what}: {type(error).__name__}: {error}")
        return otherwise
