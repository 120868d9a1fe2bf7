"""The chain of cause and effect that something belongs to: from the messages that were compared to what runs, and back.

`robotkube trace` prints it, the console's page draws it; both are made here, from the same documents (documents.py).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from robotkube.delivery.console.core.documents import MERGED, OBSERVED, REFUSED
from robotkube.delivery.console.core.moments import NS_OF_MS
from robotkube.delivery.deployment.core.policies.merge import CLOSED
from robotkube.delivery.deployment.core.releases import application_name
from robotkube.delivery.tasks.core.task_states import READY
from robotkube.delivery.tasks.core.task_states import REFUSED as TASK_REFUSED
from robotkube.foundation.documents.core.times import second_text

EVENT, TASK, PLAN, POD, RELEASE, COMMIT = "event", "task", "plan", "pod", "release", "commit"
RECORDING = "recording"
WHY_KINDS = (EVENT, TASK, PLAN, POD, RELEASE, COMMIT, RECORDING)
MESSAGE, PULL_REQUEST, APPLICATION, END = "message", "pull request", "Application", "end"
CHECKS = "checks"
FIRST_MESSAGE = "first message"
ACCEPTED, CHECKED, STALE = "accepted", "checked", "stale"
"""The gate's words for what it merged, what may be merged once approved, and what main has overtaken."""
DONE, WAITING, FAILED, GONE = "done", "waiting", "failed", "gone"
COMMIT_CHARACTERS_MIN = 7
MS_OF_S = 1000
WITHDRAWAL = "withdrawal"
SIDES = (("before", "not there"), ("after", "gone"))
NO_TASK = "withdrawn, or another's of the same plan"

Document = Mapping[str, Any]
Documents = Mapping[str, Document]


@dataclass(frozen=True)
class View:
    """The documents that chains are made of, by kind and key."""

    tasks: Documents = field(default_factory=dict)
    plans: Documents = field(default_factory=dict)
    releases: Documents = field(default_factory=dict)
    pods: Documents = field(default_factory=dict)
    events: Documents = field(default_factory=dict)
    recordings: Documents = field(default_factory=dict)


@dataclass(frozen=True)
class Step:
    """One step: what happened (`step`), of what (`id`, `title`), how it stands (`text`, `state`), when it began and was
    through. `kind` with `id` leads to its own chain, None where there is none; `link` is the forge's page."""

    step: str
    id: str
    title: str
    text: str
    state: str = DONE
    kind: str | None = None
    time_ms: int | None = None
    end_ms: int | None = None
    link: str = ""
    details: tuple[tuple[str, str], ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The step as the page reads it."""
        return {**self.__dict__, "details": [{"label": label, "value": value} for label, value in self.details]}


@dataclass
class Matches:
    """Tasks (by key), plans (oldest first), releases, events and recordings (by key) that belong together."""

    tasks: dict[str, Document] = field(default_factory=dict)
    plans: list[Document] = field(default_factory=list)
    releases: list[str] = field(default_factory=list)
    events: dict[str, Document] = field(default_factory=dict)
    recordings: dict[str, Document] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.tasks or self.plans or self.releases or self.events or self.recordings)


def find(wanted: str, view: View) -> Matches:
    """What belongs to `wanted`: the id of an event, a trace, a plan, or a task's key."""
    named = {key: task for key, task in view.tasks.items() if wanted in _names(key, task)}
    events = {key: event for key, event in view.events.items() if wanted in (key, event["trace"], event["task"])}
    keys = {wanted, *named, *(task["plan"] for task in named.values()), *(one["task"] for one in events.values())}
    keys.discard("")
    plans = [plan for plan in view.plans.values() if keys & {plan["plan"], *_causes_of(plan)}]
    ids = {task["event"]["id"] for task in named.values()} | {one for plan in plans for one in plan["events"]}
    events |= {key: view.events[key] for key in ids if key in view.events}
    releases = {key for task in named.values() for key in task["releases"]}
    releases |= {key for plan in plans for word in ("created", "changed") for key in plan[word]}
    matches = Matches(named, sorted(plans, key=_began), sorted(releases), events)
    matches.recordings = _recordings_of(matches, view)
    return matches


def _recordings_of(matches: Matches, view: View) -> dict[str, Document]:
    """The recordings that are for one of the tasks or events."""
    tasks = {*matches.tasks, *(key for plan in matches.plans for key in plan["tasks"])}
    events = {*matches.events, *(task["event"]["id"] for task in matches.tasks.values())}
    events |= {one for plan in matches.plans for one in plan["events"]}
    return {
        key: recording
        for key, recording in view.recordings.items()
        if recording["task"] in tasks or events & _events_of(recording)
    }


def _events_of(recording: Document) -> set[str]:
    return {recording["event"], *(window["event"] for window in recording["windows"])} - {""}


def find_of(kind: str, wanted: str, view: View) -> Matches:
    """What belongs to the item `wanted` of a kind (one of WHY_KINDS); nothing when it is not known."""
    if kind == COMMIT:
        enough = len(wanted) >= COMMIT_CHARACTERS_MIN
        plan = next((p for p in view.plans.values() if enough and p["commit"].startswith(wanted)), None)
        return find(plan["plan"], view) if plan else Matches()
    if kind in (POD, RELEASE):
        release = wanted if kind == RELEASE else str(view.pods.get(wanted, {}).get("release", ""))
        return _of_release(release, view)
    if kind == RECORDING:
        return _of_recording(wanted, view)
    return find(wanted, view)


def _of_release(release: str, view: View) -> Matches:
    document = view.releases.get(release)
    if document is None and not any(pod["release"] == release for pod in view.pods.values()):
        return Matches()
    matches = find(document["plan"], view) if document is not None and document["plan"] else Matches()
    matches.releases = [release]
    return matches


def _of_recording(wanted: str, view: View) -> Matches:
    """What belongs to a recording, by its key or its name alone, and to no other one of the same plan."""
    key = next((key for key in view.recordings if wanted in (key, key.partition("/")[2])), "")
    if not key:
        return Matches()
    recording = view.recordings[key]
    causes = (recording["task"], recording["event"], *sorted(_events_of(recording)))
    matches = next((found for cause in causes if cause and (found := find(cause, view))), Matches())
    matches.recordings = {key: recording}
    return matches


def _names(key: str, task: Document) -> set[str]:
    return {key, task["event"]["id"], task["event"]["trace"], task["plan"]} - {""}


def _causes_of(plan: Document) -> set[str]:
    return {*plan["tasks"], *plan["events"], *plan["traces"]}


def _began(plan: Document) -> tuple[int, str]:
    return plan["started_ms"] or 0, str(plan["plan"])


def steps(matches: Matches, view: View) -> Iterator[Step]:
    """The steps in the order of cause and effect."""
    yield from _events(matches)
    yield from _tasks(matches)
    asking = [plan for plan in matches.plans if plan["cause"] != WITHDRAWAL]
    for plan in asking:
        yield from _plan(plan)
    since_ms = min((plan["started_ms"] for plan in asking if plan["started_ms"] is not None), default=None)
    yield from _running(matches.releases, view, since_ms)
    yield from _recordings(matches)
    for key, event in matches.events.items():
        if event["ended_ms"] is not None:
            yield Step(END, key, "the event ended", event["rule"], DONE, EVENT, event["ended_ms"])
    for plan in matches.plans:
        if plan["cause"] == WITHDRAWAL:
            yield from _plan(plan)


def _events(matches: Matches) -> Iterator[Step]:
    for event in matches.events.values():
        for cause in event["causes"]:
            values = tuple((name, str(value)) for name, value in cause["values"].items())
            words = ", ".join(f"{name} = {value}" for name, value in values) or "it came"
            yield Step(MESSAGE, cause["topic"], cause["topic"], words, DONE, None, cause["stamp_ms"], details=values)
    known = dict.fromkeys(matches.events)
    for key, event in matches.events.items():
        yield _event(key, event, next((t for t in matches.tasks.values() if t["event"]["id"] == key), None))
    for task in matches.tasks.values():
        event = task["event"]
        if event["id"] and event["id"] not in known:
            known[event["id"]] = None
            text = f"{event['rule']}: {task['reason']}"
            yield Step(EVENT, event["id"], event["rule"], text, DONE, EVENT, event["time_ms"])


def _event(key: str, event: Document, task: Document | None) -> Step:
    text = f"{event['rule']}: {task['reason']}" if task else f"{event['rule']}: {', '.join(event['agents'])}"
    details = tuple((name, str(value)) for name, value in event["detail"].items())
    state = FAILED if event["error"] else DONE
    times = (event["began_ms"], event["ended_ms"])
    return Step(EVENT, key, event["rule"], event["error"] or text, state, EVENT, *times, details=details)


def _tasks(matches: Matches) -> Iterator[Step]:
    for key, task in matches.tasks.items():
        conditions = {one["type"]: one for one in task["conditions"]}
        ready = conditions.get(READY, {})
        through = ready.get("time_ms") if ready.get("status") == "True" else None
        details = tuple((one["type"], one["message"] or one["reason"]) for one in task["conditions"])
        yield Step(
            TASK, key, task["name"], task["state"], _task_state(task), TASK, task["created_ms"], through, "", details
        )
    for key in sorted({key for plan in matches.plans for key in plan["tasks"]} - set(matches.tasks)):
        yield Step(TASK, key, key.partition("/")[2], NO_TASK, GONE, TASK)


def _task_state(task: Document) -> str:
    if task["withdrawn"]:
        return GONE
    if task["state"].startswith(TASK_REFUSED):
        return FAILED
    return DONE if task["state"] == READY else WAITING


def _plan(plan: Document) -> Iterator[Step]:
    lists = ("created", "changed", "removed")
    details = tuple((word, release) for word in lists for release in plan[word])
    details = (*_choices(plan), *details, *_values(plan))
    merged = plan["state"] in (MERGED, OBSERVED)
    restored = merged and plan["started_ms"] is None  # read from main after a restart: nobody knows more of it
    state = DONE if restored else {OBSERVED: DONE, REFUSED: FAILED}.get(plan["state"], WAITING)
    yield Step(
        PLAN, plan["plan"], plan["subject"], _counted(plan, lists), state, PLAN,
        plan["started_ms"], plan["observed_ms"], "", details,
    )  # fmt: skip
    if plan["pull_request"] is not None:
        outcome = "merged by the gate" if merged else plan["error"] or "waits for the gate"
        proposal = DONE if merged else FAILED if plan["error"] else WAITING
        number = str(plan["pull_request"])
        times = (plan["proposed_ms"], plan["merged_ms"])
        yield Step(PULL_REQUEST, number, f"pull request {number}", outcome, proposal, None, *times, plan["url"])
        yield from _checks(plan)
    if plan["commit"]:
        text = "on main" if merged else plan["error"] or "proposed"
        link = _commit_page(plan["url"], plan["commit"])
        standing = DONE if merged else FAILED if plan["error"] else WAITING
        commit = plan["commit"]
        yield Step(COMMIT, commit, commit[:12], text, standing, COMMIT, plan["merged_ms"], plan["synced_ms"], link)


def _checks(plan: Document) -> Iterator[Step]:
    """What the gate tried of a plan's pull request, and what each of it came to; nothing while nobody knows."""
    decision = plan["decision"]
    if decision is None:
        return
    failed = [check for check in decision["checks"] if check["problems"]]
    made = len(decision["checks"])
    text = f"{len(failed)} of {made} did not hold: {failed[0]['problems'][0]}" if failed else f"all {made} hold"
    state = {ACCEPTED: DONE, CHECKED: WAITING}.get(decision["verdict"], FAILED)
    details = tuple((check["check"], _check_words(check)) for check in decision["checks"])
    times = (decision["began_ms"], decision["decided_ms"])
    number = str(plan["pull_request"])
    said = text if failed else text + _decision_words(decision)
    yield Step(CHECKS, number, "the gate's checks", said, state, None, *times, plan["url"], details)


def _decision_words(decision: Document) -> str:
    """What follows for a plan whose checks hold."""
    if decision["verdict"] == STALE:
        return ", but main moved meanwhile"
    if decision["verdict"] == CHECKED:
        closed = decision["way"] == CLOSED
        return ", but the merge policy lets nobody merge it" if closed else ", and somebody has to approve it"
    return f", approved by {', '.join(decision['approvers'])}" if decision["approvers"] else ""


def _check_words(check: Document) -> str:
    """What came of a check, and how long it took, where that is to be measured."""
    words = "; ".join(check["problems"]) or "holds"
    return f"{words} ({check['took_ms']:g} ms)" if check["took_ms"] else words


def _choices(plan: Document) -> Iterator[tuple[str, str]]:
    """What was decided, each with its reason: which versions, which Nodes, and which others not."""
    for choice in plan["choices"]:
        yield f"decided for {choice['task']}", choice["choice"]


def _values(plan: Document) -> Iterator[tuple[str, str]]:
    """Each value of a release that a plan changes, before and after."""
    differences = plan["differences"]
    if not differences:
        return
    for value in differences["values"]:
        before, after = (value[side] if value[side] is not None else f"({word})" for side, word in SIDES)
        yield f"{value['release']} {value['path']}", f"{before} → {after}"
    if differences["more"]:
        yield "besides", f"{differences['more']} other values, in the commit"


def _counted(plan: Document, lists: Iterable[str]) -> str:
    """What a plan does, in numbers; what kept it from it, where something did."""
    done = ", ".join(f"{len(plan[word])} {word}" for word in lists if plan[word])
    return "; ".join(filter(None, (done, plan["error"])))


def _commit_page(pull_request: str, commit: str) -> str:
    """The forge's page of a commit, next to that of a pull request; empty where its form is not known."""
    repository, separator, _ = pull_request.rpartition("/pulls/")
    return f"{repository}/commit/{commit}" if separator else ""


def _running(releases: Iterable[str], view: View, since_ms: int | None) -> Iterator[Step]:
    """Applications and pods of releases; a pod that started before `since_ms` took the change while it ran."""
    pods: dict[str, list[tuple[str, Document]]] = {}
    for key, pod in view.pods.items():
        pods.setdefault(pod["release"], []).append((key, pod))
    for release in releases:
        yield _application(release, view.releases.get(release))
        for key, pod in pods.get(release, ()):
            yield _pod(key, pod, since_ms)


def _application(release: str, document: Document | None) -> Step:
    if document is None:
        return Step(APPLICATION, release, application_name(*release.split("/")), "not there", GONE, RELEASE)
    well = document["sync"] == "Synced" and document["health"] == "Healthy"
    text = f"{document['sync']} {document['health']} plan {document['plan']}"
    details = tuple(("message", message) for message in document["messages"])
    failed = document["health"] == "Degraded"
    state = DONE if well else FAILED if failed else WAITING
    return Step(APPLICATION, release, document["application"], text, state, RELEASE, details=details)


def _pod(key: str, pod: Document, since_ms: int | None) -> Step:
    state = GONE if pod["deleting"] else FAILED if pod["trouble"] else DONE if pod["ready"] else WAITING
    text = f"{pod['phase']} on {pod['node'] or 'no node'}"
    details = (("trouble", pod["trouble"]),) if pod["trouble"] else ()
    started = pod["started_ms"]
    # Kubernetes tells whole seconds
    if started is not None and since_ms is not None and started // MS_OF_S < since_ms // MS_OF_S:
        since = ("started", second_text(started * NS_OF_MS))
        return Step(POD, key, key, f"{text}, ran before it", state, POD, details=(*details, since))
    return Step(POD, key, key, text, state, POD, started, pod["ready_ms"], "", details)


def _recordings(matches: Matches) -> Iterator[Step]:
    """Recordings, and when the first message of each was measured."""
    for key, recording in matches.recordings.items():
        first = _first_message(recording)
        if first is not None:
            topic, stamp_ms = first
            yield Step(FIRST_MESSAGE, topic, topic, f"stored by {recording['recording']}", DONE, None, stamp_ms)
        yield _recording(key, recording)


def _first_message(recording: Document) -> tuple[str, int] | None:
    """Topic and stamp of the first message since the recording began; of what it had from before then the last topic to
    begin. Latched messages are older, and say nothing of when data flows."""
    stamps = [(t["first_ms"], t["topic"]) for t in recording["topics"] if t["first_ms"] is not None and t["stored"]]
    since = [one for one in stamps if one[0] >= (recording["began_ms"] or 0)]
    chosen = min(since) if since else max(stamps, default=None)
    return None if chosen is None else (chosen[1], chosen[0])


def _recording(key: str, recording: Document) -> Step:
    gone = not recording["at_work"] and recording["ended_ms"] is None
    how = "at work" if recording["at_work"] else "its end was not seen" if gone else "ended"
    missing = f", {recording['gap_count']} gaps" if recording["gap_count"] else ""
    text = f"{how}: {recording['stored']} messages{missing}, on {recording['volume']}"
    details = tuple((topic["topic"], f"{topic['stored']} stored") for topic in recording["topics"])
    times = (recording["began_ms"], recording["ended_ms"])
    state = GONE if gone else DONE
    return Step(RECORDING, key, recording["recording"], text, state, RECORDING, *times, details=details)
