"""Metrics of a run, computed from its inputs: rates and ages at the detector's input, latencies, recorded messages.

Every function returns None for what cannot be known from the inputs; nothing is guessed.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from scenarios.definition import Scenario, pose_topic
from scenarios.generator import routes
from scenarios.runner.inputs import NANOSECONDS, InputCounters, RunInputs
from scenarios.runner.judging.encounters import Encounter

WINDOW_SECONDS = 5
AFTER_REMOVAL_SECONDS = 2
LATENCIES = ("detection", "task_to_merged", "merged_to_synced", "event_to_first_point_cloud_stored", "stop_to_removed")
BREAKDOWN = ("detection", "forge", "argo_cd", "pod_start", "subscription", "storing")


def pose_hz_min(scenario: Scenario, inputs: RunInputs) -> float | None:
    """The least rate in Hz over all vehicles and all whole 5 s windows from the common start to the end of the
    routes."""
    after = same_process(inputs)
    if after is None or inputs.started % NANOSECONDS:
        return None
    first = inputs.started // NANOSECONDS
    windows = routes.duration_seconds(scenario.parameters) // WINDOW_SECONDS
    rates = []
    for agent in scenario.vehicles:
        counted = after.topics.get(pose_topic(agent))
        if counted is None:
            return None
        for window in range(windows):
            begin = first + window * WINDOW_SECONDS
            rates.append(
                sum(counted.seconds.get(begin + second, 0) for second in range(WINDOW_SECONDS)) / WINDOW_SECONDS
            )
    return min(rates, default=None)


def point_cloud_hz_min(encounters: Sequence[Encounter]) -> float | None:
    """The least rate in Hz of stored clouds over vehicles and whole 5 s windows of all recordings, by time of arrival.

    A window is one inside the recording's window; a recording shorter than one counts as a whole.
    """
    rates = []
    for encounter in encounters:
        if encounter.window is None or encounter.window_seconds is None:
            return None
        begin, end = encounter.window
        for topic in encounter.cloud_topics:
            arrivals = [message.received for message in encounter.readable if message.topic == topic]
            rates += _window_rates(arrivals, begin, end)
    return min(rates, default=None)


def _window_rates(arrivals: Sequence[int], begin: int, end: int) -> list[float]:
    width = min(WINDOW_SECONDS * NANOSECONDS, end - begin)
    windows = range((end - begin) // width)
    return [
        sum(begin + n * width <= moment < begin + (n + 1) * width for moment in arrivals) * NANOSECONDS / width
        for n in windows
    ]


def pose_age_seconds(scenario: Scenario, inputs: RunInputs, share: float) -> float | None:
    """The age in s that `share` of all poses at the detector's input did not exceed (upper edge of a bucket of 1
    ms)."""
    ages = pose_ages(scenario, inputs)
    if ages is None:
        return None
    needed = math.ceil(share * ages.total())
    reached = 0
    for bucket in sorted(ages):
        reached += ages[bucket]
        if reached >= needed > 0:
            return (bucket + 1) / 1000
    return None


def pose_ages(scenario: Scenario, inputs: RunInputs) -> Counter[int] | None:
    """Poses of all vehicles at the detector's input by age in whole ms; None when the counters do not cover the run."""
    after = same_process(inputs)
    if after is None or inputs.input_before is None:
        return None
    ages: Counter[int] = Counter()
    for agent in scenario.vehicles:
        topic = pose_topic(agent)
        if topic not in after.topics:
            return None
        ages.update(after.topics[topic].ages_ms)
        if topic in inputs.input_before.topics:
            ages.subtract(inputs.input_before.topics[topic].ages_ms)
    return ages


def same_process(inputs: RunInputs) -> InputCounters | None:
    """The later reading, unless the detector was restarted between the two."""
    before, after = inputs.input_before, inputs.input_after
    return after if before and after and before.started == after.started else None


def latencies(encounter: Encounter) -> dict[str, float | None]:
    """The five latencies of one encounter in s, by the names of the report."""
    start, stop, plan, first = encounter.start, encounter.stop, encounter.plan, encounter.first_cloud
    return {
        "detection": seconds(start.stamp, start.done),
        "task_to_merged": seconds(start.done, plan.merged if plan else None),
        "merged_to_synced": seconds(plan.merged if plan else None, plan.observed if plan else None),
        "event_to_first_point_cloud_stored": seconds(start.time, first.stored if first else None),
        "stop_to_removed": seconds(stop.time if stop else None, encounter.removed),
    }


def breakdown(encounter: Encounter) -> dict[str, float | None]:
    """The parts of the time from the event to the first stored cloud, in s; the parts add up to it.

    The pods meant are those of the releases that the plan created (the recorder).
    """
    plan, first = encounter.plan, encounter.first_cloud
    merged = plan.merged if plan else None
    created = min((pod.created for pod in encounter.pods), default=None)
    running = min((pod.running for pod in encounter.pods if pod.running), default=None)
    received = first.received if first else None
    moments = (
        encounter.start.time,
        encounter.start.done,
        merged,
        created,
        running,
        received,
        first.stored if first else None,
    )
    return {name: seconds(*moments[number : number + 2]) for number, name in enumerate(BREAKDOWN)}


def seconds(begin: int | None, end: int | None) -> float | None:
    """Time between two moments in s, None when one is not known."""
    return None if begin is None or end is None else (end - begin) / NANOSECONDS


def quantiles(values: Iterable[float | None]) -> dict[str, float | int | None]:
    """Median, 95 % quantile (interpolated) and number of the known values."""
    known = sorted(value for value in values if value is not None)
    return {"p50": _quantile(known, 0.5), "p95": _quantile(known, 0.95), "n": len(known)}


def _quantile(ordered: Sequence[float], share: float) -> float | None:
    if not ordered:
        return None
    place = share * (len(ordered) - 1)
    low = math.floor(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (place - low)


def total(values: Iterable[float | int | None]) -> float | int | None:
    """Sum, or None when one of the values is not known or there are none."""
    known = list(values)
    return None if not known or None in known else sum(value for value in known if value is not None)


def worst(values: Iterable[float | None]) -> float | None:
    """The greatest, or None when one of the values is not known or there are none."""
    known = list(values)
    return None if not known or None in known else max(value for value in known if value is not None)


def recorded_share(scenario: Scenario, encounters: Sequence[Encounter], clouds: bool) -> float | None:
    """Recorded messages over lidar vehicles x rate x window, the least of all encounters."""
    hertz = scenario.parameters.point_cloud_hz if clouds else scenario.parameters.pose_hz
    shares = []
    for encounter in encounters:
        if encounter.window_seconds is None:
            return None
        topics = [topic for topic in encounter.topics if (topic in encounter.cloud_topics) == clouds]
        shares.append(encounter.count(topics) / (len(topics) * hertz * encounter.window_seconds))
    return min(shares, default=None)


def clouds_before_event(inputs: RunInputs, encounters: Sequence[Encounter]) -> int | None:
    """Clouds at the broker before their vehicle's first event; None when the observer was not subscribed all the time,
    or is deaf."""
    if not encounters or not _listened(inputs):
        return None
    firsts: dict[str, int] = {}
    for encounter in encounters:
        for topic in encounter.cloud_topics:
            firsts.setdefault(f"mqtt{topic}", encounter.start.time)
    messages = inputs.broker.messages if inputs.broker else ()
    return sum(message.count for message in messages if message.time < firsts.get(message.topic, inputs.ended))


def clouds_after_removal(inputs: RunInputs, encounters: Sequence[Encounter]) -> int | None:
    """Clouds at the broker from 2 s after each removal to their vehicle's next event or the end; None when no time is
    left. While demands on a vehicle's clouds overlap, the last removal counts."""
    if not encounters or not _listened(inputs):
        return None
    clouds = 0
    for topic in sorted({topic for encounter in encounters for topic in encounter.cloud_topics}):
        counted = _after_removal(inputs, topic, [one for one in encounters if topic in one.cloud_topics])
        if counted is None:
            return None
        clouds += counted
    return clouds


def _after_removal(inputs: RunInputs, topic: str, mine: Sequence[Encounter]) -> int | None:
    clouds, removed, stopped = 0, 0, 0
    for number, encounter in enumerate(mine, 1):
        following = mine[number].start.time if number < len(mine) else None
        if encounter.removed is None or encounter.stop is None:
            return None
        removed, stopped = max(removed, encounter.removed), max(stopped, encounter.stop.time)
        if following is not None and following < stopped:
            continue
        begin = removed + AFTER_REMOVAL_SECONDS * NANOSECONDS
        end = following or inputs.ended
        if begin >= end:
            return None
        clouds += _clouds_between(inputs, f"mqtt{topic}", begin, end)
    return clouds


def _listened(inputs: RunInputs) -> bool:
    """Return whether the observer was subscribed from before the start to the end and has seen clouds at all."""
    log = inputs.broker
    return bool(log and not log.gaps and log.since <= inputs.started and log.until >= inputs.ended and log.messages)


def _clouds_between(inputs: RunInputs, topic: str, begin: int, end: int) -> int:
    messages = inputs.broker.messages if inputs.broker else ()
    return sum(message.count for message in messages if message.topic == topic and begin <= message.time < end)


def recorded(encounters: Sequence[Encounter]) -> Mapping[str, float | int | None]:
    """Sums over all encounters, counted inside their windows, by the names of the report."""
    return {
        "poses": sum(
            encounter.count([t for t in encounter.topics if t not in encounter.cloud_topics])
            for encounter in encounters
        ),
        "point_clouds": sum(encounter.count(encounter.cloud_topics) for encounter in encounters),
        "lost": total(encounter.lost for encounter in encounters),
        "duplicates": total(encounter.duplicates for encounter in encounters),
        "window_seconds": total(encounter.window_seconds for encounter in encounters),
    }
