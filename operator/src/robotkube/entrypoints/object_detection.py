"""Process of object-detection: `python3 -m robotkube.entrypoints.object_detection`."""

from __future__ import annotations

from robotkube.domain.perception_settings import read_detection_settings
from robotkube.entrypoints.perception import GRACE_SECONDS, serve
from robotkube.entrypoints.processes import Process, run
from robotkube.services.object_detection import ObjectDetection


def body(process: Process) -> None:
    """Find objects until the process shall end."""
    serve(process, "object_detection", ObjectDetection, read_detection_settings)


if __name__ == "__main__":
    run("object-detection", body, GRACE_SECONDS)
