"""The documents of items, out of objects of the API server and pages of managers and detectors.

Their form is docs/reference/console-api.yaml. Whatever an object leaves out is an empty text, an empty list or null:
a page need not ask whether a key is there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from robotkube.delivery.console.core.moments import ns_ms, text_ms
from robotkube.delivery.tasks.core.task_description import PRIORITY_DEFAULT
from robotkube.delivery.tasks.core.task_states import asked_for, task_state
from robotkube.foundation.kubernetes.core.annotations import AGENTS_ANNOTATION
from robotkube.foundation.kubernetes.core.objects import is_withdrawn, object_key
from robotkube.robots.rules.core.event_documents import is_edge

OPEN, MERGED, OBSERVED, REFUSED = "open", "merged", "observed", "refused"
START = "start"
RECORDS = "records"
MS_OF_SECOND = 1000
CERTIFICATE_TIMES = {"from_ms": "begin", "until_ms": "end", "renewal_ms": "renewal"}
PLAN_TIMES = ("demand_seen", "started", "proposed", "merged", "synced", "observed")

Object = Mapping[str, Any]
Documents = dict[str, dict[str, Any]]


def task_document(task: Object) -> dict[str, Any]:
    """The item of a TaskDescription."""
    metadata = task.get("metadata") or {}
    spec, status = task.get("spec") or {}, task.get("status") or {}
    request = status.get("pullRequest") or {}
    return {
        "namespace": str(metadata.get("namespace", "")),
        "name": str(metadata.get("name", "")),
        "application": asked_for(spec),
        "requester": str(spec.get("requester") or ""),
        "reason": str(spec.get("reason") or ""),
        "priority": spec.get("priority", PRIORITY_DEFAULT),
        "state": task_state(task),
        "conditions": [_condition(one) for one in status.get("conditions") or ()],
        "event": _event_named(spec.get("event") or {}),
        "agents": str((metadata.get("annotations") or {}).get(AGENTS_ANNOTATION, "")).replace(",", " ").split(),
        "parameters": spec.get("parameters") or {},
        "plan": str(status.get("plan") or ""),
        "pull_request": {"number": request["number"], "url": str(request.get("url") or "")} if request else None,
        "commit": str(status.get("commit") or ""),
        "releases": list(status.get("releases") or ()),
        "created_ms": text_ms(metadata.get("creationTimestamp")),
        "withdrawn": is_withdrawn(task),
    }


def _condition(one: Object) -> dict[str, Any]:
    words = {key: str(one.get(key) or "") for key in ("type", "status", "reason", "message")}
    return {**words, "time_ms": text_ms(one.get("lastTransitionTime"))}


def _event_named(event: Object) -> dict[str, Any]:
    words = {key: str(event.get(key) or "") for key in ("id", "rule", "trace")}
    return {**words, "time_ms": text_ms(event.get("time")), "stamp_ms": text_ms(event.get("stamp"))}


def plan_document(plan: Object, manager: str) -> dict[str, Any]:
    """The item of an entry of a manager's /plans."""
    lists = {key: list(plan.get(key) or ()) for key in ("tasks", "events", "traces", "created", "changed", "removed")}
    return {
        "plan": str(plan["plan"]),
        "manager": manager,
        "subject": str(plan.get("subject") or ""),
        "cause": str(plan.get("cause") or ""),
        "state": plan_state(plan),
        **lists,
        "pull_request": plan.get("pull_request"),
        "url": str(plan.get("url") or ""),
        "commit": str(plan.get("commit") or ""),
        "error": str(plan.get("error") or ""),
        "waits": str(plan.get("waits") or ""),
        "differences": plan.get("differences"),
        "choices": list(plan.get("choices") or ()),
        "decision": None,
        **{f"{name}_ms": ns_ms(plan.get(name)) for name in PLAN_TIMES},
    }


def plan_state(plan: Object) -> str:
    """How far a plan came."""
    if plan.get("observed"):
        return OBSERVED
    if plan.get("on_main"):
        return MERGED
    return REFUSED if plan.get("error") else OPEN


def plan_documents(page: Object, manager: str) -> Documents:
    """The items of a manager's page /plans."""
    return {str(plan["plan"]): plan_document(plan, manager) for plan in page["plans"]}


def decision_documents(page: Object) -> dict[int, dict[str, Any]]:
    """What the gate decided, by the number of the pull request, of its page /decisions."""
    return {int(decision["pull_request"]): _decision(decision) for decision in page["decisions"]}


def _decision(decision: Object) -> dict[str, Any]:
    decided_ms = ns_ms(decision["decided"])
    return {
        "verdict": str(decision["verdict"]),
        "way": str(decision["way"]),
        "approvers": [str(name) for name in decision["approvers"]],
        "began_ms": None if decided_ms is None else decided_ms - round(decision["seconds"] * MS_OF_SECOND),
        "decided_ms": decided_ms,
        "checks": [_check(check) for check in decision["checks"]],
    }


def _check(check: Object) -> dict[str, Any]:
    return {
        "check": str(check["check"]),
        "problems": [str(problem) for problem in check["problems"]],
        "took_ms": round(check["seconds"] * MS_OF_SECOND, 1),
    }


def event_documents(page: Object, detector: str) -> Documents:
    """The items of a detector's page /events: both edges of an event make one. What is no edge is left out."""
    documents: Documents = {}
    for edge in page.get("events") or ():
        if not is_edge(edge):
            continue
        if edge["edge"] == START:
            documents[edge["id"]] = _event(edge, detector)
        else:
            began = documents.setdefault(edge["id"], {**_event(edge, detector), "began_ms": None})
            began["ended_ms"] = ns_ms(edge["time"])
            began["error"] = began["error"] or str(edge.get("error") or "")
    return documents


def _event(edge: Object, detector: str) -> dict[str, Any]:
    return {
        "id": edge["id"],
        "rule": edge["rule"],
        "agents": list(edge.get("agents") or ()),
        "began_ms": ns_ms(edge["time"]),
        "ended_ms": None,
        "stamp_ms": ns_ms(edge["stamp"]),
        "trace": str(edge.get("trace") or ""),
        "distance_m": edge.get("distance_m"),
        "detail": dict(edge.get("detail") or {}),
        "causes": [_cause(cause) for cause in edge.get("causes") or ()],
        "task": str(edge.get("task") or ""),
        "detector": detector,
        "error": str(edge.get("error") or ""),
    }


def _cause(cause: Object) -> dict[str, Any]:
    return {"topic": str(cause["topic"]), "stamp_ms": ns_ms(cause["stamp"]), "values": dict(cause["values"])}


def event_of_task(task: Object) -> dict[str, Any]:
    """The item of the event that a task's item names, until its detector's page was read."""
    event = task["event"]
    return {
        "id": event["id"],
        "rule": event["rule"],
        "agents": list(task["agents"]),
        "began_ms": event["time_ms"],
        "ended_ms": None,
        "stamp_ms": event["stamp_ms"],
        "trace": event["trace"],
        "distance_m": None,
        "detail": {},
        "causes": [],
        "task": f"{task['namespace']}/{task['name']}",
        "detector": "",
        "error": "",
    }


def rule_documents(settings: Object, detector: str) -> Documents:
    """The items of the rules in a detector's settings: what a map can show of them, and the rest in a word."""
    rules = settings.get("rules")
    return {
        f"{detector}/{rule['name']}": {
            "name": str(rule["name"]),
            "kind": str(rule.get("kind") or ""),
            "detector": detector,
            "text": _rule_text(rule),
            "start_distance_m": rule.get("start_distance_m"),
            "stop_distance_m": rule.get("stop_distance_m"),
            "areas": _areas(rule.get("area")),
        }
        for rule in (rules if isinstance(rules, Sequence) else ())
        if isinstance(rule, Mapping) and rule.get("name")
    }


def _rule_text(rule: Object) -> str:
    if rule.get("kind") == "proximity":
        return f"nearer than {rule.get('start_distance_m')} m, until farther than {rule.get('stop_distance_m')} m"
    shown = {key: value for key, value in rule.items() if key not in ("name", "kind", "area", "topic")}
    return ", ".join(f"{key} {value}" for key, value in shown.items() if isinstance(value, str | int | float))


def _areas(area: Any) -> Sequence[Any]:
    """The polygons of a rule's area; none where it is not of the form that the detector takes."""
    coordinates = area.get("coordinates") if isinstance(area, Mapping) else None
    if not isinstance(coordinates, Sequence) or isinstance(coordinates, str):
        return []
    return list(coordinates) if area.get("type") == "MultiPolygon" else [coordinates]


def catalogue_documents(page: Object, releases: Iterable[Object]) -> Documents:
    """The items of a manager's page /catalogue, with where each chart version runs."""
    running: dict[str, list[str]] = {}
    for release in releases:
        running.setdefault(release["digest"], []).append(release["release"])
    return {key: _entry(entry, running) for key, entry in _entries(page)}


def _entries(page: Object) -> Iterator[tuple[str, Object]]:
    for entry in page["entries"]:
        version = entry.get("version")
        yield "/".join(filter(None, (str(entry["kind"]), str(entry["name"]), str(version or "")))), entry


def _entry(entry: Object, running: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    words = (
        *("kind", "name", "version", "state", "description", "digest", "evidence", "evidence_problem"),
        *("channel", "policy", "replaces"),
    )
    digest = str(entry.get("digest") or "")
    return {
        **{key: str(entry.get(key) or "") for key in words},
        "provides": list(entry.get("provides") or ()),
        "skips": list(entry.get("skips") or ()),
        "findings": [dict(finding) for finding in entry.get("findings") or ()],
        "parameters": entry.get("parameters") or {},
        "releases": sorted(running.get(digest, ())) if digest else [],
    }


def stranger_documents(inspection: Object) -> Documents:
    """The items of what an Inspection names."""
    place = object_key(inspection).partition("/")[2]
    documents = {}
    for one in (inspection.get("status") or {}).get("strangers") or ():
        words = {
            key: str(one.get(key) or "") for key in ("kind", "namespace", "name", "container", "reason", "message")
        }
        key = "/".join((place, *(words[part] for part in ("kind", "namespace", "name", "container", "reason"))))
        documents[key] = {"place": place, **words, "since_ms": text_ms(one.get("since"))}
    return documents


def unchecked_documents(page: Object) -> Documents:
    """The items of the gate's page /unchecked: commits of main that it did not check, and one for what is wrong with
    its records altogether."""
    documents = {str(one["commit"]): _unchecked(one) for one in page["commits"]}
    if page["problem"]:
        documents[RECORDS] = _unchecked({"commit": "", "how": RECORDS, "problem": page["problem"]})
    return documents


def _unchecked(one: Object) -> dict[str, Any]:
    words = {key: str(one.get(key) or "") for key in ("commit", "how", "reason", "problem", "made_good")}
    lists = {key: [str(word) for word in one.get(key) or ()] for key in ("signed_by", "files")}
    return {**words, **lists, "time_ms": text_ms(one.get("time"))}


def certificate_documents(page: Object) -> Documents:
    """The items of the page /accounts of the process certificates: the certificate of each account at the broker."""
    documents = {}
    for account in page["accounts"]:
        life = account["life"] or {}
        times = {name: _seconds_ms(life.get(key)) for name, key in CERTIFICATE_TIMES.items()}
        words = {key: str(account[key]) for key in ("account", "namespace")}
        documents["/".join((words["namespace"], words["account"]))] = {**words, **times}
    return documents


def _seconds_ms(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * MS_OF_SECOND)
