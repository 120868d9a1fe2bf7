"""Runs are broken in what they leave behind, never in the report, and every expectation is seen to fail."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from scenarios import definition
from scenarios.runner.reporting import page, report, timeline

SECOND = 1_000_000_000
CLOUD = "/vehicles/vehicle_00/lidar_center/pointcloud"
POSE = "/vehicles/vehicle_01/pose"
KEYS = [
    "scenario",
    "provider",
    "nodes",
    "parameters",
    "rates_measured",
    "age_seconds",
    "latency_seconds",
    "latency_quantiles",
    "recorded",
    "cpu_core_seconds",
    "set_up_seconds",
    "audit",
    "evidence",
    "warnings",
    "expectations",
    "passed",
]


def test_a_healthy_run_passes_with_every_key_of_the_report(run: Any) -> None:
    done = run.judge()
    assert done.passed, run.failed()
    document = json.loads(json.dumps(done.document))
    assert set(KEYS) <= set(document)
    assert set(document["parameters"]) >= {
        "vehicles",
        "lidar_vehicles",
        "pose_hz",
        "point_cloud_hz",
        "start_distance_m",
    }
    assert document["rates_measured"] == {"pose_hz_min": 100.0, "point_cloud_hz_min": 10.0}
    assert document["age_seconds"] == {"pose_p50": 0.013, "pose_p99": 0.013}
    assert document["latency_seconds"] == {
        "detection": 0.042,
        "task_to_merged": 0.958,
        "merged_to_synced": 3.0,
        "event_to_first_point_cloud_stored": pytest.approx(4.1, abs=0.1),
        "stop_to_removed": 4.988,
    }
    assert document["latency_quantiles"]["stop_to_removed"] == {"p50": 4.988, "p95": 4.988, "n": 2}
    assert document["recorded"]["lost"] == document["recorded"]["duplicates"] == 0
    assert document["recorded"]["window_seconds"] == pytest.approx(37, abs=0.5)
    assert document["recorded"]["poses"] == pytest.approx(2 * 10 * 37, abs=15)
    assert len(document["audit"]) == 5
    assert document["audit"][1]["task"] == "cloud-0/task-0"
    assert [(row["chart"], row["found"]) for row in document["evidence"]] == [("event-detector", True)]
    assert document["warnings"] == []


def test_a_policy_that_asks_for_no_evidence_is_a_warning_and_no_pass(run: Any) -> None:
    first, *others = run.known.commits
    bare = [replace(commit, trailers={**commit.trailers, "Evidence": ("none",)}) for commit in others]
    run.change(commits=(first, *bare), released=tuple(replace(one, evidence="none") for one in run.known.released))
    document = run.judge().document
    assert document["warnings"][0].startswith("the release policy is `assurance: none`")
    assert run.failed() == {"releases_had_evidence"}


def test_the_parts_of_the_first_cloud_s_way_add_up(run: Any) -> None:
    document = run.judge().document
    whole = document["latency_seconds"]["event_to_first_point_cloud_stored"]
    assert sum(document["latency_breakdown_seconds"][0].values()) == pytest.approx(whole)


Break = Callable[[Any], None]


def cut_a_cloud_from_a_segment(run: Any) -> None:
    entry = run.index[40]
    path = run.claim / entry["segment"]
    path.write_bytes(path.read_bytes()[: entry_offset(run, entry)])


def entry_offset(run: Any, entry: dict[str, Any]) -> int:
    """The offset of the message's bytes in the segment."""
    data = (run.claim / entry["segment"]).read_bytes()
    seconds, nanoseconds = divmod(entry["stamp"], SECOND)
    needle = b"\x00\x01\x00\x00" + seconds.to_bytes(4, "little") + nanoseconds.to_bytes(4, "little")
    return data.index(needle)


def lose_a_whole_volume(run: Any) -> None:
    for entry in run.index:
        entry["volume"] = "cloud-1/recordings"


def remove_an_index_entry(run: Any) -> None:
    del run.index[40]


def store_a_pose_twice(run: Any) -> None:
    run.samples.append(next(bucket for bucket in run.samples if bucket["topic"] == POSE))


def change_a_byte_of_a_pose(run: Any) -> None:
    bucket = next(bucket for bucket in run.samples if bucket["topic"] == POSE)
    sample = bucket["samples"][0]
    bucket["samples"] = [sample | {"data": sample["data"][:-1] + bytes([sample["data"][-1] ^ 1])}]


def change_a_byte_of_a_cloud(run: Any) -> None:
    path = run.claim / run.index[40]["segment"]
    place = entry_offset(run, run.index[40]) + 20
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)


def record_a_pose_no_player_sent(run: Any) -> None:
    for lines in run.ledgers.values():
        stamps = {line.get("stamp") for line in lines}
        assert run.known.started + 1 not in stamps
    bucket = next(bucket for bucket in run.samples if bucket["topic"] == POSE)
    sample = bucket["samples"][0] | {"stamp": run.known.started + 1}
    run.samples.append(bucket | {"samples": [sample]})


def drop_a_pose_from_the_database(run: Any) -> None:
    buckets = [bucket for bucket in run.samples if bucket["topic"] == POSE]
    run.samples.remove(buckets[100])


def drop_many_poses(run: Any) -> None:
    buckets = [bucket for bucket in run.samples if bucket["topic"].endswith("pose")]
    for bucket in buckets[100:300]:
        run.samples.remove(bucket)


def drop_many_clouds(run: Any) -> None:
    del run.index[20:80]


def forget_the_transforms(run: Any) -> None:
    run.samples = [bucket for bucket in run.samples if not bucket["topic"].endswith("transform")]


def edit_ledgers_away(run: Any) -> None:
    run.ledgers = {topic: lines for topic, lines in run.ledgers.items() if topic != CLOUD}


def remove_a_merged_pull_request(run: Any) -> None:
    run.change(pull_requests=run.known.pull_requests[:-1])


def leave_a_pull_request_open(run: Any) -> None:
    *others, last = run.known.pull_requests
    run.change(pull_requests=(*others, replace(last, merged=False)))


def merge_another_commit(run: Any) -> None:
    *others, last = run.known.pull_requests
    run.change(pull_requests=(*others, replace(last, commit="e" * 40)))


def drop_a_trailer(name: str) -> Break:
    def broken(run: Any) -> None:
        *others, last = run.known.commits
        run.change(commits=(*others, replace(last, trailers={k: v for k, v in last.trailers.items() if k != name})))

    broken.__name__ = f"drop_the_trailer_{name}"
    return broken


def push_past_the_gate(run: Any) -> None:
    commit = replace(run.known.commits[-1], sha="d" * 40, trailers={})
    run.change(commits=(*run.known.commits, commit))


def send_a_cloud_early(run: Any) -> None:
    log = run.known.broker
    early = replace(log.messages[0], time=run.known.edges[0].time - SECOND)
    run.change(broker=replace(log, messages=(early, *log.messages)))


def send_a_cloud_late(run: Any) -> None:
    log = run.known.broker
    late = replace(log.messages[0], time=run.known.ended - SECOND)
    run.change(broker=replace(log, messages=(*log.messages, late)))


def send_a_cloud_between_the_encounters(run: Any) -> None:
    log = run.known.broker
    late = replace(log.messages[0], time=run.known.edges[2].time - SECOND)
    run.change(broker=replace(log, messages=(*log.messages, late)))


def deafen_the_observer(run: Any) -> None:
    run.change(broker=replace(run.known.broker, messages=()))


def interrupt_the_observer(run: Any) -> None:
    run.change(broker=replace(run.known.broker, gaps=1))


def subscribe_too_late(run: Any) -> None:
    run.change(broker=replace(run.known.broker, since=run.known.started + 1))


def remove_late(run: Any) -> None:
    first, second = run.known.pods
    run.change(pods=(first, replace(second, deleted=second.deleted + 8 * SECOND)))


def never_remove(run: Any) -> None:
    first, second = run.known.pods
    run.change(pods=(first, replace(second, deleted=None)))


def store_late(run: Any) -> None:
    for entry in run.index:
        entry["stored"] += 5 * SECOND


def never_acknowledge(run: Any) -> None:
    for entry in run.index:
        entry["stored"] = None


def change_a_counter(**changes: Any) -> Break:
    def broken(run: Any) -> None:
        counters = run.known.input_after
        topic = "/vehicles/vehicle_02/pose"
        run.change(
            input_after=replace(counters, topics=counters.topics | {topic: replace(counters.topics[topic], **changes)})
        )

    broken.__name__ = f"change_{'_and_'.join(changes)}"
    return broken


def slow_down_one_vehicle_for_a_window(run: Any) -> None:
    seconds = dict(run.known.input_after.topics[POSE].seconds)
    for second in range(10, 15):
        seconds[run.known.started // SECOND + second] = 9
    change_a_counter(seconds=seconds)(run)


def restart_the_detector(run: Any) -> None:
    run.change(input_after=replace(run.known.input_after, started=2))


def silence_a_vehicle(run: Any) -> None:
    counters = run.known.input_after
    run.change(input_after=replace(counters, topics={k: v for k, v in counters.topics.items() if "_02" not in k}))


def leave_a_release_behind(run: Any) -> None:
    run.change(releases_after={**run.known.releases_after, "cloud-0/recorder": "1"})


def change_a_release_for_good(run: Any) -> None:
    run.change(releases_after={"vehicle-00/mqtt-bridge": "2"})


def name_no_evidence(run: Any) -> None:
    [one] = run.known.released
    run.change(released=(one, replace(one, release="cloud-0/other", evidence="none")))


def name_evidence_of_another_digest(run: Any) -> None:
    run.change(summaries=dict.fromkeys(run.known.summaries, "sha256:" + "c" * 64))


def lose_the_summary(run: Any) -> None:
    run.change(summaries={})


def see_no_release(run: Any) -> None:
    run.change(released=())


def miss_an_encounter(run: Any) -> None:
    run.change(edges=run.known.edges[:2])


def never_stop(run: Any) -> None:
    run.change(edges=run.known.edges[:3])


RECORDED = {"poses_recorded_share", "point_clouds_recorded_share"}


@pytest.mark.parametrize(
    ("broken", "expected"),
    [
        (cut_a_cloud_from_a_segment, {"lost", "point_clouds_recorded_share"}),
        (lose_a_whole_volume, {"lost", "event_to_first_point_cloud_seconds", *RECORDED}),
        (remove_an_index_entry, {"lost"}),
        (store_a_pose_twice, {"duplicates"}),
        (change_a_byte_of_a_pose, {"payloads_equal"}),
        (change_a_byte_of_a_cloud, {"payloads_equal"}),
        (record_a_pose_no_player_sent, {"payloads_equal"}),
        (drop_a_pose_from_the_database, {"lost"}),
        (drop_many_poses, {"lost", "poses_recorded_share"}),
        (drop_many_clouds, {"lost", "point_clouds_recorded_share"}),
        (forget_the_transforms, {"transforms_in_every_recording"}),
        (edit_ledgers_away, {"lost", "payloads_equal"}),
        (remove_a_merged_pull_request, {"audit_complete"}),
        (leave_a_pull_request_open, {"audit_complete"}),
        (merge_another_commit, {"audit_complete"}),
        *(
            (drop_a_trailer(n), {"audit_complete"})
            for n in ("Task", "Event", "Rule", "Plan", "Trace", "Chart", "Evidence")
        ),
        (push_past_the_gate, {"audit_complete"}),
        (send_a_cloud_early, {"point_clouds_at_broker_before_event"}),
        (send_a_cloud_late, {"point_clouds_at_broker_after_removal"}),
        (send_a_cloud_between_the_encounters, {"point_clouds_at_broker_after_removal"}),
        *(
            (broken, {"point_clouds_at_broker_before_event", "point_clouds_at_broker_after_removal"})
            for broken in (deafen_the_observer, interrupt_the_observer, subscribe_too_late)
        ),
        (remove_late, {"stop_to_removed_seconds"}),
        (never_remove, {"stop_to_removed_seconds", "point_clouds_at_broker_after_removal"}),
        (store_late, {"event_to_first_point_cloud_seconds"}),
        (never_acknowledge, {"event_to_first_point_cloud_seconds"}),
        (slow_down_one_vehicle_for_a_window, {"pose_hz_min"}),
        (change_a_counter(ages_ms={12: 1000, 300: 1000}), {"pose_age_p99_seconds"}),
        (restart_the_detector, {"pose_hz_min", "pose_age_p99_seconds"}),
        (silence_a_vehicle, {"pose_hz_min", "pose_age_p99_seconds"}),
        (leave_a_release_behind, {"releases_after_equal_before"}),
        (change_a_release_for_good, {"releases_after_equal_before"}),
        *(
            (broken, {"releases_had_evidence"})
            for broken in (name_no_evidence, name_evidence_of_another_digest, lose_the_summary, see_no_release)
        ),
        (miss_an_encounter, {"encounters", "stop_to_removed_seconds"}),
        (never_stop, {"lost", "stop_to_removed_seconds", *RECORDED}),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_broken_run_fails_what_it_breaks(run: Any, broken: Break, expected: set[str]) -> None:
    broken(run)
    report = run.judge()
    failed = {row.name for row in report.table if not row.passed}
    assert expected <= failed
    assert failed - expected <= {"point_clouds_at_broker_after_removal", *(RECORDED if "lost" in expected else ())}
    assert not report.passed


def test_every_expectation_of_the_scenario_is_seen_to_fail(run: Any) -> None:
    marks = next(mark for mark in test_a_broken_run_fails_what_it_breaks.pytestmark if mark.name == "parametrize")
    seen = set().union(*(expected for _, expected in marks.args[1]))
    assert seen == {"encounters", *run.scenario.expectations}


def test_the_window_begins_with_the_later_first_cloud(run: Any) -> None:
    """The first second of one vehicle's clouds is missing: not lost, since the window begins behind it."""
    stamps = sorted(
        entry["stamp"] for entry in run.index if entry["topic"] == CLOUD and entry["recording"] == "recording-0"
    )
    run.index = [e for e in run.index if not (e["topic"] == CLOUD and e["stamp"] in stamps[:10])]
    document = run.judge().document
    assert document["recorded"]["lost"] == 0
    assert document["recorded"]["window_seconds"] == pytest.approx(36, abs=0.6)


def test_a_person_s_change_of_the_policies_needs_a_pull_request_but_no_plan(run: Any) -> None:
    mine = replace(
        run.known.commits[1], sha="c" * 40, author="operator-team", trailers={}, paths=("policies/initial.yaml",)
    )
    run.change(commits=(*run.known.commits, mine))
    assert run.failed() == {"audit_complete"}
    merged = replace(run.known.pull_requests[0], number=99, commit="c" * 40)
    run.change(pull_requests=(*run.known.pull_requests, merged))
    assert not run.failed()


@pytest.mark.parametrize("tail", [[], [{"end": True, "count": 3}]])
def test_a_ledger_without_a_true_end_is_refused(run: Any, tail: list[dict[str, Any]]) -> None:
    run.ledgers[CLOUD][-1:] = tail
    with pytest.raises(ValueError, match=r"has no end|states 3 messages and holds"):
        run.judge()


def test_warnings_name_what_went_wrong_on_the_way(run: Any) -> None:
    restart_the_detector(run)
    interrupt_the_observer(run)
    run.change(plans=(*run.known.plans[:-1], replace(run.known.plans[-1], error="refused once")))
    warnings = run.judge().document["warnings"]
    assert [w.split()[1] for w in warnings] == ["event", "observer", run.known.plans[-1].plan + ":"]


def test_the_timeline_names_every_step_with_pull_request_and_commit(run: Any) -> None:
    done = run.judge()
    text = list(timeline.lines(done.inputs, done.moments))
    words = [
        "players start",
        "event 1:",
        "task cloud-0/task-0 created",
        "proposed",
        "merged",
        "x created",
        "running",
        "stored",
    ]
    places = [next(i for i, line in enumerate(text) if word in line) for word in words]
    assert places == sorted(places)
    assert any("#2  0000000000" in line for line in text)


def test_the_page_is_one_sound_file_without_anything_to_load(run: Any, tmp_path: Path) -> None:
    send_a_cloud_early(run)
    done = run.judge()
    files = report.write(done, tmp_path / "out", page.page(done))
    assert json.loads(files[0].read_text())["passed"] is False
    html = files[1].read_text()
    checker = Balanced()
    checker.feed(html)
    assert not checker.open
    assert "http" not in html
    assert "<script" not in html
    assert all(row.name.replace("_", " ") in html for row in done.table)


class Balanced(HTMLParser):
    """Keeps the tags that are open; a tag closed out of order is an error."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_a_run_that_measured_nothing_fails_everything(run: Any) -> None:
    empty = replace(
        run.known,
        edges=(),
        plans=(),
        pull_requests=(),
        commits=(),
        input_before=None,
        input_after=None,
        broker=None,
        pods=(),
        released=(),
        releases_before={},
        releases_after={},
    )
    done = report.report(definition.load(run.scenario.folder), empty)
    assert not any(row.passed for row in done.table)
    assert page.page(done)
