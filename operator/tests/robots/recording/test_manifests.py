"""What a recorder sealed against what the database has: `recording verify` names coherent changes of every kind."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable

import pytest

from robotkube.robots.recording.core.documents import AUDITS, INDEX, MANIFESTS, RECORDINGS, SAMPLES, SEGMENTS
from robotkube.robots.recording.core.manifests import Chain, next_head
from robotkube.robots.recording.core.one_time_signatures import OneTimeKey, holds
from tests.stages.recording.processes import BEGIN, POSE, RECORDING, TOPICS, VOLUME, Place, killed_and_resumed


@pytest.fixture
def place() -> Place:
    """A recording of 30 poses and 30 clouds, as it ended."""
    place = Place()
    process = place.process()
    place.offer(*process)
    place.end(*process)
    return place


def test_a_recording_that_nobody_touched_is_sealed(place: Place) -> None:
    table = place.verified()
    assert (table.refusal, table.reservation) == ("", "")
    (row,) = table.more[0].rows
    assert (row["sealed"], row["volume"], row["adopted"]) == (True, VOLUME, 0)
    stored = sum(len(place.collection(name)) for name in (SAMPLES, INDEX, SEGMENTS, AUDITS))
    assert row["documents"] == stored


def delete_a_topic(place: Place) -> None:
    """All samples and audits of a topic."""
    for name in (SAMPLES, AUDITS):
        for key in [key for key, document in place.collection(name).items() if document["topic"] == POSE]:
            del place.collection(name)[key]


def point_to_another_cloud(place: Place) -> None:
    """An index entry, together with its digest."""
    first, second, *_ = place.collection(INDEX).values()
    first |= {name: second[name] for name in ("sha256", "size", "offset", "segment")}


def delete_segments(place: Place) -> None:
    place.collection(SEGMENTS).clear()


def receive_one_less(place: Place) -> None:
    """In an audit, with the one message that it is about, coherently."""
    del place.collection(SAMPLES)[next(iter(place.collection(SAMPLES)))]
    audit = next(audit for audit in place.collection(AUDITS).values() if audit["topic"] == POSE)
    audit["received"] -= 1
    audit["stored"] -= 1


def receive_earlier(place: Place) -> None:
    next(iter(place.collection(INDEX).values()))["received"] -= 1


def replace_a_sample(place: Place) -> None:
    """A bucket by one with other bytes, named as its content asks for."""
    name, bucket = next(iter(place.collection(SAMPLES).items()))
    del place.collection(SAMPLES)[name]
    sample = bucket["samples"][0] | {"data": b"forged", "sha256": hashlib.sha256(b"forged").hexdigest()}
    content = hashlib.sha256(f"{sample['stamp']}:{sample['sha256']};".encode()).hexdigest()[:16]
    new = {**bucket, "samples": [sample], "_id": f"{RECORDING}/{POSE}/{bucket['second']}/{content}"}
    place.collection(SAMPLES)[new["_id"]] = new


def rename_the_task(place: Place) -> None:
    place.collection(RECORDINGS)[RECORDING]["provenance"] = {"task": "another"}


def change_a_type(place: Place) -> None:
    place.collection(RECORDINGS)[RECORDING]["topics"] = {**TOPICS, POSE: {"type": "other", "storage": "document"}}


CHANGES: dict[Callable[[Place], None], str] = {
    delete_a_topic: "1 sealed documents of audits of /pose are not there",
    point_to_another_cloud: "1 documents are not as they were sealed; the first: task-1//cloud/",
    delete_segments: "1 sealed documents of segments are not there",
    receive_one_less: "1 documents are not as they were sealed; the first: task-1/pose/",
    receive_earlier: "1 documents are not as they were sealed; the first: task-1//cloud/",
    replace_a_sample: "1 documents are in no manifest; the first: task-1//pose/",
    rename_the_task: "what the recording's own document says is not what was sealed",
    change_a_type: "what the recording's own document says is not what was sealed",
}


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_a_coherent_change_is_named(place: Place, change: Callable[[Place], None]) -> None:
    change(place)
    assert CHANGES[change] in place.verified().refusal


def sealed_again(place: Place) -> str:
    """Whoever has the database's account writes a new manifest by a key of his own; that key's public half."""
    secret = OneTimeKey(bytes(16), bytes(32))
    manifest = place.manifest
    chain = Chain(RECORDING, manifest["life"], VOLUME, secret.public.hex())
    manifests = place.collection(MANIFESTS)
    for name in [name for name, one in manifests.items() if "number" in one]:
        del manifests[name]
    for collection in (SAMPLES, INDEX, SEGMENTS, AUDITS):
        for document in place.collection(collection).values():
            chain.add(collection, document)
    part = chain.cut()
    manifests[part["_id"]] = part
    text = chain.statement(place.collection(RECORDINGS)[RECORDING], (), ())
    manifest |= {"key": chain.key, "statement": text, "signature": secret.sign(text.encode()).hex()}
    return chain.key


def test_a_seal_by_another_key_contradicts_what_the_volume_has(place: Place) -> None:
    delete_a_topic(place)
    sealed_again(place)
    table = place.verified()
    assert table.refusal == (
        f"{RECORDING}: what writer {place.manifest['life']} noted on {VOLUME} is not what the database has: another key"
    )


def test_a_key_from_the_log_stands_in_for_the_volume(place: Place) -> None:
    """Who changed database and volume alike has another key than the recorder's log said."""
    logged = place.manifest["key"]
    place.volume.noted.clear()
    table = place.verified()
    assert table.refusal == ""
    assert f"the database's word alone: {VOLUME} has no note of it; compare it with the writer's log" in (
        table.reservation
    )
    assert (place.verified((logged.upper(),)).refusal, place.verified((logged,)).reservation) == ("", "")
    sealed_again(place)
    assert "is none of those given by --key" in place.verified((logged,)).refusal


def test_a_recording_from_before_there_were_manifests_is_neither_refused_nor_called_whole(place: Place) -> None:
    place.collection(MANIFESTS).clear()
    place.volume.noted.clear()
    table = place.verified()
    assert table.refusal == ""
    assert table.reservation.startswith(f"{RECORDING}: has no manifest: it was recorded before there were any")


def test_a_manifest_that_was_taken_away_is_missed_by_the_volume(place: Place) -> None:
    life = place.manifest["life"]
    place.collection(MANIFESTS).clear()
    assert f"{VOLUME} has a note of writer {life}, of which the database has no manifest" in place.verified().refusal


def test_a_part_that_is_gone_or_changed_breaks_the_chain(place: Place) -> None:
    (name, *_) = [name for name, one in place.collection(MANIFESTS).items() if one.get("number") == 1]
    part = place.collection(MANIFESTS)[name]
    part["groups"] = part["groups"][1:]
    part["head"] = next_head(part["previous"], part["groups"])
    assert "does not hold: " in place.verified().refusal
    del place.collection(MANIFESTS)[name]
    assert "does not hold: its part 1 is not there, or was changed" in place.verified().refusal


def test_a_statement_of_another_recording_is_no_seal(place: Place) -> None:
    statement = json.loads(place.manifest["statement"])
    place.manifest["statement"] = json.dumps({**statement, "documents": 3})
    assert "does not hold: its seal is not by its key" in place.verified().refusal


def test_who_goes_on_behind_a_killed_writer_seals_what_that_one_had_not() -> None:
    place = killed_and_resumed()
    table = place.verified()
    assert "sealed" not in table.refusal.replace("has not sealed", "")
    assert all("killed" in gap["why"] for row in table.rows for gap in row["gaps"])
    first, second = table.more[0].rows
    assert (first["sealed"], second["sealed"]) == (False, True)
    assert second["adopted"] > 0
    stored = sum(len(place.collection(name)) for name in (SAMPLES, INDEX, SEGMENTS, AUDITS))
    assert first["documents"] + second["documents"] == stored


def test_what_a_killed_writer_left_is_watched_over_too() -> None:
    place = killed_and_resumed()
    first = min(place.collection(INDEX).values(), key=lambda entry: entry["stamp"])
    first["received"] += 1
    assert "1 documents are not as they were sealed" in place.verified().refusal
    lives = sorted(one["life"] for one in place.collection(MANIFESTS).values() if "number" not in one)
    for name in [name for name, one in place.collection(MANIFESTS).items() if one["life"] == lives[0]]:
        del place.collection(MANIFESTS)[name]
    refusal = place.verified().refusal
    assert f"the manifest of writer {lives[0]} is gone, behind which writer {lives[1]} went on" in refusal


def test_a_writer_that_was_killed_and_not_followed_has_sealed_nothing() -> None:
    place = Place()
    process = place.process()
    place.offer(*process)
    assert "has not sealed what it stored, and no later one went on behind it" in place.verified().refusal


def test_an_audit_that_gives_up_more_than_messages_is_no_explanation(place: Place) -> None:
    audit = next(audit for audit in place.collection(AUDITS).values() if audit["topic"] == POSE)
    gap = {"where": "spool", "why": "disk full", "count": 1, "first": BEGIN, "last": BEGIN}
    forged = {**audit, "_id": f"{audit['_id']}-0", "received": 0, "stored": 0, "dropped": 1, "gaps": [gap]}
    place.collection(AUDITS)[forged["_id"]] = forged
    assert "1 gaps" in place.verified().refusal
    forged["received"] = -1
    assert f"1 documents are in no manifest; the first: {forged['_id']}" in place.verified().refusal


def test_one_time_signatures_are_those_of_the_standard() -> None:
    """Values of another implementation of RFC 8554 for LMOTS_SHA256_N32_W4 (cisco/hash-sigs)."""
    key = OneTimeKey(bytes.fromhex("010a" * 8), bytes.fromhex("020b" * 16), 12)
    assert key.public[-32:].hex() == "a2cc303e27f17c386f939d90bb93a7799dce6835c9f3197ae88746695ab288d8"
    signature = key.sign(b"\x0a\x0b\x0c\x0d")
    expected = "3b763e78712dca8d2b129b6a80cd1476f22e925418915f62315baa0de6edd66e"
    assert hashlib.sha256(signature).hexdigest() == expected


def test_a_signature_holds_for_its_message_and_key_alone() -> None:
    key = OneTimeKey(bytes(16), b"s" * 32)
    signature = key.sign(b"message")
    assert holds(b"message", signature, key.public)
    assert not holds(b"messagf", signature, key.public)
    assert not holds(b"message", signature, OneTimeKey(bytes(16), b"t" * 32).public)
    for place in range(0, len(signature), 97):
        changed = bytearray(signature)
        changed[place] ^= 1
        assert not holds(b"message", bytes(changed), key.public)
    assert not holds(b"message", signature[:-1], key.public)
    assert not holds(b"message", b"", b"")


def test_the_secret_is_in_no_word_of_a_key() -> None:
    assert "seed" not in repr(OneTimeKey(bytes(16), b"secret" * 5 + b"00"))
