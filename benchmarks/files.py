"""What writing files costs: packing a chart against `helm package`, a recording's segments against plain files."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from pathlib import Path

from benchmarks.measuring.comparisons import Comparison, seconds
from ci.folders import PROJECT
from ci.machine import preparing
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.robots.recording.adapters.segments import McapSegments
from robotkube.robots.recording.core.documents import Received

CHART = PROJECT / "charts" / "apps" / "event-detector"
IMAGES = {"event-detector": "registry.example/image@sha256:1"}
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
CLOUD_BYTES, CLOUDS = 320_000, 100
REPETITIONS = 5
PACKING_RATIO_MAX, SEGMENTS_RATIO_MAX = 1.0, 3.0
HELM_SECONDS_MAX = 60


def packing() -> Comparison:
    """A chart, packed reproducibly."""
    helm = preparing.tool_chain() / "helm"
    with tempfile.TemporaryDirectory() as folder:
        command = [str(helm), "package", str(CHART), "--destination", folder]

        def baseline() -> None:
            subprocess.run(command, check=True, capture_output=True, timeout=HELM_SECONDS_MAX, env={"HOME": folder})

        theirs = seconds(baseline, REPETITIONS)
    ours = seconds(lambda: pack(CHART, IMAGES), REPETITIONS)
    return Comparison(
        "pack the chart of the event detector", "ms", ours * 1000, theirs * 1000, PACKING_RATIO_MAX, "helm package"
    )


def segments() -> Comparison:
    """Clouds that are on the disk, each, before the next is taken."""
    data = os.urandom(CLOUD_BYTES)
    with tempfile.TemporaryDirectory() as folder:
        writer = McapSegments(Path(folder), "benchmark", time.time_ns)

        def ours() -> None:
            for number in range(CLOUDS):
                writer.append([(Received("/cloud", number, number, "", data), CLOUD_TYPE)])

        with (Path(folder) / "plain").open("wb") as file:

            def baseline() -> None:
                for _ in range(CLOUDS):
                    file.write(data)
                    file.flush()
                    os.fsync(file.fileno())

            theirs, mine = seconds(baseline, REPETITIONS), seconds(ours, REPETITIONS)
        writer.close()
    name = f"store a cloud of {CLOUD_BYTES} bytes"
    return Comparison(name, "ms", mine * 1000 / CLOUDS, theirs * 1000 / CLOUDS, SEGMENTS_RATIO_MAX, "write and fsync")


def compare() -> list[Comparison]:
    """Both."""
    return [packing(), segments()]
