"""The release of the chart that is there, and the way from its version to this chart's (UPGRADING.md)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem
from robotkube.delivery.preflight.core.kinds import read_version
from robotkube.delivery.preflight.core.renderings import Object, RenderedChart, name_of
from robotkube.registry.suites.core.pod_security import items, mapping

PENDING = ("pending-install", "pending-upgrade", "pending-rollback", "uninstalling")
GATE = "gate"


class Server(NamedTuple):
    """A Service of the platform with a port for TLS and one for clear text, and who connects."""

    name: str
    tls: int
    plain: int
    clients: str


SERVERS = (Server("broker", 8883, 1883, "robots that run"), Server("database", 27018, 27017, "recorders that run"))


@dataclass(frozen=True)
class HelmRevision:
    """A revision of the release, the last one: version of its chart, its state in Helm's words, its values."""

    version: str
    status: str
    revision: int
    values: Mapping[str, Any] = field(default_factory=dict, repr=False)


@dataclass(frozen=True)
class PresentObjects:
    """The Deployments and Services of the release's namespace."""

    deployments: Sequence[Object]
    services: Sequence[Object]


def release(
    chart: Mapping[str, Any], rendering: RenderedChart, present: HelmRevision | None, standing: PresentObjects
) -> CheckVerdict:
    """The release is in a state from which Helm goes on, and nothing of its version stands in the way of this one."""
    own = str(chart.get("version"))
    if present is None:
        return CheckVerdict(
            f"no release {rendering.release} in namespace {rendering.namespace}: an installation of {own}"
        )
    problems = [*_state(present, rendering), *_way(present.version, own), *_demands(rendering, standing)]
    way = f"version {own} over {present.version}" if own != present.version else f"version {own}, as installed"
    says = f"revision {present.revision} of {rendering.release} is {present.status}; {way}"
    return CheckVerdict(f"{says}; UPGRADING.md says what no program can see", problems)


def _state(present: HelmRevision, rendering: RenderedChart) -> Iterator[Problem]:
    where = f"release {rendering.namespace}/{rendering.release}, revision {present.revision}"
    history = f"helm history {rendering.release} --namespace {rendering.namespace}"
    if present.status in PENDING:
        why = "Helm refuses another operation while one is under way, or was broken off"
        back = f"helm rollback {rendering.release} --namespace {rendering.namespace}"
        fix = f"{history}; wait for it, or, when nobody runs it any more: {back}"
        yield Problem(f"it is {present.status}", where, why, fix)
    elif present.status != "deployed":
        why = "what it should have changed is there in part only"
        yield Problem(f"it is {present.status}", where, why, f"{history} says why; then helm upgrade again")


def _way(installed: str, own: str) -> Iterator[Problem]:
    before, after = read_version(installed), read_version(own)
    if before is not None and after is not None and after < before:
        why = "only the way forward is tested, and older processes refuse settings of newer ones"
        fix = f"give a chart of {installed} or later with --chart; UPGRADING.md, Back"
        yield Problem(f"version {installed} is installed, this chart is {own}", "Chart.yaml, version", why, fix)


def _demands(rendering: RenderedChart, standing: PresentObjects) -> Iterator[Problem]:
    """What UPGRADING.md asks for before, as far as objects of the cluster show that it was not done."""
    yield from _former_gate(rendering, standing)
    yield from _in_clear_text(rendering, standing)


def _former_gate(rendering: RenderedChart, standing: PresentObjects) -> Iterator[Problem]:
    own = rendering.namespace
    moved = any(workload.name == GATE and workload.namespace != own for workload in rendering.workloads)
    runs = any(
        name_of(deployment) == GATE and mapping(deployment.get("spec")).get("replicas", 1)
        for deployment in standing.deployments
    )
    if moved and runs:
        why = "this chart's gate stands in a namespace of its own, and for the time of the upgrade there would be two"
        fix = f"kubectl --namespace {own} scale deployment gate --replicas=0 (UPGRADING.md, From single versions)"
        yield Problem("the gate of an earlier version runs", f"Deployment {own}/{GATE}", why, fix)


def _in_clear_text(rendering: RenderedChart, standing: PresentObjects) -> Iterator[Problem]:
    for server in SERVERS:
        now = [_ports(service) for service in standing.services if name_of(service) == server.name]
        then = [_ports(one) for one in rendering.of_kind("Service") if name_of(one) == server.name]
        if now and then and server.tls not in now[0] and server.tls in then[0] and server.plain not in then[0]:
            why = f"{server.clients} speak clear text, and would lose the {server.name} with the upgrade"
            steps = "upgrade with tls.mode: 'off', publish the charts anew, then with tls.plain: true"
            fix = f"{steps} (UPGRADING.md, Connections to the {server.name} are encrypted)"
            what = f"the {server.name} that runs takes clear text alone, and this chart's takes none"
            yield Problem(what, f"Service {rendering.namespace}/{server.name}", why, fix)


def _ports(service: Object) -> set[Any]:
    return {port.get("port") for port in items(mapping(service.get("spec")).get("ports"))}
