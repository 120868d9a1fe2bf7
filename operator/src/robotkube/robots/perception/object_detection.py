"""Process of object-detection: `python3 -m robotkube.robots.perception.object_detection`."""

from __future__ import annotations

from robotkube.foundation.runtime.process import Process, run
from robotkube.robots.perception.core.detection_settings import read_detection_settings
from robotkube.robots.perception.loops.object_detection import ObjectDetection
from robotkube.robots.perception.process import GRACE_SECONDS, serve


def body(process: Process) -> None:
    """Detect objects until the process shall end."""
    serve(process, "object_detection", ObjectDetection, read_detection_settings)


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("object-detection", body, GRACE_SECONDS)


if __name__ == "__main__":
    main()
