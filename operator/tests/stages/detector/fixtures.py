"""Processes of detectors and publishers, on a ROS domain of this test run."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robotkube.foundation.documents.core.yaml_codec import write_mapping
from tests.stages.detector.process import SECONDS_MAX, Api, kept_port
from tests.stages.detector.proximity_settings import SETTINGS
from tests.stages.ros.ros_domains import domain as ros_domain


@pytest.fixture
def api() -> Iterator[Api]:
    api = Api(write_mapping(SETTINGS))
    thread = threading.Thread(target=api.serve_forever, args=(0.02,))
    thread.start()
    yield api
    api.closing.set()
    api.shutdown()
    api.server_close()
    thread.join(SECONDS_MAX)


@pytest.fixture
def unused_port() -> Iterator[int]:
    with kept_port() as port:
        yield port


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    processes: list[subprocess.Popen[str]] = []

    def start(*arguments: str, **environment: str) -> subprocess.Popen[str]:
        variables = {
            **os.environ,
            "ROS_DOMAIN_ID": ros_domain(),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(tmp_path / "ros"),
            "PYTHONPATH": os.pathsep.join(sys.path),
            **environment,
        }
        processes.append(
            subprocess.Popen(
                [sys.executable, *arguments], env=variables, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
        )
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.communicate(timeout=SECONDS_MAX)
