"""Rollouts: whether a Deployment, a StatefulSet or a Job is what it shall be, and why not, as their own statuses say
it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from robotkube.registry.suites.core.pod_descriptions import deployment_ready, describe_deployment

DEPLOYMENT, STATEFUL_SET, JOB = "Deployment", "StatefulSet", "Job"
HOOK = "helm.sh/hook"
INSTALLING = ("install", "upgrade")  # how the names of hooks end that are part of it
ON_DELETE = "OnDelete"

Object = Mapping[str, Any]


def is_installed(item: Object) -> bool:
    """Return whether installing waits for it: not for a hook of tests or of the removal."""
    hooks = str((item["metadata"].get("annotations") or {}).get(HOOK, "")).split(",")
    return any(not hook or hook.strip().endswith(INSTALLING) for hook in hooks)


def rolled_out(item: Object) -> bool:
    """Return whether it is what it shall be: its newest pods are there and ready, a Job has succeeded."""
    if item["kind"] == JOB:
        return _condition(item, "Complete") is not None
    return deployment_ready(item) if item["kind"] == DEPLOYMENT else _stateful_set_ready(item)


def describe_rollout(item: Object) -> Iterator[str]:
    """Why it is not rolled out, as far as it says so itself."""
    name = item["metadata"]["name"]
    status = item.get("status") or {}
    if item["kind"] == JOB:
        failed = _condition(item, "Failed")
        why = f"failed: {failed.get('reason')}: {failed.get('message')}" if failed else "has not succeeded yet"
        yield f"Job {name} {why}"
        return
    yield f"{item['kind']} {name}: {status.get('readyReplicas') or 0} of {_wanted(item)} pods are ready"
    if item["kind"] == DEPLOYMENT:
        yield from describe_deployment(item, name)


def _stateful_set_ready(item: Object) -> bool:
    spec, status = item.get("spec") or {}, item.get("status") or {}
    current = status.get("observedGeneration", 0) >= item["metadata"].get("generation", 0)
    newest = status.get("currentRevision") == status.get("updateRevision")
    by_hand = (spec.get("updateStrategy") or {}).get("type") == ON_DELETE
    return bool(current and (newest or by_hand) and (status.get("readyReplicas") or 0) >= _wanted(item))


def _wanted(item: Object) -> int:
    return int((item.get("spec") or {}).get("replicas", 1))


def _condition(item: Object, kind: str) -> Object | None:
    """A condition that is true."""
    conditions = (item.get("status") or {}).get("conditions") or ()
    return next(
        (condition for condition in conditions if condition.get("type") == kind and condition.get("status") == "True"),
        None,
    )
