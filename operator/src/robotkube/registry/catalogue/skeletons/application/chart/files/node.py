"""Repeats the texts of one topic on another. Its settings are watched: changed ones open other topics at once."""

import signal
import sys
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from robotkube.services import WatchedSettings

sys.path.insert(0, str(Path(__file__).parent))  # the image's Python leaves the program's own folder out
from answers import answer

QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
TURN_SECONDS = 0.1

stopping, ready = threading.Event(), threading.Event()


def answering(publisher: Publisher) -> Callable[[String], None]:
    """What is done with each message that is heard."""

    def say(message: String) -> None:
        text = answer(message.data)
        if text is not None:
            publisher.publish(String(data=text))

    return say


class Relay:
    """Both topics, as the newest settings name them."""

    def __init__(self, node: Node) -> None:
        """Nothing is open yet."""
        self.node = node
        self.publisher = self.subscription = None

    def apply(self, settings: dict) -> None:
        """Open the topics that the settings name, then close those before."""
        before = self.publisher, self.subscription
        publisher = self.node.create_publisher(String, settings["output"], QOS)
        self.subscription = self.node.create_subscription(String, settings["input"], answering(publisher), QOS)
        self.publisher = publisher
        if before[0] is not None:
            self.node.destroy_publisher(before[0])
            self.node.destroy_subscription(before[1])


class Health(BaseHTTPRequestHandler):
    """/livez as long as the process answers, /readyz once the topics of the newest settings are open."""

    complaint = staticmethod(lambda: None)

    def do_GET(self) -> None:
        """200, or 503 while not ready."""
        well = self.path == "/livez" or (self.path == "/readyz" and ready.is_set() and not self.complaint())
        self.send_response(200 if well else 503)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Probes come every few seconds; they are not worth a line."""


def main() -> None:
    """Repeat until SIGTERM."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    threading.Thread(target=ThreadingHTTPServer(("", 8081), Health).serve_forever, daemon=True).start()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    node = rclpy.create_node("__ROS__")
    settings = WatchedSettings(Relay(node).apply)
    Health.complaint = staticmethod(lambda: settings.complaint)
    ready.set()
    while not stopping.is_set():
        settings.apply_changes()
        rclpy.spin_once(node, timeout_sec=TURN_SECONDS)
    rclpy.try_shutdown()


main()
