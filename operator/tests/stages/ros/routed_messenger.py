"""Says a word to another pod and hears that one's, first by multicast alone, then with discovery by unicast. Prints how
many words were heard before, and ends with 0 when one was heard afterwards, after SECONDS_MAX with 1.

    python -m tests.stages.ros.routed_messenger OWN PEER

OWN and PEER are addresses; who has the greater one says `/b`, the other `/a`.
"""

from __future__ import annotations

import sys
import time

from robotkube.robots.ros.adapters.rclpy_node import RosNode, RosPublisher, RosSubscription
from robotkube.robots.ros.adapters.unicast_discovery import UnicastDiscovery

TYPE = "std_msgs/msg/Empty"
WORD = b"\0\1\0\0\0"
TURNS_BEFORE = 20
TURN_SECONDS = 0.1
SECONDS_MAX = 30.0


def turn(said: RosPublisher, heard: RosSubscription) -> int:
    """Say it once; how often the other one's was heard meanwhile."""
    said.publish(WORD)
    time.sleep(TURN_SECONDS)
    return len(list(heard.take(100)))


def main(own: str, peer: str) -> int:
    node = RosNode("messenger")
    topics = ("/b", "/a") if own > peer else ("/a", "/b")
    said = node.advertise(topics[0], TYPE)
    heard = node.subscribe(topics[1], TYPE)
    print("before:", sum(turn(said, heard) for _ in range(TURNS_BEFORE)), flush=True)
    discovery = UnicastDiscovery(0, lambda: frozenset({own, peer}), lambda: frozenset({own}))
    end = time.monotonic() + SECONDS_MAX
    while not (ended := turn(said, heard)) and time.monotonic() < end:
        pass
    print("after:", ended, flush=True)
    for _ in range(TURNS_BEFORE):  # the other one may have begun later
        said.publish(WORD)
        time.sleep(TURN_SECONDS)
    discovery.close()
    node.close()
    return 0 if ended else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
