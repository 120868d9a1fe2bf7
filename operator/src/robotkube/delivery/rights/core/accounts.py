"""The accounts of the broker, and the rights that each has whatever main says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from robotkube.robots.bridge.core.mqtt_client_format import TYPE_PREFIX
from robotkube.robots.bridge.core.rights import own_places
from robotkube.robots.mqtt.core.message_properties import MQTT_PREFIX, TYPES_PREFIX

READ = "read"
WRITE = "write"
ASK = "ask"
OBSERVER = "observer"
OWNER = "rights"
"""The account of the process that keeps the rights; no agent or manager has this name."""

TASKS = "robotkube/tasks"
TASK_STATUS = "robotkube/task_status"
HOLDS = "robotkube/holds"
LINKS = "robotkube/links"
EVERYBODY = "*"


@dataclass(frozen=True, order=True)
class Right:
    """A right of an account: to `read` or to `write` the topics that an MQTT filter stands for, or to `ask` for all of
    them, where it may read some."""

    topic: str
    direction: str


Table = Mapping[str, frozenset[Right]]
"""Account -> what it may."""


@dataclass(frozen=True)
class AgentAccount:
    """The account of an agent: of its name, used by whatever runs in its namespace. Without a `role` it is reserved:
    main says which role it has once it is enrolled, and until then the account is shut."""

    name: str
    role: str
    namespace: str


@dataclass(frozen=True)
class ManagerAccount:
    """The account of a manager's task gateway; `agents` are those of its scope, `*` for all."""

    name: str
    agents: tuple[str, ...]


@dataclass(frozen=True)
class Accounts:
    """All accounts but the owner's and the observer's."""

    agents: tuple[AgentAccount, ...]
    managers: tuple[ManagerAccount, ...]

    def of_namespace(self, namespace: str) -> AgentAccount | None:
        """The account of the agent whose namespace it is."""
        return next((agent for agent in self.agents if agent.namespace == namespace), None)

    @property
    def reserved(self) -> frozenset[str]:
        """The agents that nobody has enrolled."""
        return frozenset(agent.name for agent in self.agents if not agent.role)

    def with_enrolled(self, enrolled: Mapping[str, str]) -> Accounts:
        """The accounts while main enrolls these (agent -> role): of reserved agents alone, the others have a role."""
        agents = (agent if agent.role else replace(agent, role=enrolled.get(agent.name, "")) for agent in self.agents)
        return replace(self, agents=tuple(agents))


def with_types(topic: str) -> tuple[str, ...]:
    """A topic at the broker, and the topics that say what type its messages have."""
    return (topic, f"{TYPES_PREFIX}{topic}", f"{TYPE_PREFIX}{topic}")


def fixed_rights(accounts: Accounts) -> dict[str, frozenset[Right]]:
    """What every account may whatever main says: its own places, the task gateway, and for who observes everything that
    robots say. Who is reserved may nothing."""
    everything = (Right(topic, READ) for topic in with_types(f"{MQTT_PREFIX}/#"))
    return {
        OBSERVER: frozenset(everything),
        **{agent.name: frozenset(_of_agent(agent)) for agent in accounts.agents},
        **{manager.name: frozenset(_of_manager(manager)) for manager in accounts.managers},
    }


def _of_agent(agent: AgentAccount) -> Iterator[Right]:
    if not agent.role:
        return
    for place in own_places(agent):
        for topic in with_types(f"{MQTT_PREFIX}{place}/#"):
            yield Right(topic, READ)
            yield Right(topic, WRITE)
    yield Right(f"{TASKS}/{agent.name}", WRITE)
    yield Right(f"{TASK_STATUS}/{agent.name}", READ)
    yield Right(f"{HOLDS}/{agent.name}", WRITE)
    yield Right(f"{LINKS}/{agent.name}/+", WRITE)


def _of_manager(manager: ManagerAccount) -> Iterator[Right]:
    for name in ["#"] if EVERYBODY in manager.agents else manager.agents:
        yield Right(f"{TASKS}/{name}", READ)
        yield Right(f"{TASK_STATUS}/{name}", WRITE)
        yield Right(f"{HOLDS}/{name}", READ)
        yield Right(f"{LINKS}/{name}" if name == "#" else f"{LINKS}/{name}/+", READ)
