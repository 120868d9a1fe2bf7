"""The event detector: what receiving, detecting, storing, carrying and testing cost, each beside a baseline of the same
run. To build/bench/event-detector.json; what the keys mean: docs/reference/testing.md.

A goal that is no ratio to a baseline stands as the baseline itself (`the goal`), with a ratio of at most 1.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict

from benchmarks.bridges import throughput
from benchmarks.detector import activating, detecting, proximity, recording, rule_testing, whole_path
from benchmarks.detector.detecting import AGENTS, DEMO_RATE
from benchmarks.measuring import pods
from benchmarks.measuring.comparisons import Comparison, record
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.machine import preparing

RECORD = PROJECT / "build" / "bench" / "event-detector.json"
RECEIVE_US_MAX, SUSTAINED_MIN, LATENCY_P99_MS_MAX, EVENTS = 40.0, 15_000.0, 20.0, 1000
ACTIVATION_MS_MAX = 100.0
BRIDGE_MIN, REALTIME_MIN, PATH_RATIO_MAX = 10_000.0, 20.0, 0.6
ROSBAGS_RATIO_MAX = 2.0  # ours reads whatever rule and any bag, and gives events with their causes
NAIVE_SECONDS = 20.0


def receiving() -> list[Comparison]:
    """Poses into the buffer and through the rule, beside taking them and nothing else, and beside an executor."""
    received = detecting.receive()
    naive = naive_receive()
    record(
        RECORD,
        {
            "receive_us_per_message": received.us_per_message,
            "receive_baseline_us_per_message": received.baseline_us_per_message,
            "receive_executor_us_per_message": naive,
        },
    )
    return [
        Comparison("receive, CPU per pose", "us", received.us_per_message, RECEIVE_US_MAX, 1.0, "the goal"),
        Comparison("receive, CPU per pose", "us", received.us_per_message, naive, 1.0, "SingleThreadedExecutor"),
    ]


def naive_receive() -> float:
    """CPU per pose of the naive detector at the demo's rate, in us; the start of its process is left out."""
    with detecting.testbed() as here:
        path = here.folder / "config.yaml"
        path.write_text(json.dumps(detecting.settings(AGENTS)), encoding="utf-8")
        environment = {"ROBOTKUBE_CONFIG": str(path), "ROBOTKUBE_RESULT": str(here.result_path("naive"))}
        here.namespaces.append(here.nodes.pod(here.node))
        command = pods.python("benchmarks.detector.naive_detector")
        naive = pods.start("naive", command, environment, here.folder / "naive.log", here.namespaces[-1])
        here.started.append(naive)
        detecting.play(here, NAIVE_SECONDS, DEMO_RATE)
        naive.stop()
        result = here.wait("naive", detecting.END_SECONDS_MAX)
    return round(1e6 * float(result["cpu_seconds"]) / int(result["messages"]), 2)


def noticing() -> list[Comparison]:
    """Messages a second that one core takes without loss, and the time from a message to its event."""
    throughput = detecting.sustained()
    delay = detecting.latency(EVENTS)
    values = {
        "sustained_messages_per_second_one_core": throughput.messages_per_second_one_core,
        "sustained_lost": throughput.lost,
        "sustained_core_fraction": throughput.core_fraction,
        "event_latency_p99_ms": delay.p99_ms,
        "event_latency_p50_ms": delay.p50_ms,
        "event_latency_n": delay.n,
    }
    record(RECORD, values)
    if throughput.lost:
        raise SetUpError(f"{throughput.lost} messages were lost at {throughput.messages_per_second_one_core:.0f}/s")
    needed = 1e6 / throughput.messages_per_second_one_core
    return [
        Comparison("sustained on one core, time per message", "us", needed, 1e6 / SUSTAINED_MIN, 1.0, "the goal"),
        Comparison(f"message to event, p99 of {delay.n}", "ms", delay.p99_ms, LATENCY_P99_MS_MAX, 1.0, "the goal"),
    ]


def going() -> list[Comparison]:
    """From rest to active, by command and by configuration."""
    activation = activating.activate()
    values = {
        "activation_ms": asdict(activation.active_ms),
        "activation_first_message_ms": asdict(activation.first_message_ms),
    }
    record(RECORD, values)
    name = f"from rest to active, p99 of {activation.active_ms.n}"
    return [Comparison(name, "ms", activation.active_ms.p99, ACTIVATION_MS_MAX, 1.0, "the goal")]


def nearness() -> list[Comparison]:
    """1,000 agents at 10 Hz."""
    measured = proximity.measure()
    values = {
        "proximity_1000_agents_core_fraction": measured.core_fraction,
        "proximity_plain": measured.plain_core_fraction,
    }
    record(RECORD, values)
    name = f"proximity, {proximity.AGENTS} agents at {proximity.HERTZ} Hz"
    return [
        Comparison(name, "cores", measured.core_fraction, 1.0, 1.0, "the goal"),
        Comparison(name, "cores", measured.core_fraction, measured.plain_core_fraction, 1.0, "each with all others"),
    ]


def storing() -> list[Comparison]:
    """Ten seconds of two vehicles until everything is acknowledged."""
    stored = recording.store_ten_seconds()
    values = {
        "store_ten_seconds_s": round(stored.seconds, 3),
        "store_baseline_s": round(stored.baseline_seconds, 3),
        "store_messages_lost": stored.lost,
    }
    record(RECORD, values)
    if stored.lost:
        raise SetUpError(f"{stored.lost} messages were offered and are not found")
    allowed = stored.seconds_max / stored.baseline_seconds
    return [Comparison("store 10 s", "s", stored.seconds, stored.baseline_seconds, allowed, "a file, fsync")]


def carrying() -> list[Comparison]:
    """Poses through one bridge, each direction alone."""
    directions = {direction: throughput.carry(direction) for direction in (throughput.OUT, throughput.IN)}
    worst = min(directions.values(), key=lambda carried: carried.messages_per_second)
    lost = sum(carried.sent - carried.received for carried in directions.values())
    values = {
        "bridge_messages_per_second": worst.messages_per_second,
        "bridge_core_us_per_message": max(carried.core_us_per_message for carried in directions.values()),
        "bridge_lost": lost,
        "bridge": {direction: asdict(carried) for direction, carried in directions.items()},
    }
    record(RECORD, values)
    if lost:
        raise SetUpError(f"the bridge lost {lost} messages")
    goal = 1e6 / BRIDGE_MIN
    return [Comparison("bridge, time per message", "us", 1e6 / worst.messages_per_second, goal, 1.0, "the goal")]


def trying() -> list[Comparison]:
    """`robotkube rule test` on the paper's bags."""
    tried = rule_testing.rule_test()
    values = {
        "rule_test_realtime_factor": round(tried.realtime_factor, 1),
        "rule_test_baseline_realtime_factor": round(tried.baseline_realtime_factor, 1),
    }
    record(RECORD, values)
    ours = tried.seconds / tried.realtime_factor
    name = f"rule test, bags of {tried.seconds:.0f} s"
    return [
        Comparison(name, "s", ours, tried.seconds / REALTIME_MIN, 1.0, "the goal"),
        Comparison(
            name, "s", ours, tried.seconds / tried.baseline_realtime_factor, ROSBAGS_RATIO_MAX, "rosbags and a loop"
        ),
    ]


def whole() -> list[Comparison]:
    """Bridges, broker and detector per pose."""
    naive, ours = whole_path.cost(whole_path.NaiveDataPath), whole_path.cost(whole_path.WholeDataPath)
    values = {
        "data_path_us_per_message": ours.us_per_message,
        "data_path_baseline_us_per_message": naive.us_per_message,
        "data_path": {"ours": ours.components, "baseline": naive.components},
    }
    record(RECORD, values)
    name = f"data path, CPU per pose, {whole_path.VEHICLES} x {whole_path.HERTZ} Hz"
    return [Comparison(name, "us", ours.us_per_message, naive.us_per_message, PATH_RATIO_MAX, "the naive path")]


PARTS: tuple[Callable[[], list[Comparison]], ...] = (
    receiving,
    noticing,
    going,
    nearness,
    storing,
    carrying,
    trying,
    whole,
)


def compare() -> list[Comparison]:
    """All parts, one after the other."""
    preparing.for_tests()
    return [comparison for part in PARTS for comparison in part()]
