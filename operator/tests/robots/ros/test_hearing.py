"""The program with which the how-to listens in an agent's ROS network: it prints what a service answers."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.stages.paths import REPOSITORY
from tests.stages.ros.ros_domains import domain

pytestmark = pytest.mark.processes

PAGE = REPOSITORY / "docs" / "how-to" / "add-an-application.md"
SECONDS_MAX = 40
ANSWERING = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("answering")
said = node.create_publisher(String, "/vehicles/vehicle_00/said", 10)
node.create_subscription(String, "/vehicles/vehicle_00/heard", lambda m: said.publish(String(data=m.data + "!")), 10)
rclpy.spin(node)
"""


def test_it_prints_what_is_published_after_something_was_said(tmp_path: Path) -> None:
    [program] = re.findall(r"^```python hear.py\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    surroundings = {**os.environ, "ROS_DOMAIN_ID": domain("hearing"), "ROS_LOG_DIR": str(tmp_path)}
    answering = subprocess.Popen([sys.executable, "-c", ANSWERING], env=surroundings)
    try:
        topics = ["/vehicles/vehicle_00/said", "/vehicles/vehicle_00/heard"]
        done = subprocess.run(
            [sys.executable, "-", *topics, "good morning"],
            input=program,
            env=surroundings,
            capture_output=True,
            text=True,
            timeout=SECONDS_MAX,
            check=False,
        )
    finally:
        answering.kill()
        answering.wait()
    assert (done.returncode, done.stdout) == (0, "std_msgs.msg.String(data='good morning!')\n"), done.stderr
