"""Seals of recordings whose writers were killed, followed or taken away: nobody honest is accused, and what was changed
between a kill and the next start is named."""

from __future__ import annotations

import copy
import json
from typing import Any

import pytest

from robotkube.robots.recording.core.documents import AUDITS, INDEX, MANIFESTS, RECORDINGS, SAMPLES, SEGMENTS
from robotkube.robots.recording.core.manifests import Chain, is_final
from tests.stages.recording.processes import BEGIN, CLOUD, POSE, RECORDING, VOLUME, Place, killed_and_resumed

Snapshot = dict[str, dict[str, dict[str, Any]]]


def manifests(place: Place) -> list[dict[str, Any]]:
    """The manifests without their parts, in the order of their lives."""
    begun = [one for one in place.collection(MANIFESTS).values() if "number" not in one]
    return sorted(begun, key=lambda one: int(one["life"]))


def parts_of(place: Place, life: int) -> list[str]:
    """The names of the parts of a writer's manifest."""
    named = place.collection(MANIFESTS).items()
    return [name for name, one in named if "number" in one and one["life"] == life]


def killed() -> Place:
    """A writer that was killed after three parts, the database being there."""
    place = Place()
    place.offer(*place.process(), steps=35)
    return place


def resume(place: Place) -> None:
    process = place.process()
    place.offer(*process, steps=5)
    place.end(*process)


def ended_in_memory_only() -> Place:
    """As after `kubectl delete pod --force`: the writer ended and sealed on its volume, and what it had for the
    database went with it."""
    place = killed()
    recorder, journal = place.process()
    place.offer(recorder, journal, steps=12)
    journal.turn = lambda: None  # type: ignore[method-assign]
    place.offer(recorder, journal, steps=5)
    recorder.finish()
    return place


def test_a_seal_that_was_lost_with_its_process_accuses_nobody() -> None:
    place = ended_in_memory_only()
    resume(place)
    _, second, _ = manifests(place)
    assert second["statement"] is None
    table = place.verified()
    assert "noted on" not in table.refusal, "a seal that the database lacks contradicts nothing"
    assert table.refusal == f"{RECORDING}: {CLOUD}: 2 gaps; {POSE}: 2 gaps", "the kills, and nothing else"
    had = len(parts_of(place, second["life"]))
    assert f"writer {second['life']} sealed {had + 1} parts on {VOLUME}, of which the database had {had} when a" in (
        table.reservation
    )


def test_a_writer_that_outlives_the_start_of_the_next_one_is_believed_as_far_as_the_volume_knows_it() -> None:
    place = Place()
    first = place.process()
    place.offer(*first, steps=12)
    second = place.process()
    first_life = manifests(place)[0]["life"]
    while len(parts_of(place, first_life)) < 2:
        place.offer(*first, steps=1)
    first[1].turn()
    first[0].turn()
    place.offer(*second, steps=5)
    place.end(*second)
    named = f"the manifest of writer {first_life} is not the one behind which writer "
    assert named not in place.verified().refusal
    assert "in no manifest" not in place.verified().refusal
    place.volume.noted[RECORDING, str(first_life)].pop()
    assert named in place.verified().refusal


def test_a_seal_that_only_the_volume_has_counts() -> None:
    place = Place()
    process = place.process()
    place.offer(*process)
    place.end(*process)
    place.manifest.update(statement=None, signature=None)
    table = place.verified()
    assert (table.refusal, table.reservation) == ("", "")
    assert table.more[0].rows[0]["sealed"]
    last = max(parts_of(place, place.manifest["life"]))
    del place.collection(MANIFESTS)[last]
    assert f"sealed 4 parts on {VOLUME}, of which the database has 3" in place.verified().refusal


def test_what_nobody_counted_is_not_said_in_numbers() -> None:
    """RECEIVED 3045 beside STORED 3449."""
    place = killed_and_resumed()
    for row in place.verified().rows:
        assert row["stored"] == 35
        assert [row[name] for name in ("received", "early", "repeated", "dropped")] == [None] * 4
    place = killed()
    assert {row["received"] for row in place.verified().rows} == {None}, "its last audit is from before the last ones"


def changed_whole(place: Place) -> None:
    """What has the database's account writes a killed writer's documents anew, and its chain with them."""
    (manifest,) = manifests(place)
    for entry in place.collection(INDEX).values():
        entry["received"] += 12345
    for name in parts_of(place, manifest["life"]):
        del place.collection(MANIFESTS)[name]
    chain = Chain(RECORDING, manifest["life"], VOLUME, manifest["key"])
    for collection in (SAMPLES, INDEX, SEGMENTS, AUDITS):
        for document in place.collection(collection).values():
            if is_final(collection, document):
                chain.add(collection, document)
    part = chain.cut()
    place.collection(MANIFESTS)[part["_id"]] = part


def cut_short(place: Place) -> None:
    """The last parts of a killed writer, and the documents that they are of."""
    (manifest,) = manifests(place)
    for name in sorted(parts_of(place, manifest["life"]))[1:]:
        del place.collection(MANIFESTS)[name]
    for collection in (SAMPLES, INDEX):
        for name, one in list(place.collection(collection).items()):
            if int(one.get("stamp", one.get("second", 0) * 10**9)) >= BEGIN + 10**9:
                del place.collection(collection)[name]


def all_gone(place: Place) -> None:
    """Everything that the database has of the recording."""
    for collection in place.database.collections.values():
        collection.clear()


CHANGES = {
    changed_whole: "is not what the database has: another head behind part 1",
    cut_short: "is not what the database has: 3 parts that the database had, of which it has 1",
    all_gone: "has a note of writer {life}, of which the database has no manifest",
}


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_what_is_changed_between_a_kill_and_the_next_start_is_named(change: Any) -> None:
    place = killed()
    life = place.manifest["life"]
    change(place)
    resume(place)
    assert CHANGES[change].format(life=life) in place.verified().refusal
    place.volume.noted.pop((RECORDING, str(life)))  # the next writer has sealed what the volume had said
    refusal = place.verified().refusal
    assert f"the manifest of writer {life} is " in refusal
    assert "behind which writer" in refusal


def test_the_volume_has_the_head_behind_every_part_that_the_database_had() -> None:
    place = killed()
    life = place.manifest["life"]
    lines = [json.loads(line) for line in place.volume.noted[RECORDING, str(life)]]
    heads = {line["part"]: line["head"] for line in lines if "part" in line}
    parts = [place.collection(MANIFESTS)[name] for name in parts_of(place, life)]
    assert heads == {part["number"]: part["head"] for part in parts}
    place.database.away = True
    place.offer(*place.process(), steps=12)
    noted = [line for (_, other), lines in place.volume.noted.items() for line in lines if other != str(life)]
    assert not any("head" in line for line in noted), "what the database does not have yet is not noted as if it had"


def test_notes_that_cannot_be_read_stop_no_recorder(caplog: pytest.LogCaptureFixture) -> None:
    place = killed()
    place.volume.noted_of = lambda _: (_ for _ in ()).throw(OSError("bad"))  # type: ignore[method-assign]
    recorder, journal = place.process()
    place.offer(recorder, journal, steps=2)
    assert "notes on cloud-0/recordings are not compared: bad" in caplog.text
    place.volume.noted[RECORDING, "x"] = ["[]", '{"part": "a", "head": 3}', '{"statement": 7}', "no JSON"]
    place.volume.noted[RECORDING, "7"] = place.volume.noted[RECORDING, "x"]
    del place.volume.noted_of
    resume(place)
    assert place.verified().rows


def test_a_key_that_no_manifest_has_is_named() -> None:
    """The last writer is taken out of database and volume, and the recording's own document put back."""
    place = Place()
    process = place.process()
    place.offer(*process)
    place.end(*process)
    before: Snapshot = copy.deepcopy(place.database.collections)
    process = place.process()
    place.offer(*process, steps=10)
    place.end(*process)
    first, second = (manifest["key"] for manifest in manifests(place))
    assert place.verified((first, second)).refusal == ""
    place.database.collections = before
    place.volume.noted.clear()
    assert place.verified((first,)).refusal == ""
    assert place.verified((first, second)).refusal == (
        f"{RECORDING}: no manifest has the key {second[:16]}... that --key gives: the manifest of its writer was taken "
        "away, or the key is of another recording"
    )


def test_a_key_of_a_writer_of_which_nothing_came_to_the_database_is_no_problem() -> None:
    place = Place()
    key = "5" * 112
    place.volume.note(RECORDING, str(BEGIN), [json.dumps({"key": key})])
    process = place.process()
    place.offer(*process)
    place.end(*process)
    assert place.verified((place.manifest["key"], key)).refusal == ""
    place.volume.note(RECORDING, str(BEGIN), [json.dumps({"statement": json.dumps({"parts": 2, "head": "ab"})})])
    table = place.verified()
    assert table.refusal == ""
    assert f"writer {BEGIN} sealed 2 parts on {VOLUME}, of which the database had 0 when a later" in table.reservation


def test_the_last_writer_is_the_one_that_nobody_went_on_behind_whatever_the_clock_said() -> None:
    place = Place()
    process = place.process()
    place.offer(*process)
    place.end(*process)
    place.clock_ahead_ns -= 10**11
    resume(place)
    table = place.verified()
    assert (table.refusal, table.reservation) == ("", "")
    place.collection(RECORDINGS)[RECORDING]["ended"] += 1
    assert "what the recording's own document says is not what was sealed" in place.verified().refusal


def test_a_recording_that_another_task_began_is_refused_in_words() -> None:
    place = Place()
    resume(place)
    place.task = "cloud-0/atk-same"
    before: Snapshot = copy.deepcopy(place.database.collections)
    recorder, journal = place.process()
    recorder.start()
    recorder.stop(5.0)
    journal.turn()
    assert recorder.failed == (
        "recording task-1: task t began it, and this recorder's task is cloud-0/atk-same; name the reaction's "
        "`recording` after namespace and task, as {{ task.namespace }}.{{ task.name }}"
    )
    assert place.database.collections == before, "nothing of it is changed"
