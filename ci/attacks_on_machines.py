"""Attacks past the API server's policies: on machines, and on what the API server takes for true (`ci.attacks`)."""

from __future__ import annotations

from ci.attack_cells import Attack, Refused, Unseen
from ci.attack_shared import NO_DEMAND, NOT_PROPOSED

VOLUMES = "registry/admission/test_volumes_api_server.py"

ON_MACHINES = (
    Attack(
        "link-in-a-volume",
        "A folder of the machine becomes a volume, by a symbolic link that a pod left in its own (embedded cluster)",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "PersistentVolume … is of a folder that is not for volumes",
            f"{VOLUMES}::test_a_volume_of_another_folder_is_refused",
        ),
        Unseen("which folder is behind a volume claim is not looked at"),
    ),
)
