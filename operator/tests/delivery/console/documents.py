"""Objects and pages out of which the console's items are made, as API server, manager and detector have them."""

from __future__ import annotations

from typing import Any

EVENT, TRACE = "3f2a9c", "0123456789abcdef0123456789abcdef"
TASK = "cloud-0/meeting"
PLAN = "20261121-100000-1a2b3c"
COMMIT = "1" * 40
RECORDER, BRIDGE = "cloud-0/recorder", "vehicle-00/mqtt-bridge"
SECOND = 1_000_000_000
BEGAN = 1_795_250_010 * SECOND


def task(state: str = "True", withdrawn: bool = False) -> dict[str, Any]:
    """A task whose releases are ready, or are not."""
    conditions = [
        {"type": kind, "status": "True", "reason": kind, "message": f"{kind}, it is"}
        for kind in ("Accepted", "Committed", "Synced")
    ]
    ready = {"type": "Ready", "status": state, "reason": "Observed", "lastTransitionTime": "2026-11-21T10:00:13Z"}
    metadata: dict[str, Any] = {
        "namespace": "cloud-0",
        "name": "meeting",
        "creationTimestamp": "2026-11-21T10:00:10Z",
        "annotations": {"robotkube.io/agents": "vehicle-00 vehicle-01"},
    }
    if withdrawn:
        metadata["deletionTimestamp"] = "2026-11-21T10:01:00Z"
    return {
        "metadata": metadata,
        "spec": {
            "requester": "cloud-0/event-detector",
            "event": {"rule": "near", "id": EVENT, "trace": TRACE, "time": "2026-11-21T10:00:10.123456Z"},
            "reason": "vehicle-00, vehicle-01 within 400 m",
            "application": "recording",
            "parameters": {"vehicles": ["vehicle-00", "vehicle-01"]},
        },
        "status": {
            "conditions": [*conditions, ready],
            "plan": PLAN,
            "pullRequest": {"number": 12, "url": "http://forge/robotkube/deployment/pulls/12"},
            "commit": COMMIT,
            "releases": [RECORDER, BRIDGE],
        },
    }


def plans(*more: dict[str, Any], **changed: Any) -> dict[str, Any]:
    """A manager's page /plans."""
    plan = {
        "plan": PLAN,
        "subject": "deploy(recording): vehicle-00, vehicle-01 within 400 m",
        "cause": "task",
        "tasks": [TASK],
        "events": [EVENT],
        "traces": [TRACE],
        "commit": COMMIT,
        "pull_request": 12,
        "url": "http://forge/robotkube/deployment/pulls/12",
        "created": [RECORDER],
        "changed": [BRIDGE],
        "removed": [],
        "error": None,
        "waits": None,
        "differences": {"values": [{"release": BRIDGE, "path": "version", "before": '"1"', "after": '"2"'}], "more": 0},
        "choices": [{"task": TASK, "choice": "recorder 0.2.3 on cloud-0: it is the recording agent"}],
        "on_main": True,
        "demand_seen": BEGAN,
        "started": BEGAN,
        "proposed": BEGAN + SECOND,
        "merged": BEGAN + 2 * SECOND,
        "synced": BEGAN + 3 * SECOND,
        "observed": BEGAN + 4 * SECOND,
    }
    return {"started": BEGAN, "plans": [{**plan, **changed}, *more]}


def decisions(verdict: str = "accepted", way: str = "automatic", **problems: str) -> dict[str, Any]:
    """The gate's page /decisions, with a check of values and one of images, and their problem by name."""
    checks = [
        {"check": name, "problems": [problems[name]] if name in problems else [], "seconds": seconds}
        for name, seconds in (("values", 0.0031), ("images", 0.0))
    ]
    decision = {"pull_request": 12, "author": "manager", "commit": COMMIT, "verdict": verdict, "way": way}
    return {
        "decisions": [
            {**decision, "approvers": [], "decided": BEGAN + 2 * SECOND, "seconds": 0.25, "checks": checks},
        ]
    }


def unchecked(**changed: Any) -> dict[str, Any]:
    """The gate's page /unchecked, with a break-glass commit that stands."""
    commit = {
        "commit": "2" * 40,
        "how": "break-glass",
        "reason": "the gate is away",
        "time": "2026-11-21T10:00:10Z",
        "signed_by": ["ada", "grace"],
        "problem": "",
        "files": ["releases/vehicle-00/mqtt-bridge.yaml"],
        "made_good": "",
    }
    return {"tip": COMMIT, "problem": "", "commits": [{**commit, **changed}]}


def accounts(**life: Any) -> dict[str, Any]:
    """The page /accounts of the process certificates: an account with a certificate, and one without."""
    times = {"begin": 1_795_250_000.0, "end": 1_803_026_000.0, "renewal": 1_800_434_000.5, **life}
    return {
        "problem": "",
        "accounts": [
            {"account": "vehicle-00", "namespace": "vehicle-00", "life": times},
            {"account": "observer", "namespace": "robotkube", "life": None},
        ],
    }


def withdrawal() -> dict[str, Any]:
    """The plan that takes the recorder away."""
    [plan] = plans()["plans"]
    return {**plan, "plan": "20261121-100100-1a2b3c", "cause": "withdrawal", "created": [], "changed": [BRIDGE],
            "removed": [RECORDER], "started": BEGAN + 60 * SECOND, "commit": "2" * 40}  # fmt: skip


def edges(*names: str) -> dict[str, Any]:
    """A detector's page /events with these edges of one event."""
    cause = {"topic": "/vehicles/vehicle_00/pose", "stamp": BEGAN, "values": {"pose.position.x": 1.0}}
    common = {
        "id": EVENT,
        "rule": "near",
        "agents": ["vehicle-00", "vehicle-01"],
        "trace": TRACE,
        "distance_m": 399.8,
        "detail": {"distance_m": 399.8},
        "causes": [cause],
        "task": TASK,
        "error": None,
    }
    times = {"start": BEGAN, "stop": BEGAN + 50 * SECOND}
    return {"events": [{**common, "edge": name, "time": times[name], "stamp": times[name]} for name in names]}


def recordings(*ended: int | None) -> dict[str, Any]:
    """A detector's page /recordings: one for each time of an end, None for one that is at work."""
    gap = {"where": "mqtt-bridge", "why": "outbox full", "count": 3, "first": BEGAN, "last": BEGAN + SECOND}
    counts = {"received": 100, "stored": 97, "early": 0, "duplicates": 0, "dropped": 1, "unsettled": 0}
    audit = {"topic": "/vehicles/vehicle_00/pose", "window": [BEGAN - SECOND, BEGAN + SECOND], **counts, "gaps": [gap]}
    silent = {"topic": "/cloud", "window": None, **dict.fromkeys(counts, 0), "gaps": []}
    cause = {"event": EVENT, "rule": "near", "agents": ["vehicle-00"], "trace": TRACE, "started": BEGAN}
    return {
        "recordings": [
            {
                "recording": f"encounter-{number}",
                "rule": "near",
                "provenance": {"task": TASK, "event": EVENT},
                "volume": "cloud-0/recordings",
                "began": BEGAN + number,
                "ended": end,
                "causes": [{**cause, "stopped": end}],
                "topics": [audit, silent],
            }
            for number, end in enumerate(ended)
        ]
    }


def application(release: str = RECORDER, digest: str = "sha256:" + "a" * 64, health: str = "Healthy") -> dict[str, Any]:
    """An Argo CD Application."""
    namespace, _, name = release.partition("/")
    source = {"repoURL": "oci://forge/verified/event-detector", "targetRevision": digest, "helm": {"releaseName": name}}
    return {
        "metadata": {"name": f"{namespace}-{name}", "annotations": {"robotkube.io/plan": PLAN}},
        "spec": {"destination": {"namespace": namespace}, "source": source},
        "status": {"sync": {"status": "Synced"}, "health": {"status": health}},
    }


def pod(ready: bool = True, **status: Any) -> dict[str, Any]:
    """A pod of the recorder."""
    container = {"name": "main", "ready": ready, "restartCount": 0, "state": {"running": {"startedAt": TIME}}}
    condition = {"type": "ContainersReady", "status": str(ready), "lastTransitionTime": "2026-11-21T10:00:12Z"}
    labels = {"app.kubernetes.io/instance": "recorder", "app.kubernetes.io/name": "event-detector"}
    environment = [{"name": "ROBOTKUBE_CONFIGMAP", "value": "cloud-0/recorder"}]
    return {
        "metadata": {"namespace": "cloud-0", "name": "recorder-0", "labels": labels},
        "spec": {"nodeName": "cloud-0", "containers": [{"name": "main", "env": environment}]},
        "status": {
            "phase": "Running",
            "podIP": "10.0.0.7",
            "startTime": TIME,
            "conditions": [condition],
            "containerStatuses": [container],
            **status,
        },
    }


TIME = "2026-11-21T10:00:11Z"
CATALOGUE = {
    "entries": [
        {"kind": "application", "name": "recording", "description": "Records.", "provides": ["recording/pose"]},
        {
            "kind": "chart",
            "name": "event-detector",
            "version": "0.2.3",
            "state": "verified",
            "digest": "sha256:" + "a" * 64,
            "channel": "stable",
            "replaces": "0.2.2",
            "skips": ["0.2.1"],
            "findings": [{"suite": "static", "result": "PASSED", "passed": 3, "failed": [], "signed_by": "9f3c"}],
        },
    ]
}
RULES = {
    "rules": [
        {"name": "near", "kind": "proximity", "start_distance_m": 400, "stop_distance_m": 600},
        {
            "name": "yard",
            "kind": "geofence",
            "area": {"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1], [0, 0]]]},
        },
    ]
}
