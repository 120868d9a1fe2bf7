"""Process of object-tracking: `python3 -m robotkube.entrypoints.object_tracking`."""

from __future__ import annotations

from robotkube.domain.perception_settings import read_track_settings
from robotkube.entrypoints.perception import GRACE_SECONDS, serve
from robotkube.entrypoints.processes import Process, run
from robotkube.services.object_tracking import ObjectTracking


def body(process: Process) -> None:
    """Follow objects until the process shall end."""
    serve(process, "object_tracking", ObjectTracking, read_track_settings)


if __name__ == "__main__":
    run("object-tracking", body, GRACE_SECONDS)
