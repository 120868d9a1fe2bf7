"""The documents of what the API server has of nodes, pods and Applications, read as the manager reads them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.delivery.console.core.moments import ns_ms, text_ms
from robotkube.delivery.manager.adapters.kubernetes_cluster import read_application
from robotkube.delivery.manager.adapters.pod_states import read_pod
from robotkube.delivery.manager.core.observation import ContainerState
from robotkube.delivery.manager.core.placement.placement import NodeState
from robotkube.foundation.kubernetes.core.objects import object_key

Object = Mapping[str, Any]

RESERVED = "reserved"  # the role of an agent that has no Node yet, and none in the values


def pod_document(item: Object) -> dict[str, Any]:
    """The item of a pod of a release."""
    pod = read_pod(item)
    status = item.get("status") or {}
    return {
        "namespace": pod.namespace,
        "name": pod.name,
        "release": pod.release,
        "agent": pod.namespace,
        "node": pod.node,
        "phase": str(status.get("phase", "")),
        "ready": pod.ready_since is not None,
        "restarts": sum(container.restarts for container in pod.containers),
        "trouble": "; ".join(filter(None, map(_trouble, pod.containers))),
        "started_ms": text_ms(status.get("startTime")),
        "ready_ms": ns_ms(pod.ready_since),
        "deleting": pod.deleting,
    }


def _trouble(container: ContainerState) -> str:
    """Why a container cannot begin, or how one that does not run ended."""
    ended = container.ended_why if container.started_ns is None else ""
    words = ": ".join(filter(None, (container.waiting or ended, container.last_words if ended else "")))
    return f"container {container.name}: {words}" if words else ""


def release_document(item: Object) -> dict[str, Any]:
    """The item of an Argo CD Application; who asks for it is added where tasks are known."""
    application = read_application(item)
    release = release_key(item)
    source = application.source
    return {
        "release": release,
        "agent": release.partition("/")[0],
        "application": application.name,
        "chart": str(source.get("repoURL", "")).rpartition("/")[2],
        "digest": str(source.get("targetRevision", "")),
        "plan": application.plan,
        "sync": application.sync,
        "health": application.health,
        "messages": list(application.conditions),
        "demands": [],
    }


def release_key(item: Object) -> str:
    """The key `<namespace>/<release>` of the release that an Application applies."""
    name = item["spec"].get("source", {}).get("helm", {}).get("releaseName")
    return f"{item['spec']['destination']['namespace']}/{name or item['metadata']['name']}"


def agent_document(agent: Object, nodes: Iterable[NodeState]) -> dict[str, Any]:
    """The item of a declared agent (`name`, `role`, `namespace`, `records`) with its Nodes, which say the role of one
    whose name is reserved. `nodes` are those of all agents: they say who shares one."""
    known = tuple(nodes)
    own = sorted((node for node in known if node.agent == agent["name"]), key=lambda node: node.name)
    silent = [node.silent_since for node in own if node.silent_since is not None]
    hold = next((node.hold for node in own if node.hold is not None), None)
    return {
        **agent,
        "role": agent["role"] or next((node.role for node in own if node.role), RESERVED),
        "capabilities": sorted({name for node in own for name in node.capabilities}),
        "nodes": [
            {
                "name": node.name,
                "ready": node.ready,
                "cordoned": node.cordoned,
                "since_ms": ns_ms(node.ready_since if node.ready else node.not_ready_since),
                "shared_with": _others(node, known),
            }
            for node in own
        ],
        "ready": bool(own) and all(node.ready for node in own),
        "silent_since_ms": ns_ms(min(silent, default=None)),
        "hold": None if hold is None else {"reason": hold.reason, "until_ms": ns_ms(hold.until_ns)},
    }


def _others(own: NodeState, nodes: Iterable[NodeState]) -> list[str]:
    """The other agents of a Node, its host first; none where it is one agent's alone."""
    return [node.agent for node in nodes if node.name == own.name and node.agent not in ("", own.agent)]


def pod_documents(items: Iterable[Object]) -> dict[str, dict[str, Any]]:
    """The items of pods, by key."""
    return {object_key(item): pod_document(item) for item in items}


def release_documents(items: Iterable[Object]) -> dict[str, dict[str, Any]]:
    """The items of Applications, by the key of their release."""
    return {release_key(item): release_document(item) for item in items}
