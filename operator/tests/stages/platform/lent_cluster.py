"""A cluster that somebody lends: others made it, its Nodes become agents' for a time, and it is given back as it was.
What tests do with one, wherever its API server is reached from."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import yaml

from ci import bundle, evidence, oras, publish
from ci.cluster.embedded.nodes import pulling
from ci.cluster_contract.topology import NodeSpec, Topology
from ci.images import preparation
from ci.images.services import SERVICE_NAMES
from robotkube.registry.bundles.core.contents import IMAGE
from robotkube.registry.publication.adapters import submission_folders

BUILT_AS = pulling.REGISTRY
PATH = "fleet/robotkube"  # its last part is that of the names that images were built with
FORGE = f"{BUILT_AS}/robotkube"
ANSWER_SECONDS_MAX, PUSH_SECONDS_MAX, DEMO_SECONDS_MAX, DOWN_SECONDS_MAX = 60, 300, 1200, 300
SETTLE_SECONDS_MAX, POLL_SECONDS = 120, 1
WORDS_MAX = 4000
EXPECTED_TO_RUN = {"platform", "mosquitto", "gitea", "ferretdb", "argocd", "mqtt-bridge", "event-detector"}
PASSING = {
    "leases.coordination.k8s.io",
    "events",
    "events.events.k8s.io",
    "endpoints",
    "endpointslices.discovery.k8s.io",
}
RETAINED = "persistentvolumes "  # their class retains them, with whose they were
REVISIONS = "deployment.kubernetes.io/revision"  # so begin annotations that count the restarts of a Deployment
Objects = dict[str, Any]


class Attempt(Protocol):
    """Runs a command in the project's folder, from where the cluster's API server is reached."""

    def __call__(self, *command: str, seconds: float) -> subprocess.CompletedProcess[str]: ...


@dataclass(frozen=True)
class LentCluster:
    """One that runs, as its owner knows it: `kubectl` with what names it, `registry` (host and port) from which its
    Nodes pull and who signed that one's certificate, `agents` a file that says which of its Nodes are whose."""

    kubectl: tuple[str, ...]
    kubeconfig: Path
    registry: str
    authority: Path
    agents: Path
    attempt: Attempt

    @property
    def place(self) -> str:
        """HOST/PATH, from where it pulls."""
        return f"{self.registry}/{PATH}"

    @property
    def shares(self) -> bool:
        """Whether agents share its Nodes."""
        return bool(yaml.safe_load(self.agents.read_text(encoding="utf-8")).get("trial", False))

    def ask(self, *words: str, text: str | None = None, seconds: float = ANSWER_SECONDS_MAX) -> str:
        """What kubectl prints; fails with what it says."""
        done = subprocess.run(
            [*self.kubectl, *words], input=text, capture_output=True, text=True, timeout=seconds, check=False
        )
        assert done.returncode == 0, f"kubectl {' '.join(words[:4])}: {done.stderr[-WORDS_MAX:]}"
        return done.stdout

    def demo(self, **variables: str) -> str:
        """What `make demo` prints, which is told from where Nodes pull and whose they are."""
        known = {"REGISTRY": self.place, "REGISTRY_CA": str(self.authority), "AGENTS": str(self.agents)}
        return self._make("demo", DEMO_SECONDS_MAX, **known, **variables)

    def down(self) -> str:
        """What `make down` prints."""
        return self._make("down", DOWN_SECONDS_MAX)

    def bring_bundle(self, archive: Path, keep: bool = False) -> dict[str, str]:
        """Write the platform's bundle, push it to the registry, and take the file away unless it is to be kept; the
        digest of each image in it, by name."""
        prepared = preparation.everything()
        charts = submission_folders.all_charts(publish.CHARTS)
        submitted = publish.read_all(prepared.references(), evidence.kept_folder(), charts)
        manifests = bundle.argocd_manifests(prepared.references())
        contents = bundle.write(archive, prepared.images, submitted, manifests)
        words = ["--to", self.place, "--ca", str(self.authority), "--oras", str(oras.ensure() / "oras")]
        self._run("ci/python", "-m", "robotkube.cli", "bundle", "push", str(archive), *words, seconds=PUSH_SECONDS_MAX)
        if not keep:
            archive.unlink()
        return {item.name: item.digest for item in contents.of(IMAGE)}

    def _make(self, target: str, seconds: float, **variables: str) -> str:
        reached = {"CLUSTER": "existing", "KUBECONFIG": str(self.kubeconfig), "YES": "1"}
        words = [f"{name}={value}" for name, value in {**reached, **variables}.items()]
        return self._run("make", target, *words, seconds=seconds)

    def _run(self, *command: str, seconds: float) -> str:
        done = self.attempt(*command, seconds=seconds)
        assert done.returncode == 0, done.stdout[-WORDS_MAX:] + done.stderr[-WORDS_MAX:]
        return done.stdout


def two_machines(topology: Topology) -> list[list[NodeSpec]]:
    """One machine for platform and cloud, one for all vehicles."""
    vehicles = [node for node in topology.nodes if node.role == "vehicle"]
    return [[node for node in topology.nodes if node not in vehicles], vehicles]


def write_agents(file: Path, machines: Mapping[str, Sequence[NodeSpec]]) -> None:
    """Write which Nodes (by name) stand for which nodes of a scenario: in trial mode where one stands for several."""
    entries = [
        {"node": name, "role": one.role, "agent": one.agent, "capabilities": list(one.capabilities)}
        for name, own in machines.items()
        for one in own
    ]
    trial = {"trial": True} if len(entries) > len(machines) else {}
    file.write_text(yaml.safe_dump({**trial, "agents": entries}), encoding="utf-8")


def believe(hosts: Path, registry: str, authority: Path) -> None:
    """Tell the containerd of Nodes, by its folder of hosts, who signs for the registry, and that it has the images of
    another name, too: what an administrator writes once."""
    text = authority.read_text(encoding="ascii")
    for name, path in ((registry, ""), (BUILT_AS, f"/v2/{PATH.rpartition('/')[0]}")):
        place = hosts / pulling.host_folder(name)
        place.mkdir(parents=True, exist_ok=True)
        (place / "ca.crt").write_text(text, encoding="ascii")
        lines = [f'[host."https://{registry}{path}"]', 'capabilities = ["pull", "resolve"]', 'ca = "ca.crt"']
        lines += ["override_path = true"] if path else []
        (place / "hosts.toml").write_text("\n".join([*lines, ""]), encoding="utf-8")


def require_digests(cluster: LentCluster, bundled: Mapping[str, str], of_its_own: Collection[str] = ()) -> None:
    """Fail where a container has another image than the bundle, as each runtime says what its containers' images are:
    the platform's by the names of the registry, those of applications by that of the forge, to which a publication
    brings what it verified. Not judged are the namespaces that are the cluster's own."""
    pods = json.loads(cluster.ask("get", "pods", "-A", "-o", "json"))["items"]
    statuses = [pod["status"] for pod in pods if pod["metadata"]["namespace"] not in of_its_own]
    kinds = ("containerStatuses", "initContainerStatuses")
    runs = {one["imageID"] for status in statuses for kind in kinds for one in status.get(kind, ()) if one["imageID"]}
    names = {place.partition("@")[0].rpartition("/")[2] for place in runs}
    assert names >= EXPECTED_TO_RUN, runs
    by_forge = {name for name in names if name in SERVICE_NAMES}
    places = {name: FORGE if name in by_forge else cluster.place for name in names}
    assert by_forge
    assert runs == {f"{places[name]}/{name}@{bundled.get(name)}" for name in names}


def settled_objects(cluster: LentCluster) -> Objects:
    """Every object, once two readings in a row are the same."""
    end = time.monotonic() + SETTLE_SECONDS_MAX
    last, now = _objects(cluster), _objects(cluster)
    while changed := _differences(last, now):
        assert time.monotonic() < end, f"the cluster changes by itself:\n{_said(changed)}"
        time.sleep(POLL_SECONDS)
        last, now = now, _objects(cluster)
    return now


def require_as_before(cluster: LentCluster, before: Objects) -> None:
    """Fail with every object that is not as it was: restarts of what was given back, and volumes, take a while."""
    end = time.monotonic() + SETTLE_SECONDS_MAX
    while changed := _differences(before, _objects(cluster)):
        assert time.monotonic() < end, f"not as before:\n{_said(changed)}"
        time.sleep(POLL_SECONDS)


def _differences(before: Objects, after: Objects) -> Objects:
    """What each object that differs was, and what it is."""
    names = sorted(name for name in before | after if before.get(name) != after.get(name))
    return {name: (before.get(name), after.get(name)) for name in names}


def _said(changed: Objects) -> str:
    """A line for each object, whole: a failure cuts what is no text."""
    return "\n".join(f"{name}: was {was}, is {now}" for name, (was, now) in changed.items())


def _objects(cluster: LentCluster) -> Objects:
    """Every object by kind, namespace and name, without its status, what counts its versions, and what comes and goes,
    and of PersistentVolumes only that they are there."""
    kinds = cluster.ask("api-resources", "--verbs=list", "-o", "name").split()
    objects: Objects = {}
    for kind in (kind for kind in kinds if kind not in PASSING):
        for item in json.loads(cluster.ask("get", kind, "-A", "-o", "json"))["items"]:
            if _is_past(item):
                continue
            name = _name(kind, item, objects)
            objects[name] = "kept" if name.startswith(RETAINED) else _content(kind, item)
    return objects


def _owner(item: Mapping[str, Any]) -> str:
    return next((one["kind"] for one in item["metadata"].get("ownerReferences", ()) if one.get("controller")), "")


def _is_past(item: Mapping[str, Any]) -> bool:
    """Whether it is the set of pods of a Deployment before a restart, which is kept to go back to."""
    return _owner(item) == "Deployment" and item.get("spec", {}).get("replicas") == 0


def _is_replaced(kind: str, item: Mapping[str, Any]) -> bool:
    """Whether it is a pod of a Deployment, in whose place another one comes with each restart."""
    return kind == "pods" and _owner(item) == "ReplicaSet"


def _name(kind: str, item: Mapping[str, Any], taken: Collection[str]) -> str:
    """What names it whenever it is looked at: a pod of a Deployment by its set and a number."""
    metadata = item["metadata"]
    place = f"{kind} {metadata.get('namespace', '')}/"
    if not _is_replaced(kind, item):
        return f"{place}{metadata['name']}"
    numbered = (f"{place}{metadata['generateName']}{number}" for number in range(len(taken) + 1))
    return next(name for name in numbered if name not in taken)


def _content(kind: str, item: Mapping[str, Any]) -> list[Any]:
    metadata = item["metadata"]
    annotations = metadata.get("annotations", {}).items()
    counted = {key: value for key, value in annotations if not key.startswith(REVISIONS)}
    kept = {**{key: metadata.get(key) for key in ("labels", "finalizers")}, "annotations": counted or None}
    if _is_replaced(kind, item):
        return [kept, [one["image"] for one in item["spec"]["containers"]]]
    return [kept, {key: value for key, value in item.items() if key not in ("metadata", "status")}]
