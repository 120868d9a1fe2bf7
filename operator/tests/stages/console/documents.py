"""Documents of a synthetic fleet: what a plan changes, what a recording has, and what a manager says of a task."""

from __future__ import annotations

from typing import Any

Document = dict[str, Any]
RULE = "lidar-proximity"
DAY_MS = 86_400_000
NOT_READY = "The bridge's pod is not ready."
NAMES = {"type": "string", "pattern": "^[a-z0-9]([a-z0-9-]*[a-z0-9])?$"}
PARAMETERS: Document = {
    "type": "object",
    "required": ["vehicles"],
    "properties": {
        "vehicles": {
            "description": "agents whose data are recorded",
            "type": "array",
            "items": NAMES,
            "minItems": 1,
            "maxItems": 8,
            "examples": [["vehicle-00", "vehicle-01"]],
        },
        "rate": {"description": "clouds a second", "type": "number", "minimum": 1, "maximum": 20, "default": 10},
        "storage": {"enum": ["document", "segment"]},
    },
}


CHECKS = {
    "it is one commit on main's tip": 0.1,
    "its message names what it changes": 0.2,
    "charts are in the catalogue, and their evidence holds": 0.6,
    "values fit the charts' schemas": 3.1,
    "images are those that the evidence covers": 41.5,
}
"""Checks of the gate in words, and the milliseconds that each takes."""

SOURCES = {
    "api-server-nodes": ["agents"],
    "api-server-tasks": ["tasks"],
    "api-server-pods": ["pods"],
    "api-server-applications": ["releases"],
    "api-server-inspections": ["strangers"],
    "manager/manager": ["plans", "catalogue"],
    "detectors": ["events", "rules", "recordings"],
    "bridges": ["links"],
    "broker": ["poses"],
    "certificates": ["certificates"],
    "gate-pages": ["plans", "unchecked"],
    "gate": ["plans", "catalogue"],
    "forge": ["plans", "catalogue"],
    "argocd-application-controller": ["releases"],
}


def decision(began: int, state: str, error: str) -> Document:
    """What the gate decided of a plan, which fails at its message where it is refused."""
    checks = [{"check": check, "problems": [], "took_ms": took_ms} for check, took_ms in CHECKS.items()]
    if state == "refused":
        checks = [checks[0], {**checks[1], "problems": [error]}]
    verdict = {"refused": "refused", "open": "checked"}.get(state, "accepted")
    way = {"way": "approval" if state == "open" else "automatic", "approvers": []}
    return {"verdict": verdict, **way, "began_ms": began + 590, "decided_ms": began + 870, "checks": checks}


def differences(agents: list[str]) -> Document:
    values = [
        {"release": f"cloud-0/recorder-{agents[0]}", "path": path, "before": None, "after": after}
        for path, after in (("chart", '"event-detector"'), ("version", '"0.2.3"'))
    ]
    for name in agents:
        release = f"{name}/mqtt-bridge"
        path = "bridge.topics[2].name"
        topic = f'"/vehicles/{name.replace("-", "_")}/lidar_center/pointcloud"'
        values.append({"release": release, "path": path, "before": None, "after": topic})
        values.append({"release": release, "path": "bridge.topics[0].depth", "before": "10", "after": "1000"})
    return {"values": values, "more": 3}


def unchecked(now_ms: int) -> Document:
    """Commits past the gate: two that people signed, one of which main accepts, and one that nobody did."""
    signed = {"how": "break-glass", "signed_by": ["ada", "grace"], "problem": ""}
    standing = {
        "reason": "the gate is away: bring the old bridge back",
        "files": ["releases/vehicle-03/mqtt-bridge.yaml"],
    }
    accepted = {"reason": "a lidar's driver crashes", "files": [], "made_good": "accepted"}
    moved = {
        "how": "no-record",
        "reason": "deploy(recording): x",
        "signed_by": [],
        "problem": "",
        "files": ["notes.txt"],
    }
    commits = [
        {**signed, **standing, "time_ms": now_ms - 3_600_000, "made_good": ""},
        {**signed, **accepted, "time_ms": now_ms - 90_000_000},
        {**moved, "time_ms": None, "made_good": ""},
    ]
    return {str(number) * 40: {"commit": str(number) * 40, **commit} for number, commit in enumerate(commits, 1)}


def certificates(names: list[str], now_ms: int) -> Document:
    """The certificates of vehicles: of each nine one is about to end, and one has none that holds."""
    items: Document = {}
    for number, name in enumerate(names):
        begin = now_ms - (80 if number % 9 == 4 else 20) * DAY_MS
        times = {"from_ms": begin, "until_ms": begin + 90 * DAY_MS, "renewal_ms": begin + 60 * DAY_MS}
        known = dict.fromkeys(times) if number % 9 == 5 else times
        items[f"{name}/{name}"] = {"account": name, "namespace": name, **known}
    return items


def findings(bad: bool) -> list[Document]:
    """What suites found of a chart version; of a `bad` one nobody signed the last."""
    passed = {"result": "PASSED", "passed": 12, "failed": [], "signed_by": "9f3c2a10"}
    unsigned = {"result": "none", "passed": 0, "failed": [], "signed_by": ""}
    return [{"suite": "static", **passed}, {"suite": "install", **(unsigned if bad else passed)}]


def recording(number: int, event: Document) -> Document:
    """The recording of an event."""
    began, ended = event["began_ms"], event["ended_ms"]
    counts = {"received": 4_200, "stored": 4_190, "early": 0, "duplicates": 0, "dropped": 10 if number % 3 == 1 else 0}
    topics = [f"/vehicles/{name.replace('-', '_')}/{what}" for name in event["agents"] for what in ("pose", "cloud")]
    gap = {"topic": topics[0], "where": "mqtt-bridge", "why": "outbox full", "count": 10, "first_ms": began + 900}
    gaps = [gap | {"last_ms": began + 1900}] if number % 3 == 1 else []
    window = {"event": event["id"], "agents": event["agents"], "began_ms": began, "ended_ms": ended}
    each = {"first_ms": began - 9_000, "last_ms": ended, "gap_count": 0, **{k: v // 4 for k, v in counts.items()}}
    return {
        "recording": f"encounter-{event['id']}",
        "agent": "cloud-0",
        "rule": RULE,
        "task": "",
        "event": event["id"],
        "detector": "cloud-0/event-detector-0",
        "volume": "cloud-0/recordings",
        "at_work": ended is None,
        "began_ms": began,
        "ended_ms": None if number % 5 == 0 else ended,
        "windows": [window],
        "topics": [{"topic": topic, **each} for topic in topics],
        **counts,
        "gap_count": len(gaps),
        "gaps": gaps,
    }


def explanation(question: Document) -> Document:
    """What a manager would say of a question about a task."""
    if "withdraw" in question:
        lines = [
            f"{question['withdraw']} would be withdrawn",
            "stops cloud-0/recorder-vehicle-00 (event-detector 0.2.3)",
        ]
        change = {"path": "releases/cloud-0/recorder-vehicle-00.yaml", "before": "kind: HelmRelease\n", "after": None}
        said = {
            "outcome": "Withdrawn",
            "reason": "Withdrawn",
            "message": "",
            "releases": ["cloud-0/recorder-vehicle-00"],
        }
        return {"task": question["withdraw"], **said, "waits": "", "lines": lines, "changes": [change]}
    vehicles = question["parameters"].get("vehicles", [])
    key = f"{question['namespace']}/{question['application']}-preview"
    if any(not name.startswith("vehicle-") for name in vehicles):
        message = f"vehicles: {vehicles[0]!r} is no agent; did you mean vehicle-00?"
        refused = {"outcome": "Refused", "reason": "InvalidParameters", "message": message, "releases": []}
        lines = [f"{key} is refused, InvalidParameters: {message}"]
        return {"task": key, **refused, "waits": "", "lines": lines, "changes": []}
    release = f"cloud-0/recorder-{'-'.join(vehicles)}"
    changes = [
        {"path": f"releases/{release}.yaml", "before": None, "after": "kind: HelmRelease\nspec:\n  values: {}\n"},
        {"path": "releases/vehicle-00/mqtt-bridge.yaml", "before": BRIDGE, "after": BRIDGE.replace("10", "1000")},
    ]
    lines = [
        f"{key} is accepted; its releases: {release}",
        "recorder: cloud-0, which records and has 2 CPUs free",
        f"starts {release} (event-detector 0.2.3)",
        "changes vehicle-00/mqtt-bridge (mqtt-bridge 0.2.3)",
    ]
    accepted = {"outcome": "Accepted", "reason": "Accepted", "message": "", "releases": [release]}
    return {"task": key, **accepted, "waits": "vehicle-01 until 10:00 (driving)", "lines": lines, "changes": changes}


BRIDGE = "kind: HelmRelease\nspec:\n  values:\n    bridge:\n      topics:\n      - name: /pose\n        depth: 10\n"
