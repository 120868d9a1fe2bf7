"""Pods as the manager reads them: where they are, what runs in them, and what their kubelets' probes say."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from robotkube.delivery.manager.core.observation import ContainerState, PodState
from robotkube.foundation.documents.core.shortening import shortened
from robotkube.foundation.kubernetes.adapters.client import Object

RELEASE_LABEL = "app.kubernetes.io/instance"
SAYS_NOTHING = frozenset({"", "ContainerCreating", "PodInitializing", "CrashLoopBackOff"})  # of the last, why it ended
WORDS_CHARACTERS_MAX = 300  # of a kubelet or a container


def read_time(text: str) -> float:
    """Kubernetes' time text as seconds since 1970."""
    return datetime.fromisoformat(text.replace("Z", "+00:00")).astimezone(UTC).timestamp()


def read_time_ns(text: str | None) -> int | None:
    """Kubernetes' time text in ns since 1970; None when there is none."""
    return None if text is None else int(read_time(text)) * 1_000_000_000


def read_pod(item: Object) -> PodState:
    """The fields of a pod that decide."""
    metadata = item["metadata"]
    status = item.get("status", {})
    release = metadata.get("labels", {}).get(RELEASE_LABEL, "")
    images = (c.get("imageID", "").rpartition("@")[2] for c in status.get("containerStatuses", []))
    ready: Object = next((c for c in status.get("conditions", []) if c.get("type") == "ContainersReady"), {})
    since = read_time_ns(ready.get("lastTransitionTime"))
    return PodState(
        namespace=metadata["namespace"],
        name=metadata["name"],
        release=f"{metadata['namespace']}/{release}",
        node=item.get("spec", {}).get("nodeName", ""),
        deleting=bool(metadata.get("deletionTimestamp")),
        images=tuple(sorted({image for image in images if image})),
        uid=metadata.get("uid", ""),
        containers=_containers(item.get("spec", {}), status),
        ready_since=since if ready.get("status") == "True" else None,
        unready_since=since if ready.get("status") == "False" else None,
    )


def _containers(spec: Object, status: Object) -> tuple[ContainerState, ...]:
    """The pod's containers. What ended with its machine has a reason `...Unknown`, and is no end of its own."""
    probed = {one["name"]: "readinessProbe" in one for one in spec.get("containers", [])}
    containers = []
    for one in status.get("containerStatuses", []):
        ended = one.get("state", {}).get("terminated") or one.get("lastState", {}).get("terminated", {})
        own = bool(ended) and not ended.get("reason", "").endswith("Unknown")
        containers.append(
            ContainerState(
                name=one["name"],
                probed=probed.get(one["name"], False),
                ready=bool(one.get("ready")),
                restarts=int(one.get("restartCount", 0)),
                ended_ns=read_time_ns(ended.get("finishedAt")) if own else None,
                started_ns=read_time_ns(one.get("state", {}).get("running", {}).get("startedAt")),
                ended_why=f"{ended.get('reason', '')}, exit code {ended.get('exitCode')}" if own else "",
                last_words=_words(ended) if own else "",
                waiting=_waiting(one.get("state", {}).get("waiting", {})),
            )
        )
    return tuple(containers)


def _waiting(state: Object) -> str:
    """Why a container cannot begin; empty while it is only on its way."""
    reason = str(state.get("reason", ""))
    return "" if reason in SAYS_NOTHING else ": ".join(filter(None, (reason, _words(state))))


def _words(state: Object) -> str:
    """The message of a container's state: the kubelet's, or what the container left as its termination message."""
    return shortened(" ".join(str(state.get("message") or "").split()), WORDS_CHARACTERS_MAX)


def placed(pod: PodState | None) -> Any:
    """The part of a pod that plans and tasks depend on at once: what its containers fail by, not their readiness, which
    is Argo CD's to report."""
    if pod is None:
        return None
    troubled = (container for container in pod.containers if container.ended_why or container.waiting)
    failing = tuple(
        ContainerState(
            one.name, restarts=one.restarts, ended_why=one.ended_why, last_words=one.last_words, waiting=one.waiting
        )
        for one in troubled
    )
    return replace(pod, containers=failing, ready_since=None, unready_since=None)
