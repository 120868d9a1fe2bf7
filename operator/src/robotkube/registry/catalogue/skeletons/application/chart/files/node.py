"""Repeats the texts of one topic on another. Settings: /etc/robotkube/config.yaml, read once at the start."""

import signal
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import rclpy
import yaml
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
TURN_SECONDS = 0.1

stopping, ready = threading.Event(), threading.Event()


class Health(BaseHTTPRequestHandler):
    """/livez as long as the process answers, /readyz once the topics are open."""

    def do_GET(self) -> None:
        """200, or 503 while not ready."""
        well = self.path == "/livez" or (self.path == "/readyz" and ready.is_set())
        self.send_response(200 if well else 503)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Probes come every few seconds; they are not worth a line."""


def main() -> None:
    """Open both topics and repeat until SIGTERM."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    threading.Thread(target=ThreadingHTTPServer(("", 8081), Health).serve_forever, daemon=True).start()
    settings = yaml.safe_load(Path("/etc/robotkube/config.yaml").read_text(encoding="utf-8"))
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    node = rclpy.create_node("__ROS__")
    publisher = node.create_publisher(String, settings["output"], QOS)
    node.create_subscription(String, settings["input"], publisher.publish, QOS)
    ready.set()
    while not stopping.is_set():
        rclpy.spin_once(node, timeout_sec=TURN_SECONDS)
    rclpy.try_shutdown()


main()
