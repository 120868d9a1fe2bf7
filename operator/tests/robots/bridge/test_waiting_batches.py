"""Batches that wait: which goes next and which has to go, against a plain list of them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robotkube.robots.bridge.core.waiting_batches import OutgoingBatch, WaitingBatches

TOPICS = ("/a", "/b", "/dated", "/kept")


def batch(topic: str, number: int) -> OutgoingBatch:
    deadline = 1.0 if topic == "/dated" else 0.0
    payload = bytes(1 + number % 5)
    return OutgoingBatch(topic, payload, 1, topic == "/kept", float(number), name=topic, deadline_seconds=deadline)


@given(st.lists(st.sampled_from([*TOPICS, "take", "put back", "oldest", "thickest", "forget"]), max_size=60))
def test_any_history_is_that_of_a_plain_list(actions: list[str]) -> None:
    waiting = WaitingBatches()
    model = list[OutgoingBatch]()
    received: list[OutgoingBatch] = []
    for number, action in enumerate(actions):
        model.sort(key=lambda one: (not one.deadline_seconds, one.born))
        if action in TOPICS:
            waiting.append(batch(action, number))
            model.append(batch(action, number))
        elif action == "take" and model:
            received.append(waiting.take())
            assert received[-1] == model.pop(0)
        elif action == "put back" and received:
            waiting.put_back(received)
            model += received
            received = []
        elif action == "oldest" and model:
            wanted = min(model, key=lambda one: (one.retained, one.born))
            assert waiting.oldest == wanted
            waiting.remove(wanted)
            model.remove(wanted)
        elif action == "thickest" and model:
            chosen = waiting.thickest
            sizes = dict.fromkeys(TOPICS, 0)
            for one in model:
                sizes[one.topic] += 0 if one.retained else len(one.payload)
            assert sizes[chosen.topic] == max(sizes.values())
            waiting.remove(chosen)
            model.remove(chosen)
        elif action == "forget":
            waiting.remove_topic("/a")
            model = [one for one in model if one.topic != "/a"]
    model.sort(key=lambda one: (not one.deadline_seconds, one.born))
    assert list(waiting) == model
    assert waiting.count == len(model)
    assert waiting.bytes == sum(len(one.payload) for one in model)
