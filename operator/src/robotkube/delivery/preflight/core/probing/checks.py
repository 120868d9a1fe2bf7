"""The checks of the probe: what its pods found out on each Node, as problems with what mends them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.delivery.preflight.core.agents import of_agents
from robotkube.delivery.preflight.core.checks import ClusterCheck
from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem, Unread, named
from robotkube.delivery.preflight.core.probing.answers import CLOSED_PORT, OPEN_PORT, ProbeAnswer
from robotkube.delivery.preflight.core.probing.clocks import behind_the_middle
from robotkube.delivery.preflight.core.probing.outcomes import NodeOutcome, Probed
from robotkube.delivery.preflight.core.renderings import Object, RenderedChart, agents, enabled, name_of
from robotkube.foundation.kubernetes.core.service_names import service_of
from robotkube.registry.suites.core.pod_security import mapping

CLOCK_SECONDS_MAX = 0.1
FREE_SHARE_MIN: Mapping[str, float] = {"pods": 0.10, "images": 0.15}
"""Below it kubelets, unless they are told otherwise, evict pods or take images away."""
FREE_BYTES_MIN = 2 * 1024**3
GIB = 1024**3


def pull(probed: Probed, rendering: RenderedChart) -> CheckVerdict:
    """Every Node has the platform's image, or pulled it now. What needs a Secret of the platform's namespace (values
    imagePullSecrets) is not known: the probe reads no Secret."""
    problems, unknown = [], []
    secrets = any(mapping(workload.template.get("spec")).get("imagePullSecrets") for workload in rendering.workloads)
    for name, node in probed.nodes.items():
        if node.pulled is False and secrets:
            unknown.append(f"Node {name} asks for imagePullSecrets, which the probe has not ({node.words})")
        elif node.pulled is False:
            problems.append(_not_pulled(name, node, probed.target.image))
        elif node.pulled is None:
            problems.append(_not_started(name, node))
    have = sum(node.pulled is True for node in probed.nodes.values())
    says = f"{have} of {len(probed.nodes)} Nodes have {probed.target.image}"
    return CheckVerdict(says, problems, "; ".join([*unknown, *_unasked(probed)]))


def _not_pulled(name: str, node: NodeOutcome, image: str) -> Problem:
    fix = "correct images.platform or global.imageRegistry, give the Node's container runtime access to the registry, "
    fix += "or bring the image there: robotkube bundle load"
    return Problem(f"{image} is not pulled: {node.words}", f"Node {name}", "no pod of the platform starts there", fix)


def _not_started(name: str, node: NodeOutcome) -> Problem:
    words = node.words or "its kubelet says nothing"
    return Problem(
        f"no pod started there in time: {words}",
        f"Node {name}",
        "releases on it would wait in the same way",
        f"kubectl describe node {name}, and the log of its kubelet",
    )


def disks(probed: Probed) -> CheckVerdict:
    """Every Node has free space for images and for what pods write, above the marks of kubelets."""
    problems = []
    least = ""
    low = 1.0
    for name, answer in _answers(probed):
        for what, disk in answer.disks.items():
            share = disk.free / disk.total if disk.total else 0.0
            if share < low:
                low = share
                least = f"; least free: {share:.0%} ({disk.free / GIB:.1f} GiB, {what}) on {name}"
            if share < FREE_SHARE_MIN.get(what, 0.0) or disk.free < FREE_BYTES_MIN:
                problems.append(_full(name, what, share, disk.free))
    return CheckVerdict(f"{_asked(probed)} Nodes say how much is free{least}", problems, _unknown(probed))


def _full(name: str, what: str, share: float, free: int) -> Problem:
    return Problem(
        f"{share:.0%} ({free / GIB:.1f} GiB) is free where it keeps its {what}",
        f"Node {name}",
        "its kubelet takes images away and evicts pods when it is full, and recordings end there",
        "free space on it (crictl rmi --prune, old logs and volumes), or give it a larger disk",
    )


def names(probed: Probed) -> CheckVerdict:
    """Pods on every Node resolve the cluster's names."""
    problems = [
        Problem(
            f"{host} is not resolved: {words}",
            f"Node {name}",
            "pods find broker, database, forge and API server by such names alone",
            "correct clusterDomain in the values, or repair the name service: kubectl -n kube-system get pods -o wide",
        )
        for name, answer in _answers(probed)
        for host, words in answer.names.items()
        if words
    ]
    return CheckVerdict(f"{_asked(probed)} Nodes asked for {named(probed.target.names)}", problems, _unknown(probed))


def clocks(probed: Probed) -> CheckVerdict:
    """The clocks of all Nodes differ from the middle one by CLOCK_SECONDS_MAX at most."""
    answers = {name: answer for name, answer in _answers(probed) if not answer.clock_words}
    behind = behind_the_middle({name: answer.clock_ahead for name, answer in answers.items()})
    problems = []
    unsure = [f"Node {name}: {answer.clock_words}" for name, answer in _answers(probed) if answer.clock_words]
    for name, seconds in behind.items():
        within = answers[name].clock_within
        if abs(seconds) - within > CLOCK_SECONDS_MAX:
            problems.append(_wrong_clock(name, seconds, within))
        elif abs(seconds) + within > CLOCK_SECONDS_MAX:
            unsure.append(f"clock of Node {name}: {seconds * 1000:.0f} ms, known within {within * 1000:.0f} ms alone")
    most = max((abs(seconds) for seconds in behind.values()), default=0.0)
    says = f"{len(behind)} Nodes, {most * 1000:.0f} ms at most from the middle"
    return CheckVerdict(says, problems, "; ".join(filter(None, (*unsure, _unknown(probed)))))


def _wrong_clock(name: str, seconds: float, within: float) -> Problem:
    side = "behind" if seconds > 0 else "ahead"
    return Problem(
        f"its clock is {abs(seconds) * 1000:.0f} ms {side} of the middle of all (within {within * 1000:.0f} ms)",
        f"Node {name}",
        "rules compare stamps of several agents, and recordings order messages by them",
        "synchronise it: systemctl enable --now systemd-timesyncd (or chrony), then timedatectl",
    )


def broker_reach(probed: Probed, settings: Mapping[str, Any], nodes: Sequence[Object], installed: bool) -> CheckVerdict:
    """The Node of every agent reaches the broker's port; accounts and certificates are not tried."""
    host, port = probed.target.broker
    owned = of_agents(nodes)
    named = (name_of(node) for agent in agents(settings) for node in owned.get(str(agent.get("name")), ()))
    own = list(dict.fromkeys(named))
    if not host and not installed:
        return CheckVerdict("", (), "absent: the broker is the platform's own, which the chart makes")
    if not host:
        return CheckVerdict("", (), "the chart names no broker")
    asked = [(name, answer) for name, answer in _answers(probed) if name in own]
    problems = [_not_reached(name, probed, answer.broker_words) for name, answer in asked if answer.broker_words]
    unseen = _unknown(probed, own) if own else "no Node of an agent is there (see check agents)"
    return CheckVerdict(f"{len(asked) - len(problems)} Nodes of agents reach {host}:{port}", problems, unseen)


def _not_reached(name: str, probed: Probed, words: str) -> Problem:
    host, port = probed.target.broker
    service = service_of(host)
    fix = "correct broker.external, or let the Node's addresses in at the firewall before it"
    if service:
        fix = f"kubectl -n {service[0]} get pods,networkpolicies; policy broker has to let namespace "
        fix += f"{probed.target.namespace} in, as the chart's does (networkPolicies)"
    return Problem(f"{host}:{port} is not reached: {words}", f"Node {name}", "its agent sends and hears nothing", fix)


def network_policies(probed: Probed, settings: Mapping[str, Any]) -> CheckVerdict:
    """A pod on each Node is reached from another one at the port that a policy opens, and not at the other port."""
    wanted = enabled(settings, "networkPolicies")
    problems: list[Problem] = []
    leaks = 0
    for name, answer in _answers(probed):
        neighbour = probed.nodes[name].neighbour
        if answer.open_words:
            problems.append(_unconnected(name, neighbour, answer.open_words))
        elif answer.closed:
            leaks += 1
            problems += [_not_enforced(neighbour)] if wanted else []
    kept = _asked(probed) - leaks - sum(bool(answer.open_words) for _, answer in _answers(probed))
    says = f"{kept} of {len(probed.nodes)} Nodes keep a policy"
    says += "" if wanted else "; the values make none (networkPolicies.enabled: false)"
    return CheckVerdict(says, problems, _unknown(probed))


def _unconnected(name: str, neighbour: str, words: str) -> Problem:
    return Problem(
        f"a pod of Node {neighbour} is not reached at port {OPEN_PORT}, which a policy opens: {words}",
        f"Node {name}",
        "pods of these two Nodes cannot speak to each other",
        "repair the network plug-in between them: kubectl -n kube-system get pods -o wide",
    )


def _not_enforced(node: str) -> Problem:
    return Problem(
        f"its pods are reached at port {CLOSED_PORT}, which a NetworkPolicy denies",
        f"Node {node}",
        "the chart's NetworkPolicies deny nothing there: every pod reaches broker, database and forge",
        "install a network plug-in that enforces them (Calico, Cilium, kube-router), or say that none are wanted: "
        "networkPolicies.enabled: false",
    )


def removed(probed: Probed) -> CheckVerdict:
    """The check that nothing of the probe is left."""
    name = probed.target.namespace
    if not probed.left:
        return CheckVerdict(f"namespace {name} is gone again, {probed.seconds:.0f} s after it was made")
    fix = f"kubectl delete namespace {name}"
    return CheckVerdict(
        "", [Problem(probed.left, f"namespace {name}", "the next probe is refused while it is there", fix)]
    )


def _answers(probed: Probed) -> Iterator[tuple[str, ProbeAnswer]]:
    for name, node in probed.nodes.items():
        if isinstance(node.answer, ProbeAnswer):
            yield name, node.answer


def _asked(probed: Probed) -> int:
    return sum(1 for _ in _answers(probed))


def _unasked(probed: Probed) -> Iterator[str]:
    return (f"Node {name}: {why}" for name, why in probed.unasked.items())


def _unknown(probed: Probed, of: Sequence[str] | None = None) -> str:
    """Which Nodes, all or those of a list, gave no answer, and why."""
    silent = {name: node.answer.why for name, node in probed.nodes.items() if isinstance(node.answer, Unread)}
    without_answer = {**silent, **probed.unasked}
    chosen = [f"Node {name}: {why}" for name, why in without_answer.items() if of is None or name in of]
    return "; ".join(chosen) or ("" if probed.nodes else "there is no Node on which a pod could be started")


PROBE_CHECKS = (
    ClusterCheck("pull", pull, ("probed", "rendering")),
    ClusterCheck("disks", disks, ("probed",)),
    ClusterCheck("names", names, ("probed",)),
    ClusterCheck("clocks", clocks, ("probed",)),
    ClusterCheck("broker", broker_reach, ("probed", "settings", "nodes", "installed")),
    ClusterCheck("network-policies", network_policies, ("probed", "settings")),
    ClusterCheck("removed", removed, ("probed",)),
)
