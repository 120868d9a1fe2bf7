"""What keeps the pods of a release from being ready, in words for whoever asked for it."""

from __future__ import annotations

from collections.abc import Iterable

from robotkube.delivery.manager.core.observation import ContainerState, PodState


def pod_troubles(pods: Iterable[PodState]) -> list[str]:
    """A sentence for each container that is not ready for a cause that its kubelet knows: it cannot begin, or it ended
    and is started again and again."""
    standing = (pod for pod in pods if not pod.deleting)
    return [
        f"pod {pod.name}: {words}" for pod in standing for container in pod.containers if (words := _words(container))
    ]


def _words(container: ContainerState) -> str:
    if container.ready:
        return ""
    if container.ended_why:
        times = f"started again {container.restarts} time{'' if container.restarts == 1 else 's'}"
        cause = f": {container.last_words}" if container.last_words else "; its log says why"
        return f"container {container.name} ended ({container.ended_why}), {times}{cause}"
    return f"container {container.name} cannot begin ({container.waiting})" if container.waiting else ""
