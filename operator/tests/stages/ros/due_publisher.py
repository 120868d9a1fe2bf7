"""Publishes messages when they are due, takes them itself, and writes what came of it as JSON.

python -m tests.stages.ros.due_publisher TOPIC FILE
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robotkube.robots.ros.adapters.rclpy_node import RosNode, RosPublisher, RosSubscription
from tests.stages.ros.self_receiver import TYPE, message, number_of, rounds

COUNT, STEP_NS, SECOND_NS = 20, 10_000_000, 1_000_000_000
TURNS = 11
LATE_NS = SECOND_NS


def main(topic: str, file: Path) -> None:
    """Publish in every way, write."""
    node = RosNode("publishing")
    publishers = [node.advertise(f"{topic}/{name}", TYPE, depth=100) for name in ("a", "b")]
    subscriptions = [node.subscribe(f"{topic}/{name}", TYPE, depth=100) for name in ("a", "b")]
    for _ in rounds():
        if all(publisher.matched for publisher in publishers):
            break
    results = {
        "in_turns": in_turns(node, publishers, subscriptions),
        "past": past(node, publishers[0]),
        "signal": signalled(node, publishers[0], subscriptions[0]),
        "none": node.publish_due([], LATE_NS),
        "wrong": wrong(lambda: node.publish_due([(publishers[0], 0, "text")], LATE_NS)),  # type: ignore[list-item]
        "closed": closed(node, publishers),
    }
    file.write_text(json.dumps(results))
    os._exit(0)


def in_turns(node: RosNode, publishers: list[RosPublisher], subscriptions: list[RosSubscription]) -> dict[str, Any]:
    """Two topics in turns, on a grid; how often another thread ran meanwhile."""
    begin = time.time_ns() + 10 * STEP_NS
    turns = itertools.count()
    ended = threading.Event()

    def count() -> None:
        while not ended.wait(0.001):
            next(turns)

    other = threading.Thread(target=count)
    other.start()
    asked = [(publishers[k % 2], begin + k * STEP_NS, message(k)) for k in range(COUNT)]
    outcome = node.publish_due(asked, LATE_NS)
    took = time.time_ns() - begin
    ended.set()
    other.join()
    taken: list[list[tuple[int, int]]] = [[], []]
    for _ in rounds():
        for several, subscription in zip(taken, subscriptions, strict=True):
            several += [(number_of(data), sent.time - begin) for data, _, sent in subscription.take_sent()]
        if sum(map(len, taken)) == COUNT:
            break
    return {"outcome": outcome, "took": took, "taken": taken, "turns": next(turns)}


def past(node: RosNode, publisher: RosPublisher) -> Any:
    """Due two seconds ago, just now, and soon."""
    now = time.time_ns()
    dues = (now - 2 * SECOND_NS, now - STEP_NS, now + STEP_NS)
    return node.publish_due([(publisher, due, message(0)) for due in dues], LATE_NS)


def signalled(node: RosNode, publisher: RosPublisher, subscription: RosSubscription) -> dict[str, Any]:
    """A signal comes between the first and the second, which is due in ten minutes: another thread sends it when it has
    received the first one and taken TURNS turns after that, all while the call waits."""
    seen: list[int] = []
    turns: list[int] = []
    signal.signal(signal.SIGALRM, lambda number, _: seen.append(number))
    first = message(COUNT)

    def interrupt() -> None:
        for _ in rounds():
            if any(data == first for data, _, _ in subscription.take_sent()):
                break
        while len(turns) < TURNS:
            time.sleep(0.001)
            turns.append(len(seen))
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGALRM)

    now = time.time_ns()
    other = threading.Thread(target=interrupt)
    other.start()
    dues = [(publisher, now, first), (publisher, now + 600 * SECOND_NS, message(COUNT + 1))]
    outcome = node.publish_due(dues, 60 * SECOND_NS)
    at_return = {"seen": list(seen), "turns": len(turns), "seconds": (time.time_ns() - now) / SECOND_NS}
    other.join()
    return {"outcome": outcome, **at_return}


def closed(node: RosNode, publishers: list[RosPublisher]) -> Any:
    """The second one's publisher is closed."""
    publishers[1].close()
    return node.publish_due([(publisher, 0, message(0)) for publisher in (*publishers, publishers[0])], LATE_NS)


def wrong(call: Callable[[], object]) -> str:
    """The error's kind."""
    try:
        call()
    except (TypeError, RuntimeError) as error:
        return type(error).__name__
    return "none"


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
