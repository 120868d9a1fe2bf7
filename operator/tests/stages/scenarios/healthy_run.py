"""A run as it should be, made of what a run leaves behind: ledgers, database documents, segment files, answers of
services.

Tests change one of these and see what the report says. Two encounters, three vehicles, poses and clouds at 10 Hz.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer

from scenarios import definition
from scenarios.generator import routes
from scenarios.generator.messages import PoseWriter
from scenarios.runner import inputs
from scenarios.runner.observing import storage
from scenarios.runner.reporting import report
from tests.stages.paths import SCENARIOS

FOLDER = SCENARIOS / "pose-point-cloud-db-recording"
SECOND = 1_000_000_000
POSE_HZ = 10
START = 1_795_250_000 * SECOND
DELAY = 12_000_000  # from a message's stamp to its reception
WRITER = PoseWriter()
VOLUME = "cloud-0/recordings"
RECORDER = "cloud-0/recorder-vehicle-00-vehicle-01"
DIGEST, SUMMARY_DIGEST = "sha256:" + "a" * 64, "sha256:" + "b" * 64


@cache
def payload(topic: str, stamp: int) -> bytes:
    """A message that begins as every stamped message does and has a body of its own; a pose is one of the route."""
    if topic in _numbers():
        motion = routes.motion(_scenario().parameters, _numbers()[topic], np.array([(stamp - START) / SECOND]))
        return WRITER.message(stamp, float(motion.x[0]), float(motion.y[0]), float(motion.yaw[0]))
    body = hashlib.sha256(f"{topic}/{stamp}".encode()).digest()
    return b"\x00\x01\x00\x00" + struct.pack("<iI", *divmod(stamp, SECOND)) + body


@cache
def digest(topic: str, stamp: int) -> str:
    """The digest of that message."""
    return hashlib.sha256(payload(topic, stamp)).hexdigest()


@cache
def _numbers() -> dict[str, int]:
    """The number of its vehicle, by pose topic."""
    return {definition.pose_topic(agent): number for number, agent in enumerate(_scenario().vehicles)}


@dataclass
class Run:
    """Everything a run leaves behind, to be changed; `judge` computes the report of it as it then is."""

    scenario: definition.Scenario
    claim: Path
    ledgers: dict[str, list[dict[str, Any]]]
    recordings: list[dict[str, Any]]
    samples: list[dict[str, Any]]
    index: list[dict[str, Any]]
    known: inputs.RunInputs

    def judge(self) -> report.Report:
        return report.report(self.scenario, self.inputs())

    def inputs(self) -> inputs.RunInputs:
        """What the report is made of."""
        return replace(
            self.known,
            ledgers={topic: storage.ledger(lines) for topic, lines in self.ledgers.items()},
            recordings=tuple(storage.recording(document) for document in self.recordings),
            stored=storage.stored(self.samples, self.index, self.segment),
        )

    def segment(self, volume: str, path: str) -> Path | None:
        return self.claim / path if volume == VOLUME else None

    def failed(self) -> set[str]:
        """Names of the expectations that do not hold."""
        return {row.name for row in self.judge().table if not row.passed}

    def change(self, **values: Any) -> None:
        self.known = replace(self.known, **values)


@cache
def _scenario() -> definition.Scenario:
    return definition.load(FOLDER, ["vehicles=3", f"pose_hz={POSE_HZ}", "encounters=2"])


def healthy(folder: Path) -> Run:
    scenario = _scenario()
    run = Run(scenario, folder, {}, [], [], [], _known(scenario))
    end = routes.duration_seconds(scenario.parameters)
    for agent in scenario.lidar_vehicles:
        for topic, offset, period, count in _streams(agent, end):
            run.ledgers[topic] = [*_ledger(topic, offset, period, count), {"end": True, "count": count}]
    for number, edge in enumerate(edge for edge in run.known.edges if edge.edge == "start"):
        _record(run, number, edge, run.known.edges[2 * number + 1])
    return run


def _streams(agent: str, seconds: int) -> Iterator[tuple[str, int, int, int]]:
    """Topic, offset and period in ns, number of messages."""
    yield definition.pose_topic(agent), 0, SECOND // POSE_HZ, seconds * POSE_HZ
    yield definition.cloud_topic(agent), 5_000_000, SECOND // 10, seconds * 10
    yield definition.transform_topic(agent), 0, 0, 1


def _ledger(topic: str, offset: int, period: int, count: int) -> Iterator[dict[str, Any]]:
    for sequence in range(count):
        stamp = START + offset + sequence * period
        yield {"sequence": sequence, "stamp": stamp, "sha256": digest(topic, stamp)}


def _record(run: Run, number: int, start: inputs.Edge, stop: inputs.Edge) -> None:
    """Poses from 3 s and clouds from 4 s after the event to a little after the stop, the transforms from the
    beginning."""
    name = f"recording-{number}"
    run.recordings.append({"_id": name, "provenance": {"task": start.task, "event": start.id, "rule": start.rule}})
    segment = f"{name}/1.mcap"
    (run.claim / name).mkdir()
    with (run.claim / segment).open("wb") as stream:
        writer = Writer(stream, use_chunking=False, compression=CompressionType.NONE, index_types=IndexType.NONE)
        writer.start("ros2")
        for topic, lines in run.ledgers.items():
            begin = start.time + (4 if topic.endswith("pointcloud") else 3) * SECOND
            stamps = [line["stamp"] for line in lines if "stamp" in line]
            if topic.endswith("transform"):
                begin = 0
            chosen = [stamp for stamp in stamps if begin <= stamp <= stop.time + SECOND]
            if topic.endswith("pointcloud"):
                channel = writer.register_channel(topic, "cdr", 0)
                for stamp in chosen:
                    writer.add_message(channel, stamp + DELAY, payload(topic, stamp), stamp)
                    run.index.append(_entry(name, topic, stamp, segment))
            else:
                run.samples += [_bucket(name, topic, stamp) for stamp in chosen]
        writer.finish()


def _entry(name: str, topic: str, stamp: int, segment: str) -> dict[str, Any]:
    return {
        "_id": f"{name}/{topic}/{stamp}",
        "recording": name,
        "topic": topic,
        "stamp": stamp,
        "received": stamp + DELAY,
        "sha256": digest(topic, stamp),
        "volume": VOLUME,
        "segment": segment,
        "offset": 0,
        "stored": stamp + DELAY + 20_000_000,
    }


def _bucket(name: str, topic: str, stamp: int) -> dict[str, Any]:
    received = stamp + DELAY
    data = payload(topic, stamp)
    sample = {"stamp": stamp, "received": received, "sha256": digest(topic, stamp), "data": data}
    return {"recording": name, "topic": topic, "second": stamp // SECOND, "samples": [sample]}


def _known(scenario: definition.Scenario) -> inputs.RunInputs:
    together = routes.encounter_seconds(scenario.parameters)
    times = [(5.0, 5.0 + together), (24.0 + together, 24.0 + 2 * together)]
    edges, plans, pods, seen = [], [_plan(0, "initial", None, START - 60 * SECOND)], [], []
    for number, (begin, end) in enumerate(times):
        start, stop = (START + int(moment * POSE_HZ) * SECOND // POSE_HZ for moment in (begin, end))
        edges += [_edge(number, "start", start), _edge(number, "stop", stop)]
        plans += [_plan(2 * number + 1, "task", edges[-2], start), _plan(2 * number + 2, "withdrawal", edges[-1], stop)]
        pod = inputs.PodOfRun(
            "cloud-0", f"recorder-vehicle-00-vehicle-01-{number}-x", f"uid-{number}", start + 2 * SECOND
        )
        pods.append(replace(pod, running=start + 3 * SECOND, ready=start + 3 * SECOND, deleted=stop + 5 * SECOND))
        seen += _seen(scenario, start + 4 * SECOND, stop + 2 * SECOND)
    seconds = routes.duration_seconds(scenario.parameters)
    ended = START + seconds * SECOND
    return inputs.RunInputs(
        run="run-1",
        provider="embedded",
        started=START,
        ended=ended,
        ledgers={},
        stored=(),
        recordings=(),
        edges=tuple(edges),
        plans=tuple(plans),
        pull_requests=tuple(_request(plan) for plan in plans),
        commits=(_seed(), *(_commit(plan) for plan in plans)),
        input_before=_counters(scenario, 0),
        input_after=_counters(scenario, seconds),
        broker=inputs.BrokerLog(START - SECOND, ended + SECOND, 0, tuple(seen)),
        pods=tuple(pods),
        released=(inputs.ReleasedChart("event-detector", "0.1.0", DIGEST, SUMMARY_DIGEST, RECORDER),),
        summaries={SUMMARY_DIGEST: DIGEST},
        releases_before={"vehicle-00/mqtt-bridge": "1"},
        releases_after={"vehicle-00/mqtt-bridge": "1"},
        cpu_core_seconds={"etcd": 1.5},
        cores=_cores(seconds),
    )


def _cores(seconds: int) -> inputs.CoresUsed:
    """Ten components, the first with half a core, each of the others with less."""
    times = tuple(START + (second - 2) * SECOND for second in range(seconds + 3))
    components = {f"component-{number}": (0.5 / (number + 1),) * (len(times) - 1) for number in range(10)}
    return inputs.CoresUsed(times, components)


def _edge(number: int, kind: str, stamp: int) -> inputs.Edge:
    return inputs.Edge(
        id=f"{number:032x}",
        rule="lidar-proximity",
        edge=kind,
        agents=("vehicle-00", "vehicle-01"),
        time=stamp + DELAY,
        stamp=stamp,
        distance_m=399.9,
        trace=f"{number:032x}",
        task=f"cloud-0/task-{number}",
        done=stamp + DELAY + 30_000_000,
    )


def _plan(number: int, cause: str, edge: inputs.Edge | None, time: int) -> inputs.Plan:
    return inputs.Plan(
        plan=f"20261121-10000{number}-abcdef",
        subject=f"deploy(recording): {number}",
        cause=cause,
        tasks=(edge.task,) if edge and edge.task else (),
        events=(edge.id,) if edge else (),
        started=time + 50_000_000,
        proposed=time + SECOND // 2,
        merged=time + SECOND,
        observed=time + 4 * SECOND,
        pull_request=number + 1,
        commit=f"{number + 1:040x}",
        changed=("vehicle-00/mqtt-bridge",),
        created=(RECORDER,) if cause == "task" else (),
        removed=(RECORDER,) if cause == "withdrawal" else (),
    )


def _request(plan: inputs.Plan) -> inputs.PullRequestOfRun:
    return inputs.PullRequestOfRun(plan.pull_request or 0, plan.subject, True, plan.commit)


def _seed() -> inputs.Commit:
    return inputs.Commit("f" * 40, (), "administrator", "seed", START - 90 * SECOND, {}, ("policies/initial.yaml",))


def _commit(plan: inputs.Plan) -> inputs.Commit:
    trailers = {"Plan": (plan.plan,), "Chart": (f"event-detector@0.1.0@{DIGEST}",), "Evidence": (SUMMARY_DIGEST,)}
    if plan.events:
        trailers |= {"Task": plan.tasks, "Event": plan.events, "Rule": ("lidar-proximity",), "Trace": plan.events}
    else:
        trailers |= {"Cause": ("initial",), "Trace": (plan.plan,)}
    paths = ("releases/vehicle-00/mqtt-bridge.yaml",)
    return inputs.Commit(plan.commit or "", ("f" * 40,), "manager", plan.subject, plan.merged or 0, trailers, paths)


def _counters(scenario: definition.Scenario, seconds: int) -> inputs.InputCounters:
    first = START // SECOND
    count = inputs.TopicCount(
        seconds * 100,
        0,
        {first + n: 100 for n in range(seconds)},
        {12: seconds * 99, 40: seconds},
        {first + n: (12, 40) for n in range(seconds)},
    )
    return inputs.InputCounters(1, {definition.pose_topic(agent): count for agent in scenario.vehicles})


def _seen(scenario: definition.Scenario, begin: int, end: int) -> Iterator[inputs.BrokerMessages]:
    for moment in range(begin, end, SECOND // 10):
        for agent in scenario.lidar_vehicles:
            yield inputs.BrokerMessages(moment, f"mqtt{definition.cloud_topic(agent)}", 1)
