"""TaskDescriptions as values, and their status conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.domain.documents import Reader
from robotkube.domain.errors import DocumentError
from robotkube.domain.releases import NAME, TASK, TOKEN, Cause, canonical
from robotkube.domain.texts import json_problems

GROUP, VERSION, PLURAL = "robotkube.io", "v1alpha1", "taskdescriptions"
REFUSAL_REASONS = (
    "UnknownApplication",
    "InvalidParameters",
    "NoVerifiedVersion",
    "GuaranteeNotMet",
    "NoCapableNode",
    "CompositionFailed",
)
MERGED, PROPOSED, WAITING = "Merged", "Proposed", "Waiting"
PROPOSAL_REFUSED, WAITS_FOR_APPROVAL = "ProposalRefused", "WaitsForApproval"
GATE_UNAVAILABLE, FORGE_UNAVAILABLE = "GateUnavailable", "ForgeUnavailable"
OBSTACLES = (WAITS_FOR_APPROVAL, GATE_UNAVAILABLE, FORGE_UNAVAILABLE)
REASONS: Mapping[str, tuple[str, ...]] = {
    "Accepted": ("Accepted", *REFUSAL_REASONS, *OBSTACLES),
    "Committed": (MERGED, PROPOSED, WAITING, PROPOSAL_REFUSED, *OBSTACLES),
    "Synced": ("Applied", "Progressing"),
    "Ready": ("Observed", "Progressing"),
}
CONDITIONS = tuple(REASONS)
PARAMETERS_BYTES_MAX = 16 * 1024  # they stand in every release file that answers the task


@dataclass(frozen=True)
class TaskDescription:
    """The intent of an operator: an event asks for an application; `created` is Kubernetes' time text."""

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
    event_details: Mapping[str, Any] = field(default_factory=dict)
    identity: str = ""

    @property
    def key(self) -> str:
        """`<namespace>/<name>`."""
        return f"{self.namespace}/{self.name}"

    @property
    def cause(self) -> Cause:
        """As release files and commits name it."""
        return Cause(self.key, self.event, self.rule, self.trace, self.application, canonical(self.parameters))


def object_key(document: Mapping[str, Any]) -> str:
    """`<namespace>/<name>` of any Kubernetes object."""
    metadata = document.get("metadata", {})
    return f"{metadata.get('namespace', '')}/{metadata.get('name', '')}"


def object_identity(document: Mapping[str, Any]) -> str:
    """What tells an object from a later one of the same name."""
    metadata = document.get("metadata", {})
    return f"{metadata.get('uid', '')} {metadata.get('creationTimestamp', '')}"


def is_withdrawn(document: Mapping[str, Any]) -> bool:
    """Whether the object is being deleted: its demand no longer counts."""
    return bool(document.get("metadata", {}).get("deletionTimestamp"))


def read_task(document: Mapping[str, Any]) -> TaskDescription:
    """The task in a Kubernetes object; DocumentError lists what is wrong with its spec (the API server's schema refuses
    most of it before)."""
    key = object_key(document)
    reader = Reader(f"task {key}")
    metadata = document.get("metadata", {})
    spec = reader.mapping(
        document.get("spec") or {}, "spec", ["event", "application"], ["requester", "reason", "parameters"]
    )
    event = reader.mapping(spec.get("event") or {}, "spec.event", ["rule", "id", "trace"], ["time", "stamp"])
    parameters = spec.get("parameters", {})
    if not isinstance(parameters, Mapping):
        reader.problems.append("spec.parameters: must be a mapping")
        parameters = {}
    reader.problems += json_problems(parameters, "spec.parameters") or _too_long(parameters)
    reader.text(key, "metadata", TASK)
    task = TaskDescription(
        namespace=metadata.get("namespace", ""),
        name=metadata.get("name", ""),
        generation=int(metadata.get("generation", 1)),
        created=str(metadata.get("creationTimestamp", "")),
        requester=str(spec.get("requester", "")),
        rule=reader.text(event.get("rule"), "spec.event.rule", TOKEN),
        event=reader.text(event.get("id"), "spec.event.id", TOKEN),
        trace=reader.text(event.get("trace"), "spec.event.trace", TOKEN),
        reason=str(spec.get("reason", "")),
        application=reader.text(spec.get("application"), "spec.application", NAME),
        parameters=parameters,
        event_details={key: str(value) for key, value in event.items()},
        identity=object_identity(document),
    )
    reader.finish()
    return task


def _too_long(parameters: Mapping[str, Any]) -> list[str]:
    size = len(canonical(parameters))
    return [f"spec.parameters: {size} bytes, at most {PARAMETERS_BYTES_MAX}"] if size > PARAMETERS_BYTES_MAX else []


def with_defaults(schema: Mapping[str, Any], parameters: Mapping[str, Any]) -> dict[str, Any]:
    """`parameters` with the schema's top-level defaults where a key is missing."""
    properties = schema.get("properties", {})
    defaults = {
        key: rule["default"] for key, rule in properties.items() if isinstance(rule, Mapping) and "default" in rule
    }
    return {**defaults, **parameters}


@dataclass(frozen=True)
class Condition:
    """One condition before its time is known; `status` is True, False or Unknown."""

    type: str
    status: str
    reason: str
    message: str


def write_conditions(
    wanted: Sequence[Condition], present: Sequence[Mapping[str, Any]], generation: int, now: str
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


def as_conditions(error: DocumentError) -> Condition:
    """The refusal of a task that cannot be read."""
    return Condition("Accepted", "False", "InvalidParameters", str(error))
