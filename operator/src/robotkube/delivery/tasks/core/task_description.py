"""TaskDescriptions as values, and their status conditions."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from robotkube.delivery.deployment.core.releases import TaskCause, canonical
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import CAPABILITY, NAME, TASK, TOKEN
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.times import time_ns
from robotkube.foundation.documents.core.yaml_codec import json_problems
from robotkube.foundation.kubernetes.core.annotations import AGENTS_ANNOTATION, RENEWED_ANNOTATION
from robotkube.foundation.kubernetes.core.objects import object_identity, object_key
from robotkube.registry.catalogue.core.guarantees import GuaranteeRequirement, read_requirements

GROUP = "robotkube.io"
VERSION = "v1alpha1"
PLURAL = "taskdescriptions"

INSUFFICIENT_RESOURCES = "InsufficientResources"
RELEASE_IN_USE = "ReleaseInUse"
TOPIC_TAKEN = "TopicTaken"
NO_CAPABLE_NODE = "NoCapableNode"
INVALID_PARAMETERS = "InvalidParameters"
APPLICATION_NOT_VERIFIED = "ApplicationNotVerified"
IMAGE_NOT_VERIFIED = "ImageNotVerified"
LINK_NOT_CONSENTED = "LinkNotConsented"
POSTPONED = "Postponed"
QUEUE_FULL = "QueueFull"
QUEUE_TOO_LONG = "QueueTooLong"
PREEMPTED = "Preempted"
LEASE_EXPIRED = "LeaseExpired"
SUPERSEDED = "Superseded"
REFUSAL_TEXTS: Mapping[str, str] = {
    "UnknownApplication": "the catalogue has no such application, or none provides what is asked for",
    INVALID_PARAMETERS: "the spec cannot be read, or the parameters break the application's schema",
    "NoVerifiedVersion": "no chart version in range has valid evidence under the release policy",
    APPLICATION_NOT_VERIFIED: "the application has no valid evidence that it was composed and checked",
    IMAGE_NOT_VERIFIED: "a pod would run an image that was not verified with its chart, or nobody can tell",
    "GuaranteeNotMet": "chart versions exist, but none guarantees what is required",
    NO_CAPABLE_NODE: "no agent with a usable node has the role, capabilities and neighbours that are asked for",
    INSUFFICIENT_RESOURCES: "the resource requests do not fit beside what is planned on the capable nodes",
    "CompositionFailed": "the application's services cannot be put together with these parameters",
    "LinkNotPermitted": "the broker refuses a topic of a link: its sender may not write it",
    LINK_NOT_CONSENTED: "a link goes over the border of two managers' scopes, and not both consent on main",
    "LinkTypeUnknown": "no bridge knows the message type of a topic of a link",
    "LinkMismatch": "a chart at an end of a link does not open a topic of it, or opens it with another type or QoS",
    RELEASE_IN_USE: "another demand needs a release of the same name with other content",
    TOPIC_TAKEN: "another demand publishes the same ROS topic on the same node",
    POSTPONED: "a conflict with other demands; the task waits in the queue",
    QUEUE_FULL: "a conflict with other demands, and the queue has no place left",
    QUEUE_TOO_LONG: "the task waited in the queue for as long as it may",
    PREEMPTED: "a demand of higher priority took its place",
    LEASE_EXPIRED: "the lease ran out; renew it to ask again",
    "OutsideScope": "the manager's scope does not hold the namespace, an agent or the application",
    "ChainTooDeep": "too many operators launched one another",
    "ChainTooWide": "the parent task has launched too many tasks",
    "ParentWithdrawn": "the task that launched this one's operator is gone",
    SUPERSEDED: "the task changed or was withdrawn before its plan was merged",
}
REFUSAL_REASONS = tuple(REFUSAL_TEXTS)
CONFLICT_REASONS = frozenset({INSUFFICIENT_RESOURCES, RELEASE_IN_USE, TOPIC_TAKEN})  # only other demands cause these
SETTLED_REASONS = CONFLICT_REASONS | {QUEUE_FULL, QUEUE_TOO_LONG, PREEMPTED}
"""Reasons of conflicts that are decided once: such a refusal stands until the task's spec changes or the task is made
anew."""
MERGED = "Merged"
PROPOSED = "Proposed"
WAITING = "Waiting"
PROPOSAL_REFUSED = "ProposalRefused"
WAITS_FOR_APPROVAL = "WaitsForApproval"
GATE_UNAVAILABLE = "GateUnavailable"
FORGE_UNAVAILABLE = "ForgeUnavailable"
FORGE_BUSY = "ForgeBusy"
HELD_BY_AGENT = "HeldByAgent"
MAIN_BROKEN = "MainBroken"
OLD_POD_UNREACHABLE = "OldPodUnreachable"
LINK_BROKEN = "LinkBroken"
EDITED_BY_HAND = "EditedByHand"
OBSTACLE_TEXTS: Mapping[str, str] = {
    WAITS_FOR_APPROVAL: "the merge policy asks for a person's approval",
    GATE_UNAVAILABLE: "the gate has given no verdict for longer than usual",
    FORGE_UNAVAILABLE: "the forge does not answer",
    FORGE_BUSY: "main moved before every attempt to merge; the plan is queued again",
    HELD_BY_AGENT: "an agent holds changes at the moment, for example while driving",
    MAIN_BROKEN: "a file on main cannot be read; its revert is proposed",
}
OBSTACLES = tuple(OBSTACLE_TEXTS)
REASON_TEXTS: Mapping[str, Mapping[str, str]] = {
    "Accepted": {"Accepted": "the demand is met as the message says", **REFUSAL_TEXTS, **OBSTACLE_TEXTS},
    "Committed": {
        MERGED: "all its releases are on main",
        PROPOSED: "its pull request waits for the gate",
        WAITING: "it waits for the plan before it",
        PROPOSAL_REFUSED: "the gate refused the plan, or the forge its push, in the words of the message",
        EDITED_BY_HAND: "a person removed or changed its release on main, and policies/edits.yaml respects that",
        **OBSTACLE_TEXTS,
    },
    "Synced": {"Applied": "Argo CD compared and applied every release", "Progressing": "it has not yet"},
    "Ready": {
        "Observed": "every release is observed as committed",
        "Progressing": "not every release is observed yet; the message names what a container ended by, why it cannot "
        "begin, or that it does not take its changed settings",
        LINK_BROKEN: "a bridge does not carry a topic of the task's links, in the words of the message",
        OLD_POD_UNREACHABLE: "observed, but for old pods on a dead node that cannot be asked",
    },
}
"""The closed list of reasons: type of condition -> reason -> text (docs/reference/task-description.md)."""
REASONS: Mapping[str, tuple[str, ...]] = {condition: tuple(texts) for condition, texts in REASON_TEXTS.items()}
CONDITIONS = tuple(REASONS)

REJECT = "Reject"
POSTPONE = "Postpone"
OFFLOAD = "Offload"
PREEMPT = "Preempt"
CONFLICT_POLICIES = (REJECT, POSTPONE, OFFLOAD, PREEMPT)
PARAMETERS_BYTES_MAX = 16 * 1024  # they stand in every release file that answers the task
PRIORITY_MAX = 1000
PRIORITY_DEFAULT = 100
LEASE_SECONDS = (5, 86_400)
QUEUE_SECONDS = (1, 86_400)
QUEUE_SECONDS_DEFAULT = 600
WORDS_MAX = 32
CHAIN_DEPTH_MAX = 16  # what can be written; the manager allows fewer
PROBLEMS_MAX = 20
PROBLEM_CHARACTERS_MAX = 300

_TIME = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}(\.\d{1,9})?(Z|[+-]\d{2}:\d{2})", re.ASCII)
_NEIGHBOUR = re.compile(rf"{NAME.pattern}|{TASK.pattern}", re.ASCII)
_REQUIRED = ("event",)
_OPTIONAL = (
    "application",
    "provides",
    "requirements",
    "requester",
    "reason",
    "parameters",
    "placement",
    "priority",
    "lease",
    "conflictPolicy",
    "offloadTo",
    "queue",
    "chain",
)


@dataclass(frozen=True)
class TaskPlacement:
    """The places where the task's services may run, besides the application's rules: on one of `agents`, of one of
    `roles`, with all `capabilities`, on no node of the tasks (`<name>` or `<namespace>/<name>`) or releases in
    `anti_affinity`."""

    agents: tuple[str, ...] = ()
    roles: tuple[str, ...] = ()
    capabilities: tuple[str, ...] = ()
    anti_affinity: tuple[str, ...] = ()


@dataclass(frozen=True)
class TaskChain:
    """The place of a task in a chain of operators: `depth` operators above it, `parent` is the key of the task that
    launched the operator; 0 and empty for a task that nobody's task led to."""

    depth: int = 0
    parent: str = ""


@dataclass(frozen=True)
class TaskDescription:
    """The intent of an operator: an event asks for an application, by name or by what it `provides`.

    `created` and `renewed` are Kubernetes' time texts (`renewed` may be empty); `lease_seconds` None is no lease."""

    namespace: str
    name: str
    generation: int
    created: str
    requester: str
    rule: str
    event: str
    trace: str
    reason: str
    application: str
    parameters: Mapping[str, Any]
    event_details: Mapping[str, str] = field(default_factory=dict)
    identity: str = ""
    provides: str = ""
    requirements: tuple[GuaranteeRequirement, ...] = ()
    placement: TaskPlacement = TaskPlacement()
    priority: int = PRIORITY_DEFAULT
    lease_seconds: int | None = None
    renewed: str = ""
    conflict_policy: str = REJECT
    offload_to: tuple[str, ...] = ("cloud",)
    queue_seconds_max: int = QUEUE_SECONDS_DEFAULT
    chain: TaskChain = TaskChain()

    @cached_property
    def key(self) -> str:
        """`<namespace>/<name>`."""
        return f"{self.namespace}/{self.name}"

    @cached_property
    def cause(self) -> TaskCause:
        """The task as release files and commits name it."""
        return TaskCause(self.key, self.event, self.rule, self.trace, self.application, canonical(self.parameters))

    @property
    def parent(self) -> str:
        """Key of the task that launched the operator that asks; empty when none did."""
        return self.chain.parent

    @property
    def expires_ns(self) -> int | None:
        """The time at which the lease runs out, in ns since 1970; None without a lease."""
        if self.lease_seconds is None:
            return None
        begin = max(time_ns(text) for text in (self.created, self.renewed) if text)
        return begin + self.lease_seconds * 1_000_000_000


def read_task(document: Mapping[str, Any]) -> TaskDescription:
    """The task in a Kubernetes object; DocumentError lists what is wrong with its spec (the API server's schema refuses
    most of it before), at most PROBLEMS_MAX problems of PROBLEM_CHARACTERS_MAX characters."""
    reader = Reader(f"task {object_key(document)}"[:PROBLEM_CHARACTERS_MAX])
    task = _task(reader, document)
    if reader.problems:
        raise DocumentError(reader.where, [p[:PROBLEM_CHARACTERS_MAX] for p in reader.problems[:PROBLEMS_MAX]])
    return task


def _task(reader: Reader, document: Mapping[str, Any]) -> TaskDescription:
    metadata = document.get("metadata", {})
    spec = reader.mapping(document.get("spec") or {}, "spec", _REQUIRED, _OPTIONAL)
    event = reader.mapping(spec.get("event") or {}, "spec.event", ["rule", "id", "trace"], ["time", "stamp"])
    parameters = _parameters(reader, spec.get("parameters", {}))
    annotations = metadata.get("annotations") or {}
    reader.text(object_key(document), "metadata", TASK)
    named = _texts(parameters) | set(str(annotations.get(AGENTS_ANNOTATION, "")).split())
    application, provides = _wanted(reader, spec)
    lease = reader.mapping(spec.get("lease") or {}, "spec.lease", [], ["seconds"])
    return TaskDescription(
        namespace=metadata.get("namespace", ""),
        name=metadata.get("name", ""),
        generation=int(metadata.get("generation", 1)),
        created=_time(reader, metadata.get("creationTimestamp", ""), "metadata.creationTimestamp"),
        requester=reader.prose(spec.get("requester", ""), "spec.requester"),
        rule=reader.text(event.get("rule"), "spec.event.rule", TOKEN),
        event=reader.text(event.get("id"), "spec.event.id", TOKEN),
        trace=reader.text(event.get("trace"), "spec.event.trace", TOKEN),
        reason=reader.prose(spec.get("reason", ""), "spec.reason"),
        application=application,
        parameters=parameters,
        event_details=_event_details(reader, event),
        identity=object_identity(document),
        provides=provides,
        requirements=read_requirements(reader, spec.get("requirements"), "spec.requirements"),
        placement=_placement(reader, spec.get("placement") or {}, named),
        priority=_whole(reader, spec.get("priority", PRIORITY_DEFAULT), "spec.priority", (0, PRIORITY_MAX)),
        lease_seconds=_whole(reader, lease["seconds"], "spec.lease.seconds", LEASE_SECONDS)
        if "seconds" in lease
        else None,
        renewed=_time(reader, annotations.get(RENEWED_ANNOTATION, ""), f"metadata.annotations.{RENEWED_ANNOTATION}"),
        conflict_policy=_policy(reader, spec),
        offload_to=_words(reader, spec.get("offloadTo", ["cloud"]), "spec.offloadTo", NAME),
        queue_seconds_max=_queue(reader, spec.get("queue") or {}),
        chain=_chain(reader, spec.get("chain") or {}),
    )


def _event_details(reader: Reader, event: Mapping[str, Any]) -> dict[str, str]:
    keys = ("rule", "id", "trace", "time", "stamp")
    return {key: reader.prose(event[key], f"spec.event.{key}") for key in keys if key in event}


def _wanted(reader: Reader, spec: Mapping[str, Any]) -> tuple[str, str]:
    if ("application" in spec) == ("provides" in spec):
        reader.problems.append("spec: needs exactly one of `application` and `provides`")
    application = reader.word(spec.get("application"), "spec.application", NAME, default="")
    return application, reader.word(spec.get("provides"), "spec.provides", CAPABILITY, default="")


def _parameters(reader: Reader, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        reader.problems.append("spec.parameters: must be a mapping")
        return {}
    problems = json_problems(value, "spec.parameters") or _too_long(value)
    reader.problems += problems
    return {} if problems else value


def _too_long(parameters: Mapping[str, Any]) -> list[str]:
    size = len(canonical(parameters))
    return [f"spec.parameters: {size} bytes, at most {PARAMETERS_BYTES_MAX}"] if size > PARAMETERS_BYTES_MAX else []


def _texts(value: Any) -> set[str]:
    """Every text in a JSON value (keys left out): what the parameters name."""
    if isinstance(value, str):
        return {value}
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, Sequence) else ()
    return {text for item in inner for text in _texts(item)}


def _placement(reader: Reader, value: Any, named: set[str]) -> TaskPlacement:
    path = "spec.placement"
    placement = reader.mapping(value, path, [], ["agents", "roles", "capabilities", "antiAffinity"])
    agents = _words(reader, placement.get("agents", []), f"{path}.agents", NAME)
    reader.problems += [
        f"{path}.agents: {agent} is named neither by the parameters nor by the event (annotation {AGENTS_ANNOTATION}); "
        "a task names only agents that it is about"
        for agent in agents
        if agent not in named
    ]
    return TaskPlacement(
        agents,
        _words(reader, placement.get("roles", []), f"{path}.roles", NAME),
        _words(reader, placement.get("capabilities", []), f"{path}.capabilities", NAME),
        _words(reader, placement.get("antiAffinity", []), f"{path}.antiAffinity", _NEIGHBOUR),
    )


def _words(reader: Reader, value: Any, path: str, pattern: re.Pattern[str]) -> tuple[str, ...]:
    items = reader.sequence(value, path)
    if len(items) > WORDS_MAX:
        reader.problems.append(f"{path}: {len(items)} entries, at most {WORDS_MAX}")
    words = [reader.word(item, f"{path}[{index}]", pattern) for index, item in enumerate(items[:WORDS_MAX])]
    return tuple(dict.fromkeys(word for word in words if word))


def _whole(reader: Reader, value: Any, path: str, bounds: tuple[int, int]) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not bounds[0] <= value <= bounds[1]:
        reader.problems.append(f"{path}: must be a whole number from {bounds[0]} to {bounds[1]}")
        return bounds[0]
    return int(value)


def _policy(reader: Reader, spec: Mapping[str, Any]) -> str:
    policy = spec.get("conflictPolicy", REJECT)
    if not isinstance(policy, str) or policy not in CONFLICT_POLICIES:
        reader.problems.append(f"spec.conflictPolicy: must be one of {', '.join(CONFLICT_POLICIES)}")
        policy = REJECT
    if "offloadTo" in spec and policy != OFFLOAD:
        reader.problems.append(f"spec.offloadTo: only with conflictPolicy {OFFLOAD}; remove it")
    if "queue" in spec and policy != POSTPONE:
        reader.problems.append(f"spec.queue: only with conflictPolicy {POSTPONE}; remove it")
    return policy


def _queue(reader: Reader, value: Any) -> int:
    queue = reader.mapping(value, "spec.queue", [], ["secondsMax"])
    return _whole(reader, queue.get("secondsMax", QUEUE_SECONDS_DEFAULT), "spec.queue.secondsMax", QUEUE_SECONDS)


def _chain(reader: Reader, value: Any) -> TaskChain:
    chain = reader.mapping(value, "spec.chain", [], ["depth", "parent"])
    depth = _whole(reader, chain.get("depth", 0), "spec.chain.depth", (0, CHAIN_DEPTH_MAX))
    return TaskChain(depth, reader.word(chain.get("parent"), "spec.chain.parent", TASK, default=""))


def _time(reader: Reader, value: Any, path: str) -> str:
    """A time as text, or empty; ns since 1970 can be computed from it afterwards."""
    if value == "":
        return ""
    try:
        if isinstance(value, str) and _TIME.fullmatch(value):
            time_ns(value)
            return value
    except (ValueError, OverflowError):
        pass
    reader.problems.append(f"{path}: {value!r:.60} must be an RFC 3339 time such as 2026-11-21T10:00:00Z")
    return ""


@dataclass(frozen=True)
class StatusCondition:
    """One condition of a task's status before its time is known; `status` is True, False or Unknown."""

    type: str
    status: str
    reason: str
    message: str


def write_conditions(
    wanted: Sequence[StatusCondition], present: Sequence[Mapping[str, Any]], generation: int, now: str
) -> list[dict[str, Any]]:
    """Conditions in Kubernetes' form. `lastTransitionTime` stays where the status stays, else it is `now`."""
    before = {c.get("type"): c for c in present if isinstance(c, Mapping)}
    result = []
    for condition in wanted:
        old = before.get(condition.type, {})
        same = old.get("status") == condition.status and old.get("lastTransitionTime")
        result.append(
            {
                "type": condition.type,
                "status": condition.status,
                "reason": condition.reason,
                "message": condition.message,
                "observedGeneration": generation,
                "lastTransitionTime": old["lastTransitionTime"] if same else now,
            }
        )
    return result


def as_conditions(error: DocumentError) -> StatusCondition:
    """The refusal of a task that cannot be read."""
    return StatusCondition("Accepted", "False", "InvalidParameters", str(error))
