"""A synthetic fleet as the console's documents have it: everything follows from the number of a version, four of which
pass in a second, so that every reader and every resumed stream sees the same.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from typing import Any

from tests.stages.console.documents import (
    CHECKS,
    NOT_READY,
    PARAMETERS,
    RULE,
    SOURCES,
    certificates,
    decision,
    differences,
    findings,
    recording,
    unchecked,
)

Document = dict[str, Any]
ChainRow = tuple[str, str | None, str, str, str, int, int | None, str]
"""Step, kind, id, title, text, time, end and link of one step of a chain."""
VERSIONS_PER_SECOND = 4
STEP_MS = 1000 // VERSIONS_PER_SECOND
START_M, STOP_M = 400.0, 500.0
REASON = f"within {START_M:.0f} m"
CHARTS = ("mqtt-bridge", "object-detection", "object-tracking", "event-detector", "recorder")
HEX = "0123456789abcdef"
SHARING = slice(10, 13)  # of the vehicles: these share the Node of the first of them


@dataclass
class Fleet:
    """A fleet: `agents` vehicles and a cloud; `releases` in all; `away`: names of sources that do not answer."""

    agents: int
    releases: int = 60
    away: frozenset[str] = frozenset()
    names: list[str] = field(init=False)

    def __post_init__(self) -> None:
        self.names = [f"vehicle-{number:0{len(str(self.agents - 1))}d}" for number in range(self.agents)]
        self.extent = 300.0 * math.sqrt(self.agents)

    def pose(self, number: int, now_ms: int) -> Document:
        """Where a vehicle is: on a round course of its own, one of twenty silent since a while."""
        draw = random.Random(number)  # noqa: S311
        pair = random.Random(f"pair {number // 2}")  # noqa: S311
        silent = number % 20 == 7
        at_ms = 60_000 * (now_ms // 600_000) * 10 - 45_000 if silent else now_ms - number % 250
        radius = draw.uniform(60, 260)
        speed = draw.uniform(6, 14) * draw.choice((-1, 1))
        turn = draw.uniform(0, math.tau) + speed / radius * (at_ms / 1000 % 100_000)
        x = pair.uniform(-1, 1) * self.extent / 2 + draw.uniform(-60, 60) + radius * math.cos(turn)
        y = pair.uniform(-1, 1) * self.extent / 3 + draw.uniform(-60, 60) + radius * math.sin(turn)
        heading = math.remainder(turn + math.copysign(math.pi / 2, speed), math.tau)
        return {"x": x, "y": y, "z": 0.0, "heading": heading, "stamp_ms": at_ms - 12, "received_ms": at_ms}

    def poses(self, version: int, every: bool = False) -> Document:
        """The poses that come with a version: each agent's with every second one."""
        now_ms = version * STEP_MS
        chosen = (number for number in range(self.agents) if every or number % 2 == version % 2)
        return {self.names[number]: self.pose(number, now_ms) for number in chosen}

    def snapshot(self, version: int) -> Document:
        """The whole table."""
        now_ms = version * STEP_MS
        items = {
            "agents": self.agent_documents(now_ms),
            "poses": self.poses(version, every=True),
            "events": self.events(now_ms),
            "tasks": self.tasks(now_ms),
            "plans": self.plans(now_ms),
            "releases": self.release_documents(),
            "pods": self.pods(now_ms),
            "rules": RULES,
            "catalogue": self.catalogue(),
            "strangers": STRANGERS(now_ms),
            "unchecked": unchecked(now_ms),
            "certificates": certificates(self.names, now_ms),
            "links": self.links(now_ms),
            "recordings": self.recordings(now_ms),
            "sources": self.sources(now_ms),
        }
        links = {"forge": "http://forge.example.com", "argocd": "http://argocd.example.com"}
        return {
            "id": f"paper.{version}",
            "epoch": "paper",
            "version": version,
            "time_ms": now_ms,
            "items": items,
            "links": links,
        }

    def change(self, after: int, version: int) -> Document:
        """What changed between two versions."""
        news: Document = {"poses": {}}
        now_ms = version * STEP_MS
        for each in range(max(after + 1, version - 8), version + 1):
            news["poses"] |= self.poses(each)
        before, now = self.events(after * STEP_MS), self.events(version * STEP_MS)
        if version % (10 * VERSIONS_PER_SECOND) == 0:
            news |= {"tasks": self.tasks(now_ms), "plans": self.plans(now_ms), "recordings": self.recordings(now_ms)}
        news["events"] = {key: event for key, event in now.items() if before.get(key) != event}
        gone = {"events": sorted(before.keys() - now.keys())}
        return {"id": f"paper.{version}", "version": version, "time_ms": version * STEP_MS, "set": news, "gone": gone}

    def agent_documents(self, now_ms: int) -> Document:
        agents = {name: self.agent(number, name, now_ms) for number, name in enumerate(self.names)}
        cloud = {"name": "cloud-0", "ready": True, "cordoned": False, "since_ms": now_ms - 9_000_000, "shared_with": []}
        return agents | {
            "cloud-0": AGENT | {"name": "cloud-0", "namespace": "cloud-0", "role": "cloud", "nodes": [cloud]}
        }

    def agent(self, number: int, name: str, now_ms: int) -> Document:
        ready = number % 20 != 7
        shared = self.names[SHARING] if name in self.names[SHARING] else [name]
        node = {"name": shared[0], "ready": ready, "cordoned": number % 9 == 4, "since_ms": now_ms - 45_000}
        node["shared_with"] = [other for other in shared if other != name]
        hold = {"reason": "driving", "until_ms": now_ms + 600_000} if number % 6 == 1 else None
        since = None if ready else now_ms // 600_000 * 600_000 - 45_000
        more = {"nodes": [node], "ready": ready, "hold": hold, "silent_since_ms": since}
        return AGENT | {"name": name, "namespace": name} | more

    def events(self, now_ms: int) -> Document:
        """Pairs of vehicles meet for 40 s of each minute, and what is over is remembered for five minutes."""
        events: Document = {}
        for pair in range(max(1, self.agents // 8)):
            for minute in range(now_ms // 60_000 - 5, now_ms // 60_000 + 1):
                began = minute * 60_000 + pair * 977 % 15_000
                if began <= now_ms:
                    event = self.event(pair, minute, began, now_ms)
                    events[event["id"]] = event
        return events

    def event(self, pair: int, minute: int, began: int, now_ms: int) -> Document:
        one, other = self.names[2 * pair % self.agents], self.names[(2 * pair + 1) % self.agents]
        identity = hex_word(f"event {pair} {minute}", 6)
        cause = {"topic": f"/vehicles/{one.replace('-', '_')}/pose", "stamp_ms": began - 13, "values": {"x": 1.0}}
        return {
            "id": identity,
            "rule": RULE,
            "agents": [one, other],
            "began_ms": began,
            "ended_ms": began + 40_000 if began + 40_000 < now_ms else None,
            "stamp_ms": began - 13,
            "trace": hex_word(identity, 32),
            "distance_m": 399.8,
            "detail": {"distance_m": 399.8},
            "causes": [cause],
            "task": f"cloud-0/recording-{identity}",
            "detector": "cloud-0/event-detector-0",
            "error": "",
        }

    def tasks(self, now_ms: int) -> Document:
        tasks: Document = {}
        states = (
            "Ready",
            "Ready",
            "Accepted (Progressing)",
            "Refused (NoCapableNode)",
            "Withdrawn",
            "Waiting (Conflict)",
        )
        for number, event in enumerate(self.events(now_ms).values()):
            task = task_document(event, states[number % len(states)])
            tasks[event["task"]] = task
        return tasks

    def plans(self, now_ms: int) -> Document:
        states = ("observed", "observed", "merged", "refused", "open")
        return {
            plan["plan"]: plan
            for plan in (
                plan_document(event, states[number % len(states)])
                for number, event in enumerate(self.events(now_ms).values())
            )
        }

    def release_documents(self) -> Document:
        names = [*self.names, "cloud-0"]
        releases: Document = {}
        for number in range(self.releases):
            agent, chart = names[number % len(names)], CHARTS[number // len(names) % len(CHARTS)]
            key = f"{agent}/{chart}" if number < len(names) * len(CHARTS) else f"{agent}/{chart}-{number}"
            releases[key] = {
                "release": key.partition("/")[2],
                "agent": agent,
                "application": key.replace("/", "-"),
                "chart": f"{chart} 0.{number % 3}.1",
                "digest": f"sha256:{hex_word(chart, 64)}",
                "plan": "20261126-100000-1a2b3c",
                "sync": "Synced" if number % 11 else "OutOfSync",
                "health": ("Degraded" if number % 37 == 5 else "Healthy") if number % 11 else "Progressing",
                "messages": [],
                "demands": [] if number % 2 else ["cloud-0/recording-3f2a9c"],
            }
        return releases

    def pods(self, now_ms: int) -> Document:
        pods: Document = {}
        for key, release in self.release_documents().items():
            bad = release["health"] == "Degraded"
            pods[f"{key}-5d9f"] = {
                "namespace": release["agent"],
                "name": f"{release['release']}-5d9f",
                "release": release["release"],
                "agent": release["agent"],
                "node": release["agent"],
                "phase": "Pending" if bad else "Running",
                "ready": not bad,
                "restarts": 3 if bad else 0,
                "trouble": "CrashLoopBackOff: exit code 1, 12 s ago" if bad else "",
                "started_ms": now_ms - 3_000_000,
                "ready_ms": None if bad else now_ms - 2_990_000,
                "deleting": False,
            }
        return pods

    def catalogue(self) -> Document:
        entries: Document = {}
        for number, chart in enumerate(CHARTS):
            for version in ("0.0.1", "0.1.1", "0.2.1"):
                bad = chart == "object-tracking" and version == "0.1.1"
                entries[f"chart/{chart}/{version}"] = {
                    "kind": "chart",
                    "name": chart,
                    "version": version,
                    "state": "verified",
                    "description": f"What {chart.replace('-', ' ')} does, in a sentence that is a little longer.",
                    "provides": [chart.split("-")[-1]],
                    "digest": f"sha256:{hex_word(chart + version, 64)}",
                    "evidence": f"sha256:{hex_word('evidence' + chart + version, 64)}",
                    "evidence_problem": "no trusted key signed it" if bad else "",
                    "channel": "stable",
                    "policy": f"sha256:{hex_word('policy', 64)}",
                    "replaces": {"0.2.1": "0.1.1", "0.1.1": "0.0.1"}.get(version, ""),
                    "skips": ["0.0.1"] if version == "0.2.1" else [],
                    "findings": findings(bad),
                    "parameters": {},
                    "releases": [f"{name}/{chart}" for name in self.names[: 4 * number]] if version == "0.2.1" else [],
                }
        application = {"kind": "application", "name": "pose-point-cloud-recording", "version": "", "state": "verified"}
        more = {"description": "Poses into the database, point clouds into segments.", "provides": ["recording"]}
        more["parameters"] = PARAMETERS
        entries["application/pose-point-cloud-recording"] = (
            application
            | more
            | {"digest": "", "evidence": "", "evidence_problem": "", "releases": []}
            | {"channel": "", "policy": "", "replaces": "", "skips": [], "findings": []}
        )
        return entries

    def links(self, now_ms: int) -> Document:
        """Each bridge carries poses and clouds, one of twenty nothing since a while, and of one nothing is known."""
        links: Document = {}
        for number, name in enumerate(self.names):
            silent = number % 20 == 7
            for topic, rate in (("pose", 100.0), ("lidar_center/pointcloud", 10.0)):
                link = {"release": f"{name}/mqtt-bridge", "agent": name, "direction": "out", "latency_ms": None}
                link |= {"topic": f"/vehicles/{name.replace('-', '_')}/{topic}", "matched": 1, "problem": ""}
                since = now_ms // 600_000 * 600_000 - 45_000
                known = {"rate_hz": 0.0 if silent else rate, "silent_since_ms": since if silent else None}
                unknown = {"rate_hz": None, "silent_since_ms": None, "matched": None, "problem": NOT_READY}
                state = unknown if number % 9 == 4 else known
                over = {"over_seconds": None if state is unknown else 5}
                links[f"{name}/mqtt-bridge/out{link['topic']}"] = link | state | over
        return links

    def recordings(self, now_ms: int) -> Document:
        """One recording for each event; every third has gaps."""
        events = list(self.events(now_ms).values())[-12:]
        return {f"cloud-0/{r['recording']}": r for r in (recording(*each) for each in enumerate(events))}

    def sources(self, now_ms: int) -> Document:
        sources: Document = {}
        for name, carries in SOURCES.items():
            ok = name not in self.away
            sources[name] = {
                "name": name,
                "ok": ok,
                "problem": "" if ok else f"{name} cannot be reached: connection refused.",
                "advice": "" if ok else f"Look at the pod of component {name}.",
                "since_ms": now_ms - 3_600_000 if ok else now_ms - 95_000,
                "carries": carries,
            }
        return sources

    def chain(self, kind: str, identity: str, now_ms: int) -> Document | None:
        """What belongs to an event of the fleet; of everything else that of its newest one."""
        events = self.events(now_ms)
        event = next(
            (each for each in events.values() if kind in ("release", "pod") or identity.endswith(each["id"][-6:])), None
        )
        if event is None:
            return None
        return {
            "kind": kind,
            "id": identity,
            "title": f"{', '.join(event['agents'])} {REASON}",
            "time_ms": now_ms,
            "steps": steps(event, kind, identity),
        }


AGENT: Document = {
    "role": "vehicle",
    "records": False,
    "capabilities": ["lidar"],
    "ready": True,
    "silent_since_ms": None,
    "hold": None,
}
RULES: Document = {
    "cloud-0/event-detector/lidar-proximity": {
        "name": RULE,
        "kind": "proximity",
        "detector": "cloud-0/event-detector",
        "text": "two agents nearer than 400 m, until they are 500 m apart",
        "start_distance_m": START_M,
        "stop_distance_m": STOP_M,
        "areas": [],
    },
    "cloud-0/event-detector/yard": {
        "name": "yard",
        "kind": "geofence",
        "detector": "cloud-0/event-detector",
        "text": "an agent is in the yard",
        "start_distance_m": None,
        "stop_distance_m": None,
        "areas": [[[[-250, -120], [-40, -160], [30, 60], [-180, 130]]]],
    },
}


def STRANGERS(now_ms: int) -> Document:  # noqa: N802
    stranger = {
        "place": "vehicle-03",
        "kind": "Pod",
        "namespace": "vehicle-03",
        "name": "miner",
        "container": "main",
        "reason": "UnknownImage",
        "message": "image docker.example.com/miner is of no chart of the catalogue and of no release",
        "since_ms": now_ms // 600_000 * 600_000 - 240_000,
    }
    return {"vehicle-03/Pod/vehicle-03/miner/main/UnknownImage": stranger}


def hex_word(seed: str, length: int) -> str:
    return "".join(random.Random(seed).choices(HEX, k=length))  # noqa: S311


def task_document(event: Document, state: str) -> Document:
    refused = state.startswith("Refused")
    ready = state in ("Ready", "Withdrawn")
    accepted = {
        "type": "Accepted",
        "status": "False" if refused else "True",
        "reason": "NoCapableNode" if refused else "Accepted",
    }
    message = "no agent that records has 2 CPUs free: cloud-0 has 0.4" if refused else "recorder on cloud-0"
    conditions = [accepted | {"message": message, "time_ms": event["began_ms"] + 60}]
    if not refused:
        waits = "waits until vehicle-01 ends its hold (driving)" if not ready else "all releases run"
        status = "True" if ready else "Unknown"
        conditions.append(
            {"type": "Ready", "status": status, "reason": "Held", "message": waits, "time_ms": event["began_ms"] + 2900}
        )
    return {
        "namespace": "cloud-0",
        "name": event["task"].partition("/")[2],
        "application": "pose-point-cloud-recording",
        "requester": "cloud-0/event-detector",
        "reason": f"{', '.join(event['agents'])} {REASON}",
        "priority": 100,
        "state": state,
        "conditions": conditions,
        "event": {key: event[key] for key in ("id", "rule", "trace", "stamp_ms")} | {"time_ms": event["began_ms"]},
        "agents": event["agents"],
        "parameters": {"vehicles": event["agents"]},
        "plan": "" if refused else f"20261126-100000-{event['id']}",
        "pull_request": None if refused else {"number": 12, "url": "http://forge.example.com/pulls/12"},
        "commit": "" if refused else hex_word(event["id"], 40),
        "releases": [] if refused else [f"cloud-0/recorder-{event['agents'][0]}"],
        "created_ms": event["began_ms"] + 17,
        "withdrawn": state == "Withdrawn",
    }


def plan_document(event: Document, state: str) -> Document:
    began = event["began_ms"]
    merged = state in ("merged", "observed")
    error = "trailer Plan-Digest does not match: the commit changes a file that the plan does not name"
    return {
        "plan": f"20261126-100000-{event['id']}",
        "manager": "manager",
        "subject": f"deploy(recording): {', '.join(event['agents'])} {REASON}",
        "cause": "task",
        "state": state,
        "tasks": [event["task"]],
        "events": [event["id"]],
        "traces": [event["trace"]],
        "created": [f"cloud-0/recorder-{event['agents'][0]}"],
        "changed": [f"{name}/mqtt-bridge" for name in event["agents"]],
        "removed": [],
        "pull_request": 12,
        "url": "http://forge.example.com/pulls/12",
        "commit": hex_word(event["id"], 40) if merged else "",
        "error": error if state == "refused" else "",
        "waits": "pull request 12: the person who approves vehicles has not yet" if state == "open" else "",
        "differences": None if event["began_ms"] % 3 == 2 else differences(event["agents"]),
        "choices": [
            {"task": "cloud-0/recording-3f2a9c", "choice": "recorder on cloud-0: it is the agent that records"}
        ],
        "decision": decision(began, state, error),
        "demand_seen_ms": began + 20,
        "started_ms": began + 27,
        "proposed_ms": began + 480,
        "merged_ms": began + 880 if merged else None,
        "synced_ms": began + 1700 if merged else None,
        "observed_ms": began + 2900 if state == "observed" else None,
    }


def steps(event: Document, kind: str, identity: str) -> list[Document]:
    """A chain from the triggering message to the removal, with the thing that was asked for in it."""
    release = identity if kind == "release" else f"cloud-0/recorder-{event['agents'][0]}"
    rows = [*_decided(event), *_delivered(event, release), *_ended(event)]
    values = [{"label": "pose.position.x", "value": "1.0"}, {"label": "pose.position.y", "value": "2.0"}]
    checks = [{"label": check, "value": f"holds ({took_ms} ms)"} for check, took_ms in CHECKS.items()]
    details = {"message": values, "plan": values, "checks": checks}
    return [
        {
            "step": step,
            "kind": of,
            "id": key,
            "title": title,
            "text": text,
            "state": "done",
            "time_ms": time,
            "end_ms": end,
            "link": link,
            "details": details.get(step, []),
        }
        for step, of, key, title, text, time, end, link in rows
    ]


def _decided(event: Document) -> list[ChainRow]:
    """The rows from the message to the plan."""
    began = event["began_ms"]
    topic = event["causes"][0]["topic"]
    agents = ", ".join(event["agents"])
    plan = f"20261126-100000-{event['id']}"
    planned = (f"deploy(recording): {agents} {REASON}", "1 release created, 2 changed")
    return [
        ("message", None, topic, topic, "pose.position.x = 1.0, pose.position.y = 2.0", began - 13, None, ""),
        ("event", "event", event["id"], RULE, f"{agents}: distance_m = 399.8", began, None, ""),
        ("task", "task", event["task"], event["task"], "Ready: all releases run", began + 17, began + 2900, ""),
        ("plan", "plan", plan, *planned, began + 27, began + 2900, ""),
    ]


def _delivered(event: Document, release: str) -> list[ChainRow]:
    """The rows from the pull request to the pod."""
    began = event["began_ms"]
    commit = hex_word(event["id"], 40)
    forge = "http://forge.example.com"
    argocd = "http://argocd.example.com"
    merged = ("pull request 12", "merged by the gate")
    checked = ("the gate's checks", f"all {len(CHECKS)} hold")
    signed = (commit[:12], "on main, signed by the gate")
    synced = (release.replace("/", "-"), "Synced Healthy")
    runs = (f"{release}-5d9f", "Running on cloud-0")
    return [
        ("pull request", None, "12", *merged, began + 480, began + 880, f"{forge}/pulls/12"),
        ("checks", None, "12", *checked, began + 590, began + 870, f"{forge}/pulls/12"),
        ("commit", "commit", commit, *signed, began + 880, None, f"{forge}/commit/{commit}"),
        ("Application", "release", release, *synced, began + 940, began + 1700, argocd),
        ("pod", "pod", f"{release}-5d9f", *runs, began + 1710, began + 2880, ""),
    ]


def _ended(event: Document) -> list[ChainRow]:
    """The row of the event's end, if it has ended."""
    ended = event["ended_ms"]
    says = ("the event ended", "500 m apart: the task was withdrawn")
    return [("end", None, event["id"], *says, ended, ended + 1400, "")] if ended else []
