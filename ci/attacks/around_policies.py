"""Attacks that go around what is asked of pods and workloads: by registrations, subresources and volumes
(`ci.attacks`)."""

from __future__ import annotations

from ci.attacks.cells import Attack, Refused, Unseen
from ci.attacks.shared_cells import INSPECTION, NO_DEMAND, NOT_PROPOSED, NOTHING_RUNS, OTHERWISE

VOLUMES = "registry/admission/test_volumes_api_server.py"
SUBRESOURCES = "registry/admission/test_subresources_api_server.py"
REGISTRATIONS = "registry/admission/test_registrations_api_server.py"
REGISTERED = Refused(
    "… written by …: in a cluster of the platform alone nobody else changes, refuses or answers requests",
    f"{REGISTRATIONS}::test_nobody_has_requests_changed_or_refused_otherwise",
)

AROUND_POLICIES = (
    Attack(
        "mutating-policy",
        "A mutating policy or webhook is registered, to change verified pods as they are made (embedded cluster)",
        NO_DEMAND,
        NOT_PROPOSED,
        REGISTERED,
        NOTHING_RUNS,
    ),
    Attack(
        "report-refused",
        "A validating policy or webhook is registered, to keep the inspector from saying what it sees (embedded)",
        NO_DEMAND,
        NOT_PROPOSED,
        REGISTERED,
        NOTHING_RUNS,
    ),
    Attack(
        "annotation-by-status",
        "An annotation is written to a Deployment of an agent with its status, or to a pod",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "labels or annotations of … changed with its status by …: in its namespace labels and annotations are "
            "those that main says",
            f"{SUBRESOURCES}::test_no_annotation_comes_with_a_status",
        ),
        OTHERWISE,
    ),
    Attack(
        "pod-resized",
        "A pod of an agent is resized while it runs (`pods/resize`)",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "pod … resized by …: in its namespace a container has what its chart asks for",
            f"{SUBRESOURCES}::test_no_pod_is_resized",
        ),
        Refused("pod … is not what the chart of its release renders", f"{INSPECTION}::test_a_pod_that_was_resized"),
    ),
    Attack(
        "node-relabelled",
        "Who has a machine's kubelet labels its Node as the platform's, or another agent's, to have their pods come",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "labels of Node … changed by …: whose machine it is, and what for (robotkube.io/), is not its own to say",
            "registry/admission/test_nodes_api_server.py::test_a_kubelet_does_not_say_whose_its_machine_is",
        ),
        NOTHING_RUNS,
    ),
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
