"""Nodes and the agents of the values: their labels, whether they are ready, and their control groups."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from semver import Version

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem, Unread, named
from robotkube.delivery.preflight.core.kinds import read_version
from robotkube.delivery.preflight.core.renderings import Object, agents, labels_of, name_of
from robotkube.foundation.kubernetes.core.node_agents import (
    AGENT,
    CAPABILITY,
    GUEST,
    GUEST_CAPABILITY,
    GUEST_ROLE,
    GUESTS_MAX,
    ROLE,
    TRUE,
    NodeAgent,
    node_agents,
    shared_nodes,
    trial_words,
)
from robotkube.registry.suites.core.pod_security import items, mapping

PLATFORM = "platform"  # the role of Nodes that run the platform and are no agent's
REFUSING = Version(1, 35, 0, "0")  # and every later version: a pre-release of it, too
WHY_NO_NODE = "until one is there tasks on it are refused with NoCapableNode"


def agents_nodes(settings: Mapping[str, Any], nodes: Sequence[Object]) -> CheckVerdict:
    """Each agent has a Node, of its role, and a reserved one need not have any; no Node names an agent that is not
    declared. Where Nodes are several agents' that is said, and the suites' agent is none of the guests."""
    declared = {str(agent.get("name")): str(agent.get("role") or "") for agent in agents(settings)}
    owned = of_agents(nodes)
    problems = [_no_node(name, role) for name, role in declared.items() if role and name not in owned]
    for node in nodes:
        problems += _wrong_values(node) if _named(node) else ()
        for agent in _named(node):
            problems += _wrong_labels(node, agent, declared)
    problems += _suites_on_a_guest(settings, nodes)
    reserved = sum(not role for role in declared.values())
    says = f"{len(declared)} agents in the values{f' ({reserved} reserved)' if reserved else ''}, "
    says += f"{len(owned)} named by Nodes, {len(nodes)} Nodes"
    trial = trial_words(shared_nodes((name_of(node), labels_of(node)) for node in nodes))
    return CheckVerdict(f"{says}; {trial}" if trial else says, problems)


def of_agents(nodes: Sequence[Object]) -> Mapping[str, Sequence[Object]]:
    """The Nodes of each agent that a label names."""
    owned: defaultdict[str, list[Object]] = defaultdict(list)
    for node in nodes:
        for agent in _named(node):
            owned[agent.name].append(node)
    return owned


def _named(node: Object) -> list[NodeAgent]:
    return [agent for agent in node_agents(labels_of(node)) if agent.name]


def _no_node(name: str, role: str) -> Problem:
    fix = f"kubectl label node NODE {AGENT}={name} {ROLE}={role}, or take it out of the values `agents`"
    return Problem(f"no Node has the label {AGENT}={name}", f"agent {name}", WHY_NO_NODE, fix)


def _wrong_labels(node: Object, agent: NodeAgent, declared: Mapping[str, str]) -> Iterator[Problem]:
    name = name_of(node)
    wanted = declared.get(agent.name, "")
    if agent.name not in declared and agent.role == PLATFORM:
        return
    if agent.name not in declared:
        label = f"{GUEST}{agent.name}" if agent.guest else AGENT
        fix = f"declare it in the values `agents`, or kubectl label node {name} {label}-"
        why = "there is no namespace, account or volume claim for it, and the manager leaves it out"
        yield Problem(
            f"label {label}={agent.guest or agent.name} names no agent of the values", f"Node {name}", why, fix
        )
    elif wanted and (agent.role or wanted) != wanted:
        label = f"{GUEST_ROLE}{agent.name}" if agent.guest else ROLE
        fix = f"kubectl label node {name} {label}={wanted} --overwrite, or change the agent's role in the values"
        what = f"label {label} is {agent.role}, the values say {wanted}"
        yield Problem(what, f"Node {name}", "people and selectors go by it", fix)


def _wrong_values(node: Object) -> Iterator[Problem]:
    name = name_of(node)
    guests = [agent.name for agent in _named(node) if agent.guest]
    numbers = [agent.guest for agent in _named(node) if agent.guest]
    for key, value in sorted(labels_of(node).items()):
        if (key.startswith(CAPABILITY) or GUEST_CAPABILITY in key) and value != TRUE:
            why = "a capability counts with the value true alone"
            yield Problem(
                f"label {key} is {value!r}", f"Node {name}", why, f"kubectl label node {name} {key}=true --overwrite"
            )
        if key.startswith(GUEST) and (key.removeprefix(GUEST) not in guests or numbers.count(int(value)) > 1):
            why = "it is the ROS domain of a guest, by which those who share a Node are kept apart"
            fix = f"kubectl label node {name} {key}=N --overwrite, N from 1 to {GUESTS_MAX} and no other guest's"
            yield Problem(f"label {key} is {value!r}", f"Node {name}", why, fix)


def _suites_on_a_guest(settings: Mapping[str, Any], nodes: Sequence[Object]) -> Iterator[Problem]:
    suites = mapping(settings.get("suites"))
    of_cloud = (str(agent.get("name")) for agent in agents(settings) if agent.get("role") == "cloud")
    chosen = str(suites.get("agent") or "") or next(of_cloud, "")
    for node in nodes if suites.get("enabled", True) else ():
        if any(agent.guest and agent.name == chosen for agent in _named(node)):
            why = "charts are tried by the label of a Node's host, so their pods would find no Node"
            fix = "name a host in suites.agent, or give this agent the label robotkube.io/agent, another the guest's"
            yield Problem(
                f"agent {chosen}, on which charts are tried, is a guest there", f"Node {name_of(node)}", why, fix
            )


def agents_ready(settings: Mapping[str, Any], nodes: Sequence[Object]) -> CheckVerdict:
    """Every Node of a declared agent is Ready and takes pods."""
    declared = [str(agent.get("name")) for agent in agents(settings)]
    owned = of_agents(nodes)
    own = list({name_of(node): node for name in declared for node in owned.get(name, ())}.values())
    problems = [problem for node in own for problem in _not_ready(node)]
    unseen = "" if own else "no Node of an agent is there (see check agents)"
    return CheckVerdict(f"{len(own)} Nodes of agents", problems, unseen)


def is_ready(node: Object) -> bool:
    """Return whether its kubelet says that it is ready."""
    conditions = items(mapping(node.get("status")).get("conditions"))
    return any(condition.get("type") == "Ready" and condition.get("status") == "True" for condition in conditions)


def _not_ready(node: Object) -> Iterator[Problem]:
    name = name_of(node)
    if not is_ready(node):
        conditions = items(mapping(node.get("status")).get("conditions"))
        words = next(
            (str(condition.get("message", "")) for condition in conditions if condition.get("type") == "Ready"), ""
        )
        why = "nothing starts there, and the manager takes it for lost after managers[].nodeLostSeconds"
        yield Problem(
            f"it is not Ready: {words or 'no word of its kubelet'}",
            f"Node {name}",
            why,
            f"kubectl describe node {name}",
        )
    if mapping(node.get("spec")).get("unschedulable"):
        yield Problem(
            "it takes no new pods", f"Node {name}", "releases of its agent do not start", f"kubectl uncordon {name}"
        )


def control_groups(versions: Mapping[str, int | Unread], nodes: Sequence[Object]) -> CheckVerdict:
    """Every Node has control groups of version 2, as its kubelet says in its metrics, or a kubelet that was told to
    take version 1: one that refuses it by itself does not run there otherwise."""
    allowing = {name_of(node) for node in nodes if _refuses_version_1(node)}
    first = {name for name, version in versions.items() if version == 1}
    old = sorted(first - allowing)
    unread = {name: version.why for name, version in versions.items() if isinstance(version, Unread)}
    why = "kubelets of Kubernetes 1.35 and later do not start there unless failCgroupV1 is false"
    fix = "boot it with systemd.unified_cgroup_hierarchy=1, or take a newer distribution"
    problems = [Problem("control groups are of version 1", f"Node {name}", why, fix) for name in old]
    words = "; ".join(sorted(set(unread.values())))
    unseen = f"version of {named(sorted(unread))} not read: {words}" if unread else ""
    unseen = unseen if versions else "there is no Node"
    says = f"{len(versions) - len(unread)} of {len(versions)} Nodes say their version"
    says += (
        f"; {len(first & allowing)} have version 1, and kubelets with failCgroupV1: false" if first & allowing else ""
    )
    return CheckVerdict(says, problems, unseen)


def _refuses_version_1(node: Object) -> bool:
    """Return whether the kubelet of a Node, unless it is told otherwise, does not start on control groups of version
    1."""
    version = str(mapping(mapping(node.get("status")).get("nodeInfo")).get("kubeletVersion", ""))
    known = read_version(version)
    return known is not None and known >= REFUSING
