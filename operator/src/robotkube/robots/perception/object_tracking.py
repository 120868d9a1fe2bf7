"""Process of object-tracking: `python3 -m robotkube.robots.perception.object_tracking`."""

from __future__ import annotations

from robotkube.foundation.runtime.process import Process, run
from robotkube.robots.perception.core.tracking_settings import read_tracking_settings
from robotkube.robots.perception.loops.object_tracking import ObjectTracking
from robotkube.robots.perception.process import GRACE_SECONDS, serve


def body(process: Process) -> None:
    """Track objects until the process shall end."""
    serve(process, "object_tracking", ObjectTracking, read_tracking_settings)


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("object-tracking", body, GRACE_SECONDS)


if __name__ == "__main__":
    main()
