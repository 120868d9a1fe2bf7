"""Placement: the agent that a service runs on, with the reason for every candidate (docs/explanation/placement.md)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

from robotkube.delivery.manager.core.placement.capacity import NOTHING, Capacity, Occupancy, Resources
from robotkube.delivery.manager.core.placement.criteria import AgentCriteria
from robotkube.delivery.manager.core.placement.reasons import DECLARED, Reason, listed, shown
from robotkube.errors import RefusalError
from robotkube.registry.catalogue.core.applications import PlacementRule

if TYPE_CHECKING:
    from robotkube.delivery.manager.core.placement.link_needs import LinkNeed
    from robotkube.delivery.tasks.core.holds import DeviceHold

NODE_LOST_SECONDS = 40.0
CANDIDATES_KEPT_MAX = 256
SECOND_NS = 1_000_000_000

LOST = "its Node is lost"
GUEST = "is a guest on another agent's Node"
POSSIBLE: Reason = ("possible", "")


@dataclass(frozen=True, order=True)
class Agent:
    """A declared machine of the fleet; its node may not exist yet. With `node` it is one place of an agent that has
    several Nodes: ROS does not cross Nodes, so each of them counts by itself. Without a `role` it is reserved: main
    says which role it has once it is enrolled. `guest`: its number on a Node that is another agent's as well, which the
    fleet knows."""

    name: str
    role: str
    namespace: str
    node: str = ""
    guest: int = 0

    @property
    def place(self) -> str:
        """The name under which what is planned there is counted."""
        return f"{self.name}@{self.node}" if self.node else self.name

    def __str__(self) -> str:
        return f"{self.name} (Node {self.node})" if self.node else self.name


@dataclass(frozen=True)
class NodeState:
    """A Node that belongs to an agent (label robotkube.io/agent), or to one of several that share it: then what it
    offers is that one's part, and `guest` its number beside the Node's host (0: it is the host).

    `allocatable` None and `platform` "" are not known and bound nothing. Times are ns since 1970, from the condition
    Ready: `ready_since`; `not_ready_since` while it is not; `silent_since` while nothing is heard of the kubelet.
    `hold`: the agent's hold, as its Node has it. `lost` is set by `fleet`: not ready for longer than is waited for.
    `created`: when the Node joined, ns since 1970."""

    name: str
    agent: str
    role: str
    capabilities: frozenset[str]
    ready: bool
    cordoned: bool = False
    hold: DeviceHold | None = None
    allocatable: Resources | None = None
    platform: str = ""
    ready_since: int | None = None
    not_ready_since: int | None = None
    silent_since: int | None = None
    lost: bool = False
    created: int = 0
    guest: int = 0

    def silent_seconds(self, now_ns: int) -> float:
        """How long nothing was heard of the kubelet; 0 while it reports."""
        return 0.0 if self.silent_since is None else max(now_ns - self.silent_since, 0) / SECOND_NS


@dataclass(frozen=True)
class PlacementRequest:
    """Request of an instance of a service for a place: its rule, the agent it names (rendered; None: it names none),
    the agents that run its release already, what it asks for, the platforms it runs on (none: any), a word for services
    that must not share an agent. `merged`: it shares a release of its name with others. `links`: their needs that not
    every agent can have. `unfit_for_guests`: the chart version, where that cannot run on a Node's guests."""

    service: str
    rule: PlacementRule
    agent: object = None
    kept: frozenset[str] = frozenset()
    need: Resources = NOTHING
    platforms: tuple[str, ...] = ()
    apart: str = ""
    merged: bool = False
    links: tuple[LinkNeed, ...] = ()
    unfit_for_guests: str = ""


@dataclass(frozen=True)
class Narrowing:
    """Bounds that a task sets to the places of its services: among `agents`, in one of `roles`, with `capabilities`.
    `instead`: roles that stand in for those of the rules."""

    agents: tuple[str, ...] = ()
    roles: tuple[str, ...] = ()
    capabilities: tuple[str, ...] = ()
    instead: tuple[str, ...] = ()


ANYWHERE = Narrowing()


@dataclass(frozen=True)
class Placement:
    """The agent chosen, and one sentence per candidate."""

    agent: Agent
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Candidates:
    """Places for one `AgentCriteria`: who can run something new, who may keep what it has, and why not; `lost` are
    those that have nothing against them but that their nodes are lost."""

    free: tuple[Agent, ...]
    stay: frozenset[str]
    obstacles: Mapping[str, Reason]
    agents: tuple[Agent, ...]
    lost: frozenset[str] = frozenset()
    _stays: dict[tuple[str, Sequence[str]], Placement] = field(default_factory=dict, compare=False)

    def stays(self, agent: Agent, together: Sequence[str]) -> Placement:
        """The answer for what runs on `agent` already."""
        key = (agent.place, tuple(together))
        if key not in self._stays:
            others = [(str(a), self.obstacles.get(a.place, POSSIBLE)) for a in self.agents if a != agent]
            first = (*together, f"{agent}: taken, it runs there already")
            self._stays[key] = Placement(agent, (*first, *listed(others)))
        return self._stays[key]


@dataclass(frozen=True)
class Fleet:
    """Declared agents and their nodes. `homes`: of agents whose Nodes count one by one, the Node with the agent's own
    ROS network: what is bound to the agent runs there, and links that name the agent end there."""

    agents: Mapping[str, Agent]
    nodes: Mapping[str, tuple[NodeState, ...]]
    homes: Mapping[str, str] = field(default_factory=dict)

    def present(self, role: str) -> tuple[Agent, ...]:
        """Declared agents of a role that have a node, by name; of several Nodes the home."""
        return tuple(self.home(agent) for agent in self.of_role.get(role, ()) if self.nodes.get(agent.name))

    def home(self, agent: Agent) -> Agent:
        """The place of what is bound to an agent."""
        return self._on(agent, self.homes[agent.name]) if agent.name in self.homes else agent

    def places(self, agent: Agent) -> tuple[Agent, ...]:
        """Every place of an agent, by Node: itself, unless its Nodes count one by one."""
        return self._divided.get(agent.name, (agent,))

    def machines(self, agent: Agent) -> tuple[NodeState, ...]:
        """The Nodes of a place."""
        nodes = self.nodes.get(agent.name, ())
        return tuple(node for node in nodes if node.name == agent.node) if agent.node else nodes

    @cached_property
    def _divided(self) -> Mapping[str, tuple[Agent, ...]]:
        return {name: tuple(self._on(self.agents[name], n.name) for n in self.nodes[name]) for name in self.homes}

    def _on(self, agent: Agent, node: str) -> Agent:
        """An agent on its Node of that name."""
        guest = next((known.guest for known in self.nodes[agent.name] if known.name == node), 0)
        return replace(agent, node=node, guest=guest)

    @cached_property
    def at(self) -> Mapping[str, Agent]:
        """Places by their names, and declared agents by theirs."""
        return {**self.agents, **{place.place: place for places in self._divided.values() for place in places}}

    def agent(self, name: object) -> Agent:
        """A declared agent that has a node; RefusalError(NoCapableNode) says which of both it lacks."""
        if not isinstance(name, str) or name not in self.agents:
            known = shown(sorted(self.agents)) or "none is"
            text = f"agent {name!r} is not declared; name one that is ({known}), or declare it ({DECLARED})"
            raise RefusalError("NoCapableNode", text)
        if not self.nodes.get(name):
            text = f"agent {name!r} has no Node with label robotkube.io/agent={name}; let its Node join, or label it"
            raise RefusalError("NoCapableNode", text)
        return self.home(self.agents[name])

    def link_end(self, name: object) -> Agent:
        """The agent at an end of a link, where it is named: one that others answer for, too."""
        return self.agent(name)

    @property
    def has_borders(self) -> bool:
        """Return whether there are topics that not every agent may hear."""
        return False

    def check_heard(self, topic: str, listener: str) -> None:
        """Check that an agent may hear a topic; RefusalError where it may not go over a border."""

    def loss(self, agent: str, now_ns: int, node: str = "") -> str:
        """Why nothing of an agent, or of its Node of that name, can be reached for longer than is waited for; empty
        when it can."""
        nodes = [known for known in self.nodes.get(agent, ()) if node in ("", known.name)]
        if not nodes:
            return f"agent {agent} has no node{f' {node}' if node else ''}"
        if not all(node.lost for node in nodes):
            return ""
        since = max(node.not_ready_since or 0 for node in nodes)
        return f"node {', '.join(node.name for node in nodes)} lost for {(now_ns - since) // SECOND_NS} s"

    @cached_property
    def of_role(self) -> Mapping[str, tuple[Agent, ...]]:
        """Declared agents by role, by name; all of them under the empty role."""
        by_role: dict[str, list[Agent]] = {"": []}
        for _, agent in sorted(self.agents.items()):
            by_role[""].append(agent)
            by_role.setdefault(agent.role, []).append(agent)
        return {role: tuple(agents) for role, agents in by_role.items()}

    @cached_property
    def by_namespace(self) -> Mapping[str, tuple[str, ...]]:
        """Names of the declared agents by the namespace of their releases."""
        names: dict[str, tuple[str, ...]] = {}
        for name, agent in sorted(self.agents.items()):
            names[agent.namespace] = (*names.get(agent.namespace, ()), name)
        return names

    @cached_property
    def capacities(self) -> Mapping[str, Capacity]:
        """Capacity of the places of which it is known: of their nodes that are not lost."""
        nodes_of_places = {name: nodes for name, nodes in self.nodes.items() if name not in self.homes}
        nodes_of_places |= {p.place: self.machines(p) for places in self._divided.values() for p in places}
        return {name: capacity for name, nodes in nodes_of_places.items() if (capacity := _capacity(nodes)) is not None}

    def candidates(self, wanted: AgentCriteria) -> Candidates:
        """The candidates for `wanted`, with what stands against each."""
        known = self._candidates
        candidates = known.get(wanted)
        if candidates is None:
            while len(known) >= CANDIDATES_KEPT_MAX:
                known.pop(next(iter(known)))
            candidates = known[wanted] = _candidates(self, wanted)
        return candidates

    @cached_property
    def _candidates(self) -> dict[AgentCriteria, Candidates]:
        return {}


def fleet(
    agents: Sequence[Agent], nodes: Sequence[NodeState], now_ns: int = 0, lost_seconds: float = NODE_LOST_SECONDS
) -> Fleet:
    """Agents and nodes by agent name; nodes that were not ready for longer than `lost_seconds` are lost."""
    by_agent: dict[str, list[NodeState]] = {}
    for node in sorted(nodes, key=lambda n: n.name):
        is_lost = node.not_ready_since is not None and now_ns - node.not_ready_since > lost_seconds * SECOND_NS
        by_agent.setdefault(node.agent, []).append(replace(node, lost=True) if is_lost else node)
    guests = {node.agent: node.guest for node in nodes if node.guest}
    named = {a.name: replace(a, guest=guests[a.name]) if a.name in guests else a for a in agents}
    return Fleet(named, {name: tuple(of_agent) for name, of_agent in by_agent.items()})


def next_loss_ns(nodes: Iterable[NodeState], lost_seconds: float, now_ns: int) -> int | None:
    """The time (ns) when the next node will be lost if it stays silent, which no watch reports; None when none will."""
    moments = [n.not_ready_since + int(lost_seconds * SECOND_NS) + 1 for n in nodes if n.not_ready_since is not None]
    return min((moment for moment in moments if moment > now_ns), default=None)


def _capacity(nodes: Sequence[NodeState]) -> Capacity | None:
    allocatable = [node.allocatable for node in nodes if not node.lost]
    known = [resources for resources in allocatable if resources is not None]
    if not known or len(known) < len(allocatable):
        return None
    largest = Resources(max(r.cpu_millicores for r in known), max(r.memory_bytes for r in known))
    return Capacity(sum(known, NOTHING), largest)


@dataclass(frozen=True)
class Group:
    """Requests that share an agent, and what follows from them; computed once, asked often."""

    requests: tuple[PlacementRequest, ...]
    wanted: AgentCriteria
    together: tuple[str, ...]

    @cached_property
    def kept(self) -> Mapping[str, int]:
        """Places that run some of the releases already, with how many."""
        kept: dict[str, int] = {}
        for request in self.requests:
            for name in request.kept:
                kept[name] = kept.get(name, 0) + 1
        return kept

    @cached_property
    def need(self) -> Resources:
        """What all of them ask for together."""
        return sum((request.need for request in self.requests), NOTHING)

    @cached_property
    def apart(self) -> tuple[str, ...]:
        """Words that must not meet on one agent."""
        return tuple(request.apart for request in self.requests if request.apart)


def group(requests: Sequence[PlacementRequest], fleet: Fleet, narrowing: Narrowing = ANYWHERE) -> Group:
    """The requests as one group; RefusalError(NoCapableNode) when their rules contradict each other."""
    named = _named(requests, fleet)
    role = "" if narrowing.instead else _one_role(requests)
    names = dict.fromkeys(request.service for request in requests)
    together = (f"{', '.join(names)}: on one node, linked by ros",) if len(requests) > 1 else ()
    platforms = tuple(dict.fromkeys(request.platforms for request in requests if request.platforms))
    if named and all(request.agent is not None for request in requests):
        narrowing = ANYWHERE  # bound to the agent as a whole: the task has no say
    of_rules = [capability for request in requests for capability in request.rule.capabilities]
    capabilities = dict.fromkeys([*of_rules, *narrowing.capabilities])
    roles = tuple(narrowing.instead or narrowing.roles)
    unfit = tuple(dict.fromkeys(request.unfit_for_guests for request in requests if request.unfit_for_guests))
    own = named.name if named else ""
    wanted = AgentCriteria(role, roles, narrowing.agents, tuple(capabilities), platforms, own, unfit)
    return Group(tuple(requests), wanted, together)


@dataclass(frozen=True)
class Circumstances:
    """Circumstances of a group: what is planned on each place, what the group asks for (`special`: less on
    these places, where others asked for a part of it), and `avoided` agents and places with why they must not be used.
    `waits`: what runs on a lost node stays there when nobody else can run it."""

    fleet: Fleet
    occupancy: Occupancy
    need: Resources = NOTHING
    special: Mapping[str, Resources] = field(default_factory=dict)
    avoided: Mapping[str, str] = field(default_factory=dict)
    waits: bool = True

    def avoids(self, agent: Agent) -> str:
        """Why a place must not be used; empty when it may."""
        return self.avoided.get(agent.name) or self.avoided.get(agent.place, "") if self.avoided else ""

    def allows(self, agent: Agent) -> bool:
        """Return whether nothing of this stands against a place."""
        if self.avoids(agent):
            return False
        name = agent.place
        return self.occupancy.fits(name, self.fleet.capacities.get(name), self.special.get(name, self.need))

    def reason(self, agent: Agent) -> Reason:
        """The reason against a place that is not allowed; else how much is planned there."""
        if why := self.avoids(agent):
            return why, ""
        name = agent.place
        need, capacity = self.special.get(name, self.need), self.fleet.capacities.get(name)
        if capacity is None or self.occupancy.fits(name, capacity, need):
            return "possible", f", {self.occupancy.load(name)} releases placed"
        return "has not enough room", f": {self.occupancy.shortage(name, capacity, need)}"


def place(asked: Group, around: Circumstances, kept: Mapping[str, int] | None = None) -> Placement:
    """The one place for a group; it runs in part on the places `kept` (default: as its requests say).

    A named agent is chosen; else the agents of the role that is asked for, or all, are candidates. One that runs most
    of the releases already stays, even when it is not ready at the moment, as long as it is not lost. Else another Node
    of the same agent is chosen, else the agent with the least releases placed so far, then the first by name. What runs
    is not moved away because room has become too little, or because its node is lost, when there is no better place.
    RefusalError(NoCapableNode or InsufficientResources) gives the reasons.
    """
    fleet = around.fleet
    candidates = fleet.candidates(asked.wanted)
    kept = asked.kept if kept is None else kept
    load = around.occupancy.load
    running = [fleet.at[n] for n in sorted(kept, key=lambda n: (-kept[n], load(n), n)) if n in candidates.stay]
    for agent in running:
        if around.allows(agent):
            return candidates.stays(agent, asked.together)
    free = _homes_first([agent for agent in candidates.free if around.allows(agent)], fleet)
    if free:
        near = {fleet.at[name].name for name in kept if name in fleet.at}
        chosen = min(free, key=lambda agent: (agent.name not in near, load(agent.place), agent.place))
        return Placement(chosen, _reasons(asked, chosen, candidates, around))
    if staying := [agent for agent in running if not around.avoids(agent)]:
        return candidates.stays(staying[0], asked.together)
    for name in sorted(candidates.lost & kept.keys()) if around.waits else ():
        agent = fleet.at[name]
        return Placement(agent, (*asked.together, f"{agent}: its Node is lost, and nobody else can take it: it waits"))
    raise _refusal(asked, candidates, around)


def _homes_first(free: list[Agent], fleet: Fleet) -> list[Agent]:
    """The free places without the other Nodes of agents whose home is free: those are for what has no room there."""
    if not fleet.homes:
        return free
    homes = {agent.name for agent in free if agent.node == fleet.homes.get(agent.name)}
    return [agent for agent in free if agent.name not in homes or agent.node == fleet.homes[agent.name]]


def _reasons(asked: Group, chosen: Agent, candidates: Candidates, around: Circumstances) -> tuple[str, ...]:
    if chosen.name == asked.wanted.named:
        return (*asked.together, f"{chosen}: named by the application")
    first = f"{chosen}: taken, {around.occupancy.load(chosen.place)} releases placed"
    others = [_reason(agent, candidates, around) for agent in candidates.agents if agent is not chosen]
    return (*asked.together, first, *listed(others))


def _reason(agent: Agent, candidates: Candidates, around: Circumstances) -> tuple[str, Reason]:
    return str(agent), candidates.obstacles.get(agent.place) or around.reason(agent)


def _refusal(asked: Group, candidates: Candidates, around: Circumstances) -> RefusalError:
    reasons = [_reason(agent, candidates, around) for agent in candidates.agents]
    detail = "; ".join(listed(reasons)) or f"no such agent is declared ({DECLARED})"
    group = f"{asked.wanted}{''.join(f' ({text})' for text in asked.together)}"
    if any(not around.avoids(agent) for agent in candidates.free):
        text = f"no agent for {group} has room: {detail}; ask for less, or withdraw something that runs there"
        return RefusalError("InsufficientResources", text)
    return RefusalError("NoCapableNode", f"no agent for {group}: {detail}")


def _candidates(fleet: Fleet, wanted: AgentCriteria) -> Candidates:
    """The candidates: a named agent alone, or those that the task names, or else those of the role or of the roles,
    with all their places; what these lack are obstacles."""
    if wanted.named:
        agents: Sequence[Agent] = [fleet.agents[wanted.named]]
    elif wanted.agents:
        agents = [fleet.agents[name] for name in sorted(set(wanted.agents)) if name in fleet.agents]
    elif wanted.role or not wanted.roles:
        agents = fleet.of_role.get(wanted.role, ())
    else:
        agents = sorted({a for role in wanted.roles for a in fleet.of_role.get(role, ())})
    free = []
    stay = set()
    obstacles = dict[str, Reason]()
    if fleet.homes:
        agents = [place for agent in agents for place in _places(fleet, agent, wanted)]
    for agent in agents:
        if reason := _lack(agent, nodes := fleet.machines(agent), wanted):
            obstacles[agent.place] = reason
            continue
        stay.add(agent.place)
        if wanted.named or any(n.ready and not n.cordoned and not n.lost for n in nodes):
            free.append(agent)
        else:
            obstacles[agent.place] = ("no Node is Ready and schedulable", "")
    lost = frozenset(name for name, (kind, _) in obstacles.items() if kind == LOST)
    return Candidates(tuple(free), frozenset(stay), obstacles, tuple(agents), lost)


def _places(fleet: Fleet, agent: Agent, wanted: AgentCriteria) -> tuple[Agent, ...]:
    """The places of an agent that a group can go to: what is bound to the agent goes to its home."""
    return (fleet.home(agent),) if wanted.named else fleet.places(agent)


def _lack(agent: Agent, nodes: Sequence[NodeState], wanted: AgentCriteria) -> Reason | None:
    """The reason why an agent cannot run a group, for good or because its nodes are lost; a bound service waits for a
    lost one."""
    if wanted.role not in ("", agent.role):
        return f"has role {agent.role}, not {wanted.role}", ""
    if wanted.roles and agent.role not in wanted.roles:
        return f"has role {agent.role}, the task wants {', '.join(wanted.roles)}", ""
    if wanted.agents and agent.name not in wanted.agents:
        return "is not among the agents of the task", ""
    if not nodes:
        return "has no Node", ""
    missing = [c for c in wanted.capabilities if not any(c in node.capabilities for node in nodes)]
    if missing:
        return f"lacks capability {', '.join(missing)}", ""
    foreign = [p for p in wanted.platforms if not any(n.platform in ("", *p) for n in nodes)]
    if foreign:
        own = ", ".join(sorted({node.platform for node in nodes}))
        return f"is {own}, the chart runs on {', '.join(foreign[0])}", ""
    if wanted.unfit_for_guests and agent.guest:
        return GUEST, f", which {', '.join(wanted.unfit_for_guests)} knows nothing of"
    if not wanted.named and all(node.lost for node in nodes):
        return LOST, f": {', '.join(node.name for node in nodes)}"
    return None


def _named(requests: Sequence[PlacementRequest], fleet: Fleet) -> Agent | None:
    agents = [(request.service, fleet.agent(request.agent)) for request in requests if request.agent is not None]
    if len({agent for _, agent in agents}) > 1:
        text = ", ".join(f"{service} names {agent.name}" for service, agent in agents)
        raise RefusalError("NoCapableNode", f"services with ros links must share a node: {text}")
    return agents[0][1] if agents else None


def _one_role(requests: Sequence[PlacementRequest]) -> str:
    roles = {request.service: request.rule.role for request in requests if request.rule.role}
    if len(set(roles.values())) > 1:
        text = ", ".join(f"{service} wants role {role}" for service, role in roles.items())
        raise RefusalError("NoCapableNode", f"services with ros links must share a node: {text}")
    return next(iter(roles.values()), "")
