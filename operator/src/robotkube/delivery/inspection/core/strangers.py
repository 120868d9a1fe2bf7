"""Strangers: what runs and may not, and the looks that see them."""

from __future__ import annotations

from dataclasses import dataclass

GROUP, VERSION, KIND, PLURAL = "robotkube.io", "v1alpha1", "Inspection", "inspections"
API_VERSION = f"{GROUP}/{VERSION}"

KUBELET, RELEASES, MACHINE = "kubelet", "releases", "machine"
LOOKS_AT = (KUBELET, RELEASES, MACHINE)

POD, CONTAINER, STATIC_POD = "Pod", "Container", "StaticPod"

# Why something is a stranger. The set is closed: each is a label of a metric.
FOREIGN_IMAGE = "ForeignImage"  # an image whose digest is not listed for its namespace
FOREIGN_CONTAINER = "ForeignContainer"  # a container that its pod does not name
FOREIGN_POD = "ForeignPod"  # the runtime has it, and its kubelet does not know it
STATIC = "StaticPod"  # put on the machine, not made by the API server
NO_RELEASE = "NoRelease"  # in an agent's namespace, and of no release that main has
NO_CONTROLLER = "NoController"  # in a namespace where controllers alone make pods, and made by none
FOREIGN_CHART = "ForeignChart"  # a release of a chart that is not verified on the catalogue's main
NOT_OF_THE_CHART = "NotOfTheChart"  # a workload is not what its release's chart renders
ON_THE_HOST = "WayToTheMachine"  # a pod that asks for its machine's network, processes, files, or for privileges
BESIDE_THE_KUBELET = "BesideTheKubelet"  # a container of the machine's runtime that no pod of its kubelet has
REASONS = (
    FOREIGN_IMAGE,
    FOREIGN_CONTAINER,
    FOREIGN_POD,
    STATIC,
    NO_RELEASE,
    NO_CONTROLLER,
    FOREIGN_CHART,
    NOT_OF_THE_CHART,
    ON_THE_HOST,
    BESIDE_THE_KUBELET,
)


@dataclass(frozen=True, order=True)
class Stranger:
    """Something that runs and may not. `kind` is that of the object (Pod, Deployment, ...), Container or StaticPod;
    `message` says what, why and what to do. `uid`: of the pod or workload that is meant; of a workload also the
    `generation` that was compared, and JSON pointers into that (`excess`) to what its chart does not render."""

    kind: str
    namespace: str
    name: str
    reason: str
    message: str
    container: str = ""
    image: str = ""
    digest: str = ""
    uid: str = ""
    generation: int = 0
    excess: tuple[str, ...] = ()

    @property
    def key(self) -> tuple[str, ...]:
        """What makes it the same stranger in the next look."""
        return (self.kind, self.namespace, self.name, self.container, self.reason)

    def __str__(self) -> str:
        place = "/".join(part for part in (self.namespace, self.name, self.container) if part)
        return f"{self.kind} {place}"


@dataclass(frozen=True)
class Look:
    """What one look saw. `problem` is empty, or says why it could not look: then nothing is claimed, and `strangers`
    is empty. `partly` says what of it could not be seen while the rest was."""

    looks_at: str
    strangers: tuple[Stranger, ...] = ()
    node: str = ""
    problem: str = ""
    partly: str = ""

    @property
    def name(self) -> str:
        """The name of its Inspection."""
        return f"{self.looks_at}.{self.node}" if self.node else self.looks_at
