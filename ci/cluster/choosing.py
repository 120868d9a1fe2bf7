"""Which cluster is meant: the one place that knows the kinds of clusters by name. Everybody else gets a provider."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ci.cluster import cleaning
from ci.cluster.addresses import PLANS
from ci.cluster.embedded import Embedded
from ci.cluster.provider import NodesProvider, Provider
from ci.errors import InputError

NAME = "demo"
OFFERED = {Embedded.kind: "made of this machine's processes; needs nothing else"}
"""Kinds of clusters, and what each is."""


@dataclass(frozen=True)
class Choice:
    """A cluster: which one of its kind, and which kind."""

    name: str = NAME
    kind: str = Embedded.kind


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What names a cluster on a command line."""
    parser.add_argument("--cluster", default=Embedded.kind, metavar="KIND", help=f"one of {', '.join(OFFERED)}")
    parser.add_argument("--name", choices=sorted(PLANS), default=NAME, help="of the cluster that is made")


def choice(given: argparse.Namespace) -> Choice:
    """The cluster that a command line names; InputError says what is there."""
    if given.cluster not in OFFERED:
        there = "; ".join(f"{kind}: {what}" for kind, what in OFFERED.items())
        raise InputError(f"CLUSTER={given.cluster}: there is no such kind of cluster; there is {there}")
    return Choice(given.name, given.cluster)


def provider(chosen: Choice, binaries: Path = Path()) -> Provider:
    """The cluster, for an installation and for scenarios."""
    return Embedded(chosen.name, binaries)


def nodes_provider(chosen: Choice) -> NodesProvider:
    """The cluster, for its Nodes alone."""
    return provider(chosen)


def remove_running(say: Callable[[str], None]) -> None:
    """Remove the clusters that run on this machine's own processes: for those who need a new one."""
    for name in PLANS:
        if cleaning.leftovers(name):
            say(f"stopping the cluster {name}: only one can run, and it must be a new one")
            Embedded(name, Path()).down()
