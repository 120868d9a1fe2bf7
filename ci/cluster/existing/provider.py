"""A cluster that somebody else made: its Nodes become agents' when a person has agreed, the platform is installed on
it, scenarios run there, and everything that was added is taken away again."""

from __future__ import annotations

import functools
import os
import re
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from ci.cluster.api_server import node_states
from ci.cluster.existing import labels, mapping, registry, removing
from ci.cluster.existing.nodes import Ask, GivenCluster, GivenNodes
from ci.cluster.through_api_server.ways import ReachedThroughApiServer, values_of_built_images
from ci.cluster_contract import sharing
from ci.cluster_contract.provider import ChartProfile, NodeState
from ci.cluster_contract.topology import Topology, chart_agents
from ci.errors import InputError, SetUpError
from ci.folders import user_cache
from ci.images import image_lock
from ci.images.built import REPOSITORY
from ci.images.image_lock import Image
from ci.installation import ARGOCD, GATE, NAMESPACE, Installer
from robotkube.delivery.preflight.core.values import merged
from robotkube.foundation.kubernetes.core.node_agents import shared_nodes, trial_words

ADDED = {"robotkube.io/added": "demo"}  # annotation of namespaces that are made before the chart
COMMAND_SECONDS_MAX = 60
PAGE = "docs/how-to/use-a-cluster-that-is-there.md"


class Existing(ReachedThroughApiServer):
    """One cluster that is there. `ask` shows a person what would be written, and gives the answer; `binaries`: the tool
    chain's folder, which is looked for when nobody names it.

    A kind whose distribution is known says what it knows by `recognise`, `of_cluster` and the methods about images;
    here nothing is known."""

    kind = "existing"

    def __init__(self, given: GivenCluster, ask: Ask | None = None, binaries: Path = Path()) -> None:
        super().__init__(binaries)
        self._given = given
        self._nodes = GivenNodes(given, ask)

    @property
    def name(self) -> str:
        """The context, which names a cluster for a person."""
        return self._nodes.context

    @property
    def lacks(self) -> tuple[str, ...]:
        """See NodesProvider.lacks."""
        states = self.nodes() if self._agents().trial else ()
        return (
            self.lacking_images(),
            "bags and ledgers are copied by pods in the agents' namespaces, which the inspector names while they are "
            "there",
            "Nodes of the role platform get no taint: pods of others may run beside the platform's",
            "weights and outages of Nodes, conditions of the network, CPU time and admission from files are not there: "
            "the machines are not this provider's",
            *filter(None, (sharing.trial_of(states),)),
        )

    @property
    def values_file(self) -> Path:
        """Values for the platform's chart on this cluster, for who installs it without the demo."""
        return self.work() / "values.yaml"

    def take(self) -> tuple[str, ...]:
        """Make Nodes those of agents.yaml; what was written, a line for each Node. Values for the chart are written to
        `values_file`."""
        self.recognise()
        agents = self._agents()
        values = self._with_given(self._of_agents(agents))
        written = self._take(agents, ())
        self.values_file.parent.mkdir(parents=True, exist_ok=True)
        self.values_file.write_text(yaml.safe_dump(values), encoding="utf-8")
        return written

    def planned(self) -> tuple[str, ...]:
        """What `take` would write, a line for each Node."""
        self.recognise()
        agents = self._agents()
        changes = self._nodes.planned(lambda nodes: labels.adding(nodes, agents))
        return (*map(str, changes), *(self._trial(agents) if changes else ()))

    def up(self, topology: Topology, wanted: Sequence[Image]) -> None:
        """See Provider.up: its Nodes are taken, and whatever the installation adds is agreed to."""
        self.recognise()
        brought = self.images_to_bring(wanted)
        agents = self._agents()
        mapping.require_agents(agents, topology)
        self._take(agents, [*brought, *self._to_install()], wanted)
        self.bring_images(wanted)

    def lacking_images(self) -> str:
        """The sentence about images of application charts, and about those of publishers."""
        built = REPOSITORY.rpartition("/")[2]
        place = self._place()
        found = f"by a mirror of that name ({PAGE})"
        if place and place.rpartition("/")[2] != built:
            found = f"by no mirror of containerd, since REGISTRY {place} does not end with /{built} ({PAGE})"
        return (
            f"application charts name images as they were built: Nodes find these {found}, and what publishers push to "
            "the forge is not pulled"
        )

    def recognise(self) -> None:
        """InputError where the cluster is none of this kind; any is."""

    def images_to_bring(self, wanted: Sequence[Image]) -> list[str]:
        """What would be written to bring the images there, in words; nothing where Nodes pull all of them. InputError
        where they cannot be brought."""
        if not self._given.registry:
            raise InputError("REGISTRY=HOST/PATH is needed: from there the cluster pulls the platform's images")
        return []

    def bring_images(self, wanted: Sequence[Image]) -> None:
        """Bring the images there, once that was agreed to; Nodes pull them."""

    def brought(self) -> tuple[Path, ...]:
        """The files on machines of the cluster that brought images there."""
        return ()

    def of_cluster(self) -> Mapping[str, Any]:
        """What the chart is told of the cluster itself."""
        return {}

    def down(self) -> tuple[str, ...]:
        """See NodesProvider.down: first what was installed, then the labels of Nodes."""
        there = [name for name in (NAMESPACE, GATE, ARGOCD) if self._is_added(self._nodes.namespace(name))]
        changes = self._nodes.planned(labels.removing)
        files = self.brought()
        if there or changes or files:
            goes = [removing.goes(self._installer(), ADDED)] if there else []
            self._nodes.agree([*goes, *changes, *(f"file {file} goes" for file in files)])
        removed = removing.remove(self._installer(), ADDED) if there else ()
        written = self._nodes.write(labels.removing, changes)
        for file in (*files, self.values_file, self.work() / "kubeconfig"):
            file.unlink(missing_ok=True)
        return (*removed, *written, *(f"file {file}" for file in files))

    def kept(self) -> tuple[str, ...]:
        """See NodesProvider.kept."""
        return ("the cluster itself", "PersistentVolumes whose class retains them")

    def nodes(self) -> tuple[NodeState, ...]:
        """See NodesProvider.nodes: those that are agents', by name."""
        return self._nodes.states()

    def status(self) -> str:
        """See NodesProvider.status."""
        return node_states.nodes_table(self.nodes())

    def work(self) -> Path:
        """See Provider.work."""
        return user_cache() / self.kind / re.sub(r"[^A-Za-z0-9.-]", "_", self.name)

    def kubeconfig(self) -> Path:
        """See Provider.kubeconfig: a file with the one context alone."""
        return self._kubeconfig

    @functools.cached_property
    def _kubeconfig(self) -> Path:
        given, context = self._given.kubeconfig, self._given.context
        chosen = ["--context", context] if context else []
        command = [str(self.binaries / "kubectl"), "config", "view", "--minify", "--flatten", "--raw", *chosen]
        # as a variable it may name several files, which the option does not take
        own = {**os.environ, **({"KUBECONFIG": given} if given else {})}
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=COMMAND_SECONDS_MAX, check=False, env=own
        )
        if done.returncode:
            raise SetUpError(f"kubectl config view: {done.stderr.strip()}")
        self.work().mkdir(parents=True, exist_ok=True)
        file = self.work() / "kubeconfig"
        file.touch(mode=0o600)
        file.write_text(done.stdout, encoding="utf-8")
        return file

    def chart_profile(self) -> ChartProfile:
        """See Provider.chart_profile."""
        return ChartProfile((), self._values(self._agents()), self._place(), ADDED)

    def machines(self) -> None:
        """See Provider.machines: they are others'."""

    def pulls_from(self) -> tuple[str, Sequence[Mapping[str, str]]]:
        """See ReachedThroughApiServer.pulls_from."""
        return self._place(), self._values(self._agents()).get("imagePullSecrets", [])

    def _installer(self) -> Installer:
        return Installer(self.binaries, self.kubeconfig(), self.work(), ChartProfile(added=ADDED))

    def _agents(self) -> mapping.AgentsFile:
        return mapping.read(self._given.agents)

    def _place(self) -> str:
        return str(registry.place_of(self._given.registry)) if self._given.registry else ""

    def _values(self, agents: mapping.AgentsFile) -> dict[str, Any]:
        """What the chart is told of agents, registry and images that were built here, and upon it what the file of
        values says."""
        labelled = labels.wanted_labels(self._nodes.given(), agents) if agents.trial else {}
        shared = sharing.platform_values(labelled)
        return self._with_given({**self._of_agents(agents), **values_of_built_images(), **shared})

    def _of_agents(self, agents: mapping.AgentsFile) -> dict[str, Any]:
        """What the chart is told of agents, registry and cluster, whoever installs it."""
        place = self._place()
        pulled = {"global": {"imageRegistry": place}} if place else {}
        return {"agents": chart_agents(agents.entries), **pulled, **self.of_cluster()}

    def _with_given(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Values with those of the given file upon them."""
        return merged(values, mapping.read_values(self._given.values) if self._given.values else {})

    def _take(
        self, agents: mapping.AgentsFile, also: Sequence[str], wanted: Sequence[Image] | None = None
    ) -> tuple[str, ...]:
        """Write the labels of Nodes, once this and what comes `also` was agreed to."""

        def plan(nodes: Sequence[labels.GivenNode]) -> tuple[labels.NodeChange, ...]:
            return labels.adding(nodes, agents)

        if self._given.registry:
            built = image_lock.read_lock(image_lock.lock_file()) if wanted is None else wanted
            registry.require(self._given.registry, built, self._given.authority)
        changes = self._nodes.planned(plan)
        if changes or also:
            self._nodes.agree([*changes, *also, *self._trial(agents)])
        return self._nodes.write(plan, changes)

    def _trial(self, agents: mapping.AgentsFile) -> list[str]:
        """What has to be said of Nodes that agents are to share; nothing where none are."""
        labelled = labels.wanted_labels(self._nodes.given(), agents) if agents.trial else {}
        words = trial_words(shared_nodes(labelled.items()))
        return [words] if words else []

    def _to_install(self) -> list[str]:
        """What an installation adds, in words; nothing once it has begun. InputError where somebody else has one."""
        namespace = self._nodes.namespace(NAMESPACE)
        if self._is_added(namespace):
            return []
        if namespace:
            raise InputError(
                f"context {self.name}: namespace {NAMESPACE} is there and was not made here; its platform is upgraded "
                "with helm, or taken away first"
            )
        return [
            f"namespaces {NAMESPACE}, {GATE}, those of agents and of suites; the Helm release {NAMESPACE} with its "
            "definitions and roles of the whole cluster",
            f"Argo CD in namespace {ARGOCD} with its definitions, where there is none; one that is there gets an "
            "account, secrets of hooks, and a closed project default, until make down",
        ]

    @staticmethod
    def _is_added(namespace: Mapping[str, Any]) -> bool:
        annotations: Mapping[str, str] = namespace.get("metadata", {}).get("annotations", {})
        return ADDED.items() <= annotations.items()
