"""Which cluster is meant: the one place that knows the kinds of clusters by name. Everybody else gets a provider."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from ci.cluster.embedded import cleaning
from ci.cluster.embedded.network.addresses import PLANS
from ci.cluster.embedded.provider import Embedded
from ci.cluster.existing.nodes import GivenCluster
from ci.cluster.existing.provider import Existing
from ci.cluster.k3s import archives
from ci.cluster.k3s.provider import K3s
from ci.cluster.kind.provider import KindCluster
from ci.cluster_contract.provider import Provider
from ci.errors import InputError

NAME = "demo"
OFFERED = {
    Embedded.kind: "made of this machine's processes; runs everything",
    KindCluster.kind: "made of containers by kind, with Docker or podman; runs what asks nothing of machines",
    K3s.kind: "a k3s that somebody else set up, taken as existing is, with its own files, images and storage",
    Existing.kind: "a cluster that somebody else made; its Nodes become agents', and scenarios run, until make down",
}
"""Kinds of clusters, and what each is."""
TAKEN: dict[str, type[Existing]] = {K3s.kind: K3s, Existing.kind: Existing}
"""Kinds of clusters that are there already."""
OF_K3S = f"k3s, without a registry, imports images from the folder {archives.VARIABLE} (default: {archives.FOLDER})"


@dataclass(frozen=True)
class Choice:
    """A cluster: which one of those that are made, which kind, and how one is reached that is given."""

    name: str = NAME
    kind: str = Embedded.kind
    given: GivenCluster = field(default_factory=GivenCluster)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What names a cluster on a command line."""
    parser.add_argument("--cluster", default=Embedded.kind, metavar="KIND", help=f"one of {', '.join(OFFERED)}")
    parser.add_argument("--name", choices=sorted(PLANS), default=NAME, help="of a cluster that is made")
    given = parser.add_argument_group(f"of a cluster that is there ({', '.join(TAKEN)})", OF_K3S)
    given.add_argument("--kubeconfig", default="", metavar="FILE", help="default: that of kubectl, or of k3s")
    given.add_argument("--context", default="", help="of the kubeconfig (default: its current one)")
    given.add_argument("--registry", default="", metavar="HOST/PATH", help="where the cluster pulls the images")
    given.add_argument("--registry-ca", type=Path, metavar="FILE", help="who signed that one's certificate (PEM)")
    given.add_argument("--agents", type=Path, default=GivenCluster.agents, metavar="FILE", help="which Nodes are whose")
    given.add_argument("--values", type=Path, metavar="FILE", help="further values of the platform's chart")
    given.add_argument("--yes", action="store_true", help="what is written is agreed to; nobody is asked")


def choice(given: argparse.Namespace) -> Choice:
    """The cluster that a command line names; InputError says what is there."""
    if given.cluster not in OFFERED:
        there = "; ".join(f"{kind}: {what}" for kind, what in OFFERED.items())
        raise InputError(f"CLUSTER={given.cluster}: there is no such kind of cluster; there is {there}")
    reached = GivenCluster(
        given.kubeconfig, given.context, given.registry, given.agents, given.values, given.yes, given.registry_ca
    )
    return Choice(given.name, given.cluster, reached)


def provider(chosen: Choice, binaries: Path = Path()) -> Provider:
    """The cluster, for an installation and for scenarios. `binaries`: the tool chain's folder, for one that is made."""
    if chosen.kind == KindCluster.kind:
        return _kind(binaries)
    return taken(chosen.kind, chosen.given) if chosen.kind in TAKEN else Embedded(chosen.name, binaries)


@functools.cache
def _kind(binaries: Path) -> KindCluster:
    """One in each process, as below."""
    return KindCluster(binaries)


@functools.cache
def taken(kind: str, given: GivenCluster) -> Existing:
    """A cluster that is there, one in each process: it has ways to the cluster's Services open."""
    return TAKEN[kind](given)


def remove_running(say: Callable[[str], None]) -> None:
    """Remove the clusters that run on this machine's own processes: for those who need a new one."""
    for name in PLANS:
        if cleaning.leftovers(name):
            say(f"stopping the cluster {name}: only one can run, and it must be a new one")
            Embedded(name, Path()).down()
