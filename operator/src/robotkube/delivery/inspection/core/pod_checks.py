"""Strangers on a node: what its kubelet was told to run and what its runtime has, compared with what may run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from robotkube.delivery.inspection.core.kubelet_pods import EPHEMERAL, KINDS, Container, KubeletPod, RuntimePod
from robotkube.delivery.inspection.core.permitted import Permitted
from robotkube.delivery.inspection.core.pod_templates import pod_differences
from robotkube.delivery.inspection.core.strangers import (
    CONTAINER,
    FOREIGN_CONTAINER,
    FOREIGN_IMAGE,
    FOREIGN_POD,
    NO_CONTROLLER,
    NO_RELEASE,
    NOT_OF_THE_CHART,
    ON_THE_HOST,
    POD,
    STATIC,
    STATIC_POD,
    Stranger,
)
from robotkube.registry.admission.core.expressions import VOLUMES_OF_PODS

CONTROL_PLANE = "kube-system"  # where clusters keep static pods of their own
ENDING_SECONDS_MAX = 120.0  # after the time by which a pod was to have ended
MAKERS = ("ReplicaSet", "StatefulSet", "DaemonSet", "Job", "ReplicationController")
REMOVE = "Delete it; what is to run is proposed as a release (robotkube task submit)"
ON_THE_MACHINE = "It was started on the machine: look who has access to it, and stop it there"
HOST_KEYS = ("hostNetwork", "hostPID", "hostIPC")


def strangers_on(
    pods: Iterable[KubeletPod],
    running: Iterable[RuntimePod],
    remembered: Mapping[str, frozenset[str]],
    permitted: Permitted,
    now: float,
) -> tuple[Stranger, ...]:
    """Strangers of a node. `remembered`: names of containers of pods that the kubelet listed lately, by uid: it forgets
    a pod before the last container of it has ended."""
    listed = {pod.uid: pod for pod in pods}
    runs = list(running)
    alive = {pod.uid for pod in runs if pod.containers}
    strangers = [
        stranger
        for pod in listed.values()
        if not pod.finished or pod.uid in alive
        for stranger in _of_pod(pod, permitted, now)
    ]
    for item in runs:
        known = listed[item.uid].names if item.uid in listed else remembered.get(item.uid)
        strangers += _of_runtime(item, known)
    return tuple(sorted(strangers))


def _of_runtime(item: RuntimePod, known: frozenset[str] | None) -> Iterator[Stranger]:
    """What the runtime has under a pod's identity and its kubelet was not told to run."""
    counts = Counter(name for name, _ in item.containers)
    images = dict(item.containers)
    if known is None:
        if counts:
            words = ", ".join(sorted(counts))
            text = f"pod {item.namespace}/{item.name} runs ({words}) and its kubelet does not know it. {ON_THE_MACHINE}"
            yield Stranger(POD, item.namespace, item.name, FOREIGN_POD, text)
        return
    for name in sorted(counts):
        place = f"container {name} runs in pod {item.namespace}/{item.name}"
        if name not in known:
            text = f"{place}, which does not name it. {ON_THE_MACHINE}"
        elif counts[name] > 1:
            text = f"{place} {counts[name]} times, and the pod names it once. {ON_THE_MACHINE}"
        else:
            continue
        yield Stranger(CONTAINER, item.namespace, item.name, FOREIGN_CONTAINER, text, name, images[name], uid=item.uid)


def _of_pod(pod: KubeletPod, permitted: Permitted, now: float) -> Iterator[Stranger]:
    if pod.static:
        if permitted.is_ours(pod.namespace) or permitted.domain.elsewhere or pod.namespace != CONTROL_PLANE:
            text = (
                f"static pod {pod.namespace}/{pod.name}: a file of the machine names it, no controller. Take the file "
                "from the kubelet's folder of static pods"
            )
            yield _stranger(pod, STATIC, text, STATIC_POD)
        return
    if pod.ends is not None and now < pod.ends + ENDING_SECONDS_MAX:
        return  # it is being taken away
    yield from _images(pod, permitted)
    domain = permitted.domain
    way = _way_to_the_machine(pod.spec or {}) if permitted.is_judged(pod.namespace) else ""
    if way:
        text = f"pod {pod.namespace}/{pod.name} has a way to its machine: {way}. Nothing here needs one. {REMOVE}"
        yield _stranger(pod, ON_THE_HOST, text)
    if pod.namespace in (*domain.agents, *domain.tests):
        yield from _added(pod)
    if pod.namespace in domain.agents:
        yield from _release(pod, permitted)
    elif pod.namespace in domain.of_the_platform and pod.owner[0] not in MAKERS:
        text = f"pod {pod.namespace}/{pod.name}: no controller made it, and in this namespace they alone do. Delete it"
        yield _stranger(pod, NO_CONTROLLER, text)


def _way_to_the_machine(spec: Mapping[str, Any]) -> str:
    """What of a pod admission would refuse as a way to its machine, in words; empty when there is none."""
    ways = [key for key in HOST_KEYS if spec.get(key)]
    ways += [way for volume in spec.get("volumes") or () for way in _mounted(volume)]
    for kind in KINDS:
        for entry in spec.get(kind) or ():
            context = entry.get("securityContext") or {}
            added = set((context.get("capabilities") or {}).get("add") or ()) - {"NET_BIND_SERVICE"}
            if context.get("privileged"):
                ways.append(f"container {entry.get('name')} is privileged")
            if context.get("procMount", "Default") != "Default":
                ways.append(f"container {entry.get('name')} has procMount {context['procMount']}")
            if added:
                ways.append(f"container {entry.get('name')} has {', '.join(sorted(added))}")
    return ", ".join(ways)


def _mounted(volume: Mapping[str, Any]) -> Iterator[str]:
    """A volume that is a folder, a disk or a file system that the machine mounts, in words."""
    for kind in sorted(volume.keys() - {"name", *VOLUMES_OF_PODS}):
        yield f"hostPath {volume[kind].get('path')}" if kind == "hostPath" else f"volume {volume['name']} ({kind})"


def _images(pod: KubeletPod, permitted: Permitted) -> Iterator[Stranger]:
    """Containers whose image may not run in the pod's namespace, as the pod names it or as its runtime says."""
    for container in pod.containers:
        if not permitted.image(container.image, pod.namespace):
            yield _foreign_image(pod, container, container.image)
        elif container.running_digest and container.running_digest not in container.image:
            other = f"{container.image.partition('@')[0]}@{container.running_digest}"
            if not permitted.image(other, pod.namespace):
                yield _foreign_image(pod, container, other)
    for reference in pod.volume_images:
        if not permitted.image(reference, pod.namespace):
            text = f"pod {pod.namespace}/{pod.name} has image {reference} as a volume, which may not run here. {REMOVE}"
            yield _stranger(pod, FOREIGN_IMAGE, text, image=reference)


def _foreign_image(pod: KubeletPod, container: Container, image: str) -> Stranger:
    text = (
        f"container {container.name} of pod {pod.namespace}/{pod.name} runs image {image}, which is not listed for "
        f"this namespace. {REMOVE}"
    )
    digest = image.partition("@")[2]
    return Stranger(CONTAINER, pod.namespace, pod.name, FOREIGN_IMAGE, text, container.name, image, digest, uid=pod.uid)


def _added(pod: KubeletPod) -> Iterator[Stranger]:
    for container in pod.containers:
        if container.kind == EPHEMERAL:
            text = (
                f"container {container.name} was added to pod {pod.namespace}/{pod.name} while it ran (kubectl debug): "
                "nobody verified the pod with it. Delete the pod; its controller makes it anew"
            )
            yield Stranger(
                CONTAINER,
                pod.namespace,
                pod.name,
                FOREIGN_CONTAINER,
                text,
                container.name,
                container.image,
                uid=pod.uid,
            )


def _release(pod: KubeletPod, permitted: Permitted) -> Iterator[Stranger]:
    """Return whether a pod is of a release that main has, and is what that release's chart renders."""
    kind, name = pod.owner
    workload = name.rpartition("-")[0]  # the name of its Deployment
    shape = permitted.release(pod.namespace, workload, pod.release) if kind == "ReplicaSet" else None
    if shape is None:
        what = f"release {pod.release}" if pod.release else "any release"
        text = f"pod {pod.namespace}/{pod.name} is not of {what} that main of the deployment has. {REMOVE}"
        yield _stranger(pod, NO_RELEASE, text)
    elif not shape.unknown:
        problem = _otherwise(pod, shape.versions(workload))
        if problem:
            place = f"pod {pod.namespace}/{pod.name}"
            step = f"Delete it; if the new one is not either, delete Deployment {workload}, which Argo CD makes anew"
            text = f"{place} is not what the chart of its release renders: {problem}. {step}"
            yield _stranger(pod, NOT_OF_THE_CHART, text)


def _otherwise(pod: KubeletPod, versions: Iterable[Mapping[str, Any]]) -> str:
    """How a pod differs from its workload's template; empty when it is as main has or had it."""
    first = ""
    for version in versions:
        template = (version.get("spec") or {}).get("template") or {}
        problems = pod_differences(pod.labels, pod.annotations, pod.spec or {}, template)
        if not problems:
            return ""
        first = first or "; ".join(problems)
    return first


def _stranger(pod: KubeletPod, reason: str, text: str, kind: str = POD, image: str = "") -> Stranger:
    digest = image.partition("@")[2]
    return Stranger(kind, pod.namespace, pod.name, reason, text, image=image, digest=digest, uid=pod.uid)
