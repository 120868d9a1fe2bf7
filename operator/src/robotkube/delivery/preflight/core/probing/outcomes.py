"""What became of the probe's pods: whether they run, what hangs and why, and what each said at its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robotkube.delivery.preflight.core.agents import is_ready
from robotkube.delivery.preflight.core.findings import Unread
from robotkube.delivery.preflight.core.probing.answers import ProbeAnswer
from robotkube.delivery.preflight.core.probing.objects import ProbeTarget
from robotkube.delivery.preflight.core.renderings import Object, name_of
from robotkube.registry.suites.core.pod_security import items, mapping

PULLING = frozenset({"ErrImagePull", "ImagePullBackOff", "InvalidImageName", "ErrImageNeverPull", "ImageInspectError"})
"""What a container waits for when its image is not there, in the words of kubelets."""
SETTLED = PULLING - {"ErrImagePull"} | {"CreateContainerConfigError", "CreateContainerError", "RunContainerError"}
OVER = ("Failed", "Succeeded")


@dataclass(frozen=True)
class ProbePod:
    """The state of a pod: its address once it runs, its last words once it is over. `pulled`: its Node has the image,
    None where nobody knows; `words`: why it does not run, as far as its Node says it; `settled`: it will not change."""

    runs: bool
    address: str
    pulled: bool | None
    words: str
    said: str
    settled: bool


@dataclass(frozen=True)
class NodeOutcome:
    """What the probe learnt of a Node; `neighbour` is the Node whose pod its own was to reach."""

    pulled: bool | None
    words: str
    answer: ProbeAnswer | Unread
    neighbour: str = ""


@dataclass(frozen=True)
class Probed:
    """The outcome of a probe: of each Node; why no pod was started on others; what could not be removed again."""

    target: ProbeTarget
    nodes: Mapping[str, NodeOutcome]
    unasked: Mapping[str, str]
    left: str
    seconds: float


def read_pod(pod: Object) -> ProbePod:
    """The state of a pod of the probe."""
    status = mapping(pod.get("status"))
    phase = str(status.get("phase", ""))
    state = mapping((items(status.get("containerStatuses")) or [{}])[0].get("state"))
    waiting, ended = (mapping(state.get(key)) for key in ("waiting", "terminated"))
    reason = str(waiting.get("reason", ""))
    why = [(one.get("reason"), one.get("message")) for one in (status, waiting, ended)]
    words = "; ".join(": ".join(str(part) for part in pair if part) for pair in why if any(pair))
    runs = bool("running" in state and status.get("podIP"))
    return ProbePod(
        runs=runs,
        address=str(status.get("podIP", "")) if runs else "",
        pulled=_pulled(state, reason),
        words="" if runs else words,
        said=str(ended.get("message", "")),
        settled=runs or "terminated" in state or phase in OVER or reason in SETTLED,
    )


def _pulled(state: Mapping[str, object], reason: str) -> bool | None:
    if "running" in state or "terminated" in state or reason in SETTLED - PULLING:
        return True
    return False if reason in PULLING else None


def last_words(events: Sequence[Object]) -> Mapping[str, str]:
    """The last Event of each pod, a warning before others, as `<reason>: <note>`."""
    last: dict[str, tuple[bool, str, str]] = {}
    for event in events:
        about = str(mapping(event.get("involvedObject")).get("name", ""))
        when = str(event.get("lastTimestamp") or event.get("eventTime") or "")
        one = (event.get("type") == "Warning", when, f"{event.get('reason')}: {event.get('message')}")
        last[about] = max(last.get(about, one), one)
    return {name: words for name, (_, _, words) in last.items()}


def ready_nodes(nodes: Sequence[Object], most: int) -> tuple[Sequence[str], Mapping[str, str]]:
    """The Nodes on which pods are started, `most` of them; and why none is on the others."""
    ready = [name_of(node) for node in nodes if is_ready(node)]
    unasked = {name_of(node): "it is not Ready (see check agents-ready)" for node in nodes if not is_ready(node)}
    unasked |= dict.fromkeys(ready[most:], f"more than {most} Nodes are not asked")
    return ready[:most], unasked
