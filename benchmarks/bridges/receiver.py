"""Stands for the detector's input in measurements: drains subscriptions, counts, and notes ages or hashes.

    python3 -m benchmarks.bridges.receiver RESULT [--hashes] [--period-ms 30] TOPIC=TYPE[:latched] ...

RESULT is written whenever nothing more comes, and at SIGTERM (the middleware may hang there): per topic the number of
messages, ages in ms by bucket and, with --hashes, stamp and SHA-256 of every message in the order of arrival.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections import Counter
from pathlib import Path

from robotkube.foundation.runtime.process import Process, run
from robotkube.robots.ros.adapters.rclpy_node import RosNode
from robotkube.robots.ros.core.common_messages import header_stamp

AGE_MS_MAX = 10_000


def body(process: Process) -> None:
    """Drain until the process shall end, then write the result."""
    arguments = _arguments()
    node = RosNode("receiver")
    sources, kinds = {}, {}
    for text in arguments.topics:
        name, _, kind = text.partition("=")
        kind, _, latched = kind.partition(":")
        durability = "transient_local" if latched else "volatile"
        sources[name] = node.subscribe(name, kind, durability=durability, depth=1000)
        kinds[name] = kind
    ages: dict[str, Counter[int]] = {name: Counter() for name in sources}
    hashes: dict[str, list[tuple[int, str]]] = {name: [] for name in sources}
    received: Counter[str] = Counter()

    def save() -> None:
        result = {
            name: {"received": received[name], "ages_ms": sorted(ages[name].items()), "hashes": hashes[name]}
            for name in sources
        }
        unfinished = Path(f"{arguments.result}.part")
        unfinished.write_text(json.dumps(result))
        unfinished.rename(arguments.result)

    saved = 0
    while not process.stopping.wait(arguments.period_ms / 1000):
        before = received.total()
        for name, source in sources.items():
            messages = source.take()
            now = time.time_ns()
            for data in messages:
                stamp = header_stamp(data)
                ages[name][min((now - stamp) // 1_000_000, AGE_MS_MAX)] += 1
                if arguments.hashes:
                    hashes[name].append((stamp, hashlib.sha256(data).hexdigest()))
            received[name] += len(messages)
        if saved < before == received.total():
            save()
            saved = before
    save()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("result")
    parser.add_argument("--hashes", action="store_true")
    parser.add_argument("--period-ms", type=int, default=30)
    parser.add_argument("topics", nargs="+")
    return parser.parse_args()


if __name__ == "__main__":
    run("receiver", body, 3.0)
