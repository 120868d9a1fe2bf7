"""The Nodes of a given cluster as they are, and what is written to them once a person has agreed."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kubernetes import client, config
from urllib3.exceptions import HTTPError

from ci.cluster.api_server import node_states
from ci.cluster.existing.labels import GivenNode, NodeChange
from ci.cluster_contract.provider import NodeState
from ci.errors import InputError, SetUpError
from robotkube.foundation.kubernetes.adapters.client import NO_KUBECONFIG

CONFLICT, NOT_FOUND = 409, 404
ATTEMPTS_MAX = 5  # at a Node that somebody else writes to meanwhile
ANSWER_SECONDS_MAX = 10
OF_API_SERVERS = {"label_selector": "kubernetes.io/service-name=kubernetes"}
Ask = Callable[[str], bool]
Plan = Callable[[Sequence[GivenNode]], tuple[NodeChange, ...]]


@dataclass(frozen=True)
class GivenCluster:
    """How a given cluster is reached, and what it is to be. `kubeconfig` and `context` may be empty: those of kubectl;
    `registry`: HOST/PATH from which it pulls, or empty, and `authority`: who signed that one's certificate, where it is
    none of the usual ones; `agents`: the file agents.yaml; `values`: a file with further values of the platform's
    chart; `agreed`: nobody is asked."""

    kubeconfig: str = ""
    context: str = ""
    registry: str = ""
    agents: Path = Path("agents.yaml")
    values: Path | None = None
    agreed: bool = False
    authority: Path | None = None


class GivenNodes:
    """The Nodes of one cluster that is there. `ask` shows a person what would be written, and gives the answer."""

    def __init__(self, given: GivenCluster, ask: Ask | None = None) -> None:
        self._given = given
        self._ask = ask or ask_on_terminal
        self._api = _connected(given)

    @property
    def context(self) -> str:
        """The context, which names a cluster for a person."""
        if self._given.context:
            return self._given.context
        return str(config.list_kube_config_contexts(self._given.kubeconfig or None)[1]["name"])

    def states(self) -> tuple[NodeState, ...]:
        """Those that are agents', by name."""
        return tuple(state for state in self.all_states() if state.agent)

    def all_states(self) -> tuple[NodeState, ...]:
        """All Nodes, by name, each for every one of its agents."""
        states = (state for item in self.objects() for state in node_states.node_states(item))
        return tuple(sorted(states, key=lambda one: (one.name, one.guest)))

    def labels(self) -> dict[str, Mapping[str, str]]:
        """The labels of all Nodes, by name."""
        return {one["metadata"]["name"]: one["metadata"].get("labels", {}) for one in self.objects()}

    def objects(self) -> list[Mapping[str, Any]]:
        """All Nodes as the API server has them."""
        answer = self._call("Nodes", client.CoreV1Api(self._api).list_node)
        return [self._api.sanitize_for_serialization(one) for one in answer.items]

    def planned(self, plan: Plan) -> tuple[NodeChange, ...]:
        """What the plan says of the Nodes as they are."""
        return plan(self.given())

    def given(self) -> list[GivenNode]:
        """All Nodes as they are, with what was added to them."""
        return [_given_node(one) for one in self.objects()]

    def agree(self, lines: Sequence[object]) -> None:
        """InputError unless somebody agrees that this is written."""
        host = self._api.configuration.host
        asked = "\n  ".join(
            [f"context {self.context} ({host}) was not made here. This would be written:", *map(str, lines)]
        )
        if not self._given.agreed and not self._ask(asked):
            raise InputError(
                f"context {self.context}: nothing was written, since nobody agreed; YES=1 agrees beforehand"
            )

    def write(self, plan: Plan, agreed: Sequence[NodeChange]) -> tuple[str, ...]:
        """Write what the plan says of the Nodes as they are, until it says nothing more; a line for each. What differs
        from what was `agreed` to is asked for again."""
        known = {change.node: change for change in agreed}
        written: dict[str, NodeChange] = {}
        for _ in range(ATTEMPTS_MAX):
            listed = self.objects()
            changes = plan([_given_node(one) for one in listed])
            if not changes:
                return tuple(map(str, written.values()))
            if any(known.get(change.node) != change for change in changes):
                self.agree(changes)
                known |= {change.node: change for change in changes}
            versions = {one["metadata"]["name"]: one["metadata"]["resourceVersion"] for one in listed}
            for change in changes:
                self._patch(change, versions[change.node])
                written[change.node] = change
        raise SetUpError(f"context {self.context}: Nodes change faster than they can be written; try again")

    def namespace(self, name: str) -> Mapping[str, Any]:
        """A namespace; empty when there is none."""
        read = client.CoreV1Api(self._api).read_namespace
        namespace = self._call(f"Namespace {name}", read, name, passing=NOT_FOUND)
        return self._api.sanitize_for_serialization(namespace) or {}

    def api_servers(self) -> frozenset[tuple[str, int]]:
        """Address and port of each API server to which the Service `kubernetes` leads."""
        read = functools.partial(client.DiscoveryV1Api(self._api).list_namespaced_endpoint_slice, **OF_API_SERVERS)
        slices = self._call("EndpointSlices of Service kubernetes", read, "default").items
        return frozenset(
            (address, port.port)
            for one in slices
            for endpoint in one.endpoints or ()
            for address in endpoint.addresses
            for port in one.ports or ()
        )

    def storage_classes(self) -> frozenset[str]:
        """The names of the cluster's StorageClasses."""
        answer = self._call("StorageClasses", client.StorageV1Api(self._api).list_storage_class)
        return frozenset(str(one.metadata.name) for one in answer.items)

    def _patch(self, change: NodeChange, version: str) -> None:
        """Write a change to a Node that is as it was read; nothing where somebody else was faster."""
        metadata = {"resourceVersion": version, "labels": change.labels, "annotations": change.annotations}
        patch = client.CoreV1Api(self._api).patch_node
        self._call(f"Node {change.node}", patch, change.node, {"metadata": metadata}, passing=CONFLICT)

    def _call(self, what: str, function: Any, *arguments: Any, passing: int = 0) -> Any:
        where = f"context {self.context}"
        try:
            return function(*arguments, _request_timeout=ANSWER_SECONDS_MAX)
        except client.ApiException as error:
            if error.status == passing:
                return None
            raise SetUpError(f"{where}: {what}: {error.status} {error.reason}: {error.body}") from error
        except (HTTPError, OSError) as error:
            raise SetUpError(f"{where}: {self._api.configuration.host} does not answer: {error}") from error


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
    except NO_KUBECONFIG as error:
        named = given.kubeconfig or "kubectl's kubeconfig"
        words = " ".join(str(error).split())
        raise InputError(f"{named}: is no kubeconfig ({words}); give KUBECONFIG and CONTEXT") from error
    api.configuration.retries = False
    return api


def _given_node(item: Mapping[str, Any]) -> GivenNode:
    metadata = item["metadata"]
    return GivenNode(metadata["name"], metadata.get("labels", {}), metadata.get("annotations", {}))
