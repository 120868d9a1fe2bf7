"""The Nodes of a given cluster: they are read, become agents' when a person has agreed, and are given back."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from kubernetes import client, config
from urllib3.exceptions import HTTPError

from ci.cluster import images, status
from ci.cluster.existing import labels, mapping, registry
from ci.cluster.existing.labels import Change, GivenNode
from ci.cluster.provider import NodeState
from ci.cluster.topology import chart_agents
from ci.errors import InputError, SetUpError
from ci.folders import user_cache

CONFLICT = 409
ATTEMPTS_MAX = 5  # at a Node that somebody else writes to meanwhile
ANSWER_SECONDS_MAX = 10
Ask = Callable[[str], bool]


@dataclass(frozen=True)
class GivenCluster:
    """How a given cluster is reached, and what it is to be. `kubeconfig` and `context` may be empty: those of kubectl;
    `registry`: HOST/PATH from which it pulls, or empty; `agents`: the file agents.yaml; `agreed`: nobody is asked."""

    kubeconfig: str = ""
    context: str = ""
    registry: str = ""
    agents: Path = Path("agents.yaml")
    agreed: bool = False


class Existing:
    """One cluster that is there. `ask` shows a person what would be written, and gives the answer."""

    kind = "existing"
    lacks = (
        "its Nodes become agents', and are given back; the platform is installed with helm, as docs/how-to/"
        "use-a-cluster-that-is-there.md says",
        "a scenario does not run on it: its bags and ledgers are read from folders of volumes on this machine",
        "Nodes of the role platform get no taint: pods of others may run beside the platform's",
        "weights of Nodes, outages, conditions of the network and admission from files are not there: the machines are "
        "not this provider's",
    )

    def __init__(self, given: GivenCluster, ask: Ask | None = None) -> None:
        self._given = given
        self._ask = ask or ask_on_terminal
        self._api = _connected(given)

    @property
    def name(self) -> str:
        """The context, which names a cluster for a person."""
        if self._given.context:
            return self._given.context
        return str(config.list_kube_config_contexts(self._given.kubeconfig or None)[1]["name"])

    @property
    def values_file(self) -> Path:
        """Values for the platform's chart on this cluster."""
        return user_cache() / "existing" / re.sub(r"[^A-Za-z0-9.-]", "_", self.name) / "values.yaml"

    def up(self) -> tuple[str, ...]:
        """Make Nodes those of agents.yaml; what was written, a line for each Node. Values for the chart are written to
        `values_file`."""
        entries = mapping.read(self._given.agents)
        values = yaml.safe_dump(self._values(entries))
        if self._given.registry:
            registry.require(self._given.registry, images.read_lock(images.lock_file()))
        written = self._write(lambda nodes: labels.adding(nodes, entries))
        self.values_file.parent.mkdir(parents=True, exist_ok=True)
        self.values_file.write_text(values, encoding="utf-8")
        return written

    def planned(self) -> tuple[str, ...]:
        """What `up` would write, a line for each Node."""
        entries = mapping.read(self._given.agents)
        return tuple(map(str, labels.adding([_given_node(one) for one in self._listed()], entries)))

    def down(self) -> tuple[str, ...]:
        """See NodesProvider.down."""
        written = self._write(labels.removing)
        self.values_file.unlink(missing_ok=True)
        return written

    def kept(self) -> tuple[str, ...]:
        """See NodesProvider.kept."""
        return ("the cluster itself, and what helm has installed on it",)

    def nodes(self) -> tuple[NodeState, ...]:
        """See NodesProvider.nodes: those that are agents', by name."""
        states = (status.node_state(one) for one in self._listed())
        return tuple(sorted((one for one in states if one.agent), key=lambda one: one.name))

    def status(self) -> str:
        """See NodesProvider.status."""
        return status.nodes_table(self.nodes())

    def _values(self, entries: Sequence[mapping.AgentEntry]) -> dict[str, Any]:
        values: dict[str, Any] = {"agents": chart_agents(entries)}
        if self._given.registry:
            values["global"] = {"imageRegistry": str(registry.place_of(self._given.registry))}
        return values

    def _write(self, plan: Callable[[Sequence[GivenNode]], tuple[Change, ...]]) -> tuple[str, ...]:
        """Write what the plan says of the Nodes as they are, until it says nothing more. Whatever is written was agreed
        to."""
        agreed: dict[str, Change] = {}
        for _ in range(ATTEMPTS_MAX):
            listed = self._listed()
            changes = plan([_given_node(one) for one in listed])
            if not changes:
                return tuple(map(str, agreed.values()))
            if any(agreed.get(change.node) != change for change in changes):
                self._agree(changes)
                agreed |= {change.node: change for change in changes}
            versions = {one["metadata"]["name"]: one["metadata"]["resourceVersion"] for one in listed}
            for change in changes:
                self._patch(change, versions[change.node])
        raise SetUpError(f"context {self.name}: Nodes change faster than they can be written; try again")

    def _agree(self, changes: Sequence[Change]) -> None:
        host = self._api.configuration.host
        asked = "\n  ".join(
            [f"context {self.name} ({host}) was not made here. This would be written:", *map(str, changes)]
        )
        if not self._given.agreed and not self._ask(asked):
            raise InputError(f"context {self.name}: nothing was written, since nobody agreed; YES=1 agrees beforehand")

    def _listed(self) -> list[Mapping[str, Any]]:
        answer = self._call("Nodes", client.CoreV1Api(self._api).list_node)
        return [self._api.sanitize_for_serialization(one) for one in answer.items]

    def _patch(self, change: Change, version: str) -> None:
        """Write a change to a Node that is as it was read; nothing where somebody else was faster."""
        metadata = {"resourceVersion": version, "labels": change.labels, "annotations": change.annotations}
        patch = client.CoreV1Api(self._api).patch_node
        self._call(f"Node {change.node}", patch, change.node, {"metadata": metadata}, passing=CONFLICT)

    def _call(self, what: str, function: Any, *arguments: Any, passing: int = 0) -> Any:
        try:
            return function(*arguments, _request_timeout=ANSWER_SECONDS_MAX)
        except client.ApiException as error:
            if error.status == passing:
                return None
            raise SetUpError(f"context {self.name}: {what}: {error.status} {error.reason}: {error.body}") from error
        except (HTTPError, OSError) as error:
            raise SetUpError(f"context {self.name}: {self._api.configuration.host} does not answer: {error}") from error


def ask_on_terminal(text: str) -> bool:
    """Ask the person at the terminal; without one, nobody agrees."""
    print(text, file=sys.stderr)
    return sys.stdin.isatty() and input("Write it? [y/N] ").strip().lower() in ("y", "yes")


def _connected(given: GivenCluster) -> client.ApiClient:
    try:
        api: client.ApiClient = config.new_client_from_config(given.kubeconfig or None, given.context or None)
    except config.ConfigException as error:
        named = given.kubeconfig or "kubectl's kubeconfig"
        raise InputError(f"{named}: {str(error).rstrip('.')}; give KUBECONFIG and CONTEXT") from error
    api.configuration.retries = False
    return api


def _given_node(item: Mapping[str, Any]) -> GivenNode:
    metadata = item["metadata"]
    return GivenNode(metadata["name"], metadata.get("labels", {}), metadata.get("annotations", {}))
