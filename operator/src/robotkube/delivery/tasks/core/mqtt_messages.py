"""Messages of the MQTT task gateway: what operators send and what it answers, read and written as JSON.

    robotkube/tasks/<operator>         {"metadata": {"name": <id>}, "spec": {...}}     ask, or change what was asked
                                       {"withdraw": <id>}                              the demand ends
                                       {"renew": <id>}                                 the lease begins anew
    robotkube/task_status/<operator>   {"id", "conditions": [...], "plan", ...}        what became of it

An answer to what never became a custom resource has one condition, Accepted=False, with one of GATEWAY_REASONS.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.delivery.tasks.core.task_description import GROUP, VERSION
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import SUBDOMAIN
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.shortening import shortened
from robotkube.foundation.documents.core.yaml_codec import json_problems

TASKS_TOPIC = "robotkube/tasks/"
STATUS_TOPIC = "robotkube/task_status/"
MESSAGE_BYTES_MAX = 256 * 1024
TEXT_CHARACTERS_MAX = 2000
NOT_READABLE = "NotReadable"
TOO_LARGE = "TooLarge"
NOT_ACCEPTED = "NotAccepted"
UNKNOWN_TASK = "UnknownTask"
NOT_REACHED = "NotReached"
GATEWAY_REASONS = (NOT_READABLE, TOO_LARGE, NOT_ACCEPTED, UNKNOWN_TASK, NOT_REACHED)
GATEWAY_LABEL = f"{GROUP}/door"  # published under this name
GATEWAY = "mqtt"
LEASE_ANNOTATION = f"{GROUP}/lease-renewed"
RULE = "asked"  # the rule of a demand that names no event

_ANSWERED = ("observedGeneration", "conditions", "plan", "pullRequest", "commit", "releases")


@dataclass(frozen=True)
class TaskRequest:
    """A task as an operator writes it: `spec` as it came, without `requester`."""

    id: str
    spec: Mapping[str, Any]


@dataclass(frozen=True)
class TaskWithdrawal:
    """The end of a task's demand."""

    id: str


@dataclass(frozen=True)
class LeaseRenewal:
    """The renewal of a task's lease."""

    id: str


@dataclass(frozen=True)
class RejectedMessage:
    """A message that cannot become a custom resource: a reason of GATEWAY_REASONS and what to change; `id` where it is
    known."""

    reason: str
    message: str
    id: str = field(default="")


def operator_of(topic: str) -> str:
    """The operator whose topic this is; empty when it is another topic."""
    return topic.removeprefix(TASKS_TOPIC) if topic.startswith(TASKS_TOPIC) else ""


def read_message(payload: bytes, size: int) -> TaskRequest | TaskWithdrawal | LeaseRenewal | RejectedMessage:
    """The order in a message of `size` bytes; `payload` may be cut off where that is more than MESSAGE_BYTES_MAX."""
    if size > MESSAGE_BYTES_MAX:
        return RejectedMessage(
            TOO_LARGE, f"{size} bytes; a task has at most {MESSAGE_BYTES_MAX}: put large data elsewhere"
        )
    try:
        document = read_json(payload.decode(), _pairs, _no_number)
    except ValueError as error:
        return RejectedMessage(NOT_READABLE, f"no JSON in UTF-8: {_bounded(str(error))}; send one JSON object")
    if not isinstance(document, dict):
        return RejectedMessage(
            NOT_READABLE, f"JSON, but {type(document).__name__} and no object; send {{metadata, spec}}"
        )
    try:
        return _order(document)
    except DocumentError as error:
        return RejectedMessage(NOT_READABLE, _bounded("; ".join(error.problems)), _id_of(document))


def _pairs(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) != len(pairs):
        raise ValueError("a key stands twice in one object")
    return document


def _no_number(text: str) -> float:
    return math.nan if text == "NaN" else math.inf  # json_problems names the key


def _order(document: Mapping[str, Any]) -> TaskRequest | TaskWithdrawal | LeaseRenewal:
    reader = Reader("message")
    reader.problems += json_problems(document, "")[:20]
    reader.finish()
    for word, kind in (("withdraw", TaskWithdrawal), ("renew", LeaseRenewal)):
        if word in document:
            reader.mapping(document, "", [word])
            name = reader.word(document[word], word, SUBDOMAIN)
            reader.finish()
            return kind(name)
    return _task_request(reader, document)


def _task_request(reader: Reader, document: Mapping[str, Any]) -> TaskRequest:
    task = reader.mapping(document, "", ["metadata", "spec"], ["apiVersion", "kind"])
    reader.equal(task.get("apiVersion"), "apiVersion", f"{GROUP}/{VERSION}")
    reader.equal(task.get("kind"), "kind", "TaskDescription")
    metadata = reader.mapping(task.get("metadata", {}), "metadata", ["name"])
    name = reader.text(metadata.get("name"), "metadata.name", SUBDOMAIN)
    spec = task.get("spec", {})
    if not isinstance(spec, Mapping):
        reader.problems.append("spec: must be an object")
        spec = {}
    if "chain" in spec:
        reader.problems.append("spec.chain: is set by the platform; remove it")
    reader.finish()
    return TaskRequest(name, {key: value for key, value in spec.items() if key != "requester"})


def _id_of(document: Mapping[str, Any]) -> str:
    """The id that a refused document means, when it is a name at all."""
    metadata = document.get("metadata")
    named = metadata.get("name") if isinstance(metadata, Mapping) else None
    identifier = named or document.get("withdraw") or document.get("renew")
    return identifier if isinstance(identifier, str) and SUBDOMAIN.fullmatch(identifier) else ""


def task_document(operator: str, namespace: str, request: TaskRequest, now: str) -> dict[str, Any]:
    """The custom resource of a demand of the operator, in its namespace. A demand that names no event gets one, made
    from its own name."""
    spec = {**request.spec, "requester": operator}
    spec.setdefault("event", own_event(namespace, request.id, now))
    return {
        "apiVersion": f"{GROUP}/{VERSION}",
        "kind": "TaskDescription",
        "metadata": {"namespace": namespace, "name": request.id, "labels": {GATEWAY_LABEL: GATEWAY}},
        "spec": spec,
    }


def changed_spec(present: Mapping[str, Any], operator: str, request: TaskRequest, now: str) -> dict[str, Any]:
    """The new spec of an existing task: what is asked now, with the event it has where none is named."""
    spec = {**request.spec, "requester": operator}
    present_spec = present.get("spec", {})
    if "event" not in spec:
        spec["event"] = present_spec.get("event") or own_event(str(present["metadata"]["namespace"]), request.id, now)
    if "chain" in present_spec:
        spec["chain"] = present_spec["chain"]
    return spec


def own_event(namespace: str, name: str, now: str) -> dict[str, Any]:
    """The event of a demand that names none; `now` is the time of its asking."""
    trace = hashlib.sha256(f"{namespace}/{name}\0{now}".encode()).hexdigest()[:32]
    return {"rule": RULE, "id": name, "time": now, "trace": trace}


def status_topic(operator: str) -> str:
    """The topic on which an operator receives what became of its tasks."""
    return STATUS_TOPIC + operator


def status_answer(task: Mapping[str, Any]) -> bytes:
    """The answer with a task's status."""
    status = task.get("status", {})
    fields = {key: status[key] for key in _ANSWERED if key in status}
    return _json({"id": task["metadata"]["name"], "conditions": [], **fields})


def gone_answer(name: str) -> bytes:
    """The answer about a task that is no longer there: nothing is demanded by it."""
    return _json({"id": name, "conditions": [], "withdrawn": True})


def refusal_answer(refused: RejectedMessage) -> bytes:
    """The answer to a message that did not become a task: why."""
    condition = {"type": "Accepted", "status": "False", "reason": refused.reason, "message": refused.message}
    return _json({"id": refused.id or None, "conditions": [condition]})


def _json(document: Mapping[str, Any]) -> bytes:
    return json.dumps(document, sort_keys=True, ensure_ascii=False).encode(errors="replace")


def _bounded(text: str) -> str:
    return shortened(text, TEXT_CHARACTERS_MAX)
