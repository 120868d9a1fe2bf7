"""The cluster as far as updates depend on it: the health of releases, who is online, and who measures results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from robotkube.delivery.manager.core.updates.probe_answers import ProbeAnswers
from robotkube.delivery.manager.core.updates.rule_events import RuleEvent, Watcher

HEALTHY = "healthy"
DEGRADED = "degraded"
PROGRESSING = "progressing"
SECOND_NS = 1_000_000_000
NEVER_NS = 1 << 62


@dataclass(frozen=True)
class ReleaseHealth:
    """The health of a release in the cluster: healthy (Synced and Healthy as main has it), degraded or progressing;
    since when in ns, None when nobody knows. `first_ns`: when it was first healthy as main has it now, as far as the
    manager saw."""

    state: str
    since_ns: int | None = None
    first_ns: int | None = None


@dataclass(frozen=True)
class ClusterHealth:
    """The cluster as far as updates depend on it: `health` by release key; `online`: namespace -> since when (ns; 0 =
    always) a node of its agent is ready; `events` of rules by namespace of the agent they are about, and the `watchers`
    that would tell of more; `ros_names` of agents in topics, by namespace; `probes` by release key, of those whose
    version is measured by them."""

    health: Mapping[str, ReleaseHealth] = field(default_factory=dict)
    online: Mapping[str, int] = field(default_factory=dict)
    events: Mapping[str, Sequence[RuleEvent]] = field(default_factory=dict)
    watchers: Sequence[Watcher] = ()
    probes: Mapping[str, ProbeAnswers] = field(default_factory=dict)
    ros_names: Mapping[str, str] = field(default_factory=dict)
