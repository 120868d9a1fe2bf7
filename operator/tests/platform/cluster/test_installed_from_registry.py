"""Argo CD and the platform installed on a cluster of others from a bundle in a registry, by the commands of the page
about it: Helm fetches the chart from there, and Nodes every image."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from ci.cluster_contract import topology
from ci.cluster_contract.topology import Topology, chart_agents
from ci.folders import PROJECT
from ci.images import preparation
from ci.installation import ARGOCD, GATE, NAMESPACE
from robotkube import VERSION
from tests.stages.paths import DOCS
from tests.stages.platform.cluster_of_others import each_alone, made
from tests.stages.platform.lent_cluster import LentCluster
from tests.stages.platform.running_platform import NAME, SCENARIO

pytestmark = pytest.mark.thorough

PAGE = DOCS / "how-to" / "install-from-a-bundle.md"
WRITTEN = "registry.example.com/robots/robotkube"
COMMANDS_SECONDS_MAX = 600
WORDS_MAX = 3000
CONSOLE = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OF_PLATFORM = {"platform", "suites", "mosquitto", "gitea", "ferretdb", "argocd", "redis"}


def commands(heading: str) -> str:
    """The commands below a heading of the page, up to the next one, as a person pastes them."""
    text = PAGE.read_text(encoding="utf-8")
    _, _, below = text.partition(f"\n## {heading}\n")
    blocks = CONSOLE.findall(below.partition("\n## ")[0])
    assert blocks, heading
    return re.sub(r"^\$ ", "", "".join(blocks), flags=re.MULTILINE)


@dataclass(frozen=True)
class Installed:
    """The cluster, what the commands printed, and the digest of each image of the bundle."""

    cluster: LentCluster
    said: str
    bundled: dict[str, str]


@pytest.fixture(scope="module")
def installed(no_demo: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installed]:
    """With the fleet of a small scenario, whose Nodes got their labels by hand."""
    prepared = preparation.everything()
    folder = tmp_path_factory.mktemp("installed")
    nodes = topology.read(SCENARIO / "scenario.yaml", {"vehicles": "1"})
    with made(NAME, prepared.binaries, each_alone(nodes), prepared.images, tmp_path_factory.mktemp("others")) as lent:
        label(lent, nodes)
        (folder / "agents.yaml").write_text(yaml.safe_dump({"agents": chart_agents(nodes.nodes)}))
        bundled = lent.bring_bundle(folder / f"robotkube-{VERSION}.tar", keep=True)
        yield Installed(lent, paste(lent, prepared.binaries, folder), bundled)


def label(cluster: LentCluster, nodes: Topology) -> None:
    """Make each machine the Node that it was made for."""
    for number, node in enumerate(nodes.nodes):
        roles = [f"robotkube.io/role={node.role}", f"robotkube.io/agent={node.agent}"]
        cluster.ask("label", "node", f"machine-{number}", *roles)


def paste(cluster: LentCluster, binaries: Path, folder: Path) -> str:
    """Run the page's commands in one shell, with this registry, which an authority of its own signed for; what they
    print."""
    text = commands("Install Argo CD") + commands("Install the platform")
    assert f"--version {VERSION} " in text
    text = text.replace(WRITTEN, cluster.place)
    text = text.replace("helm install ", f"helm install --ca-file {cluster.authority} ")
    own = f'robotkube() {{ (cd "{PROJECT}" && ci/python -m robotkube.cli "$@"); }}\n'
    text = text.replace(f"robotkube-{VERSION}.tar", str(folder / f"robotkube-{VERSION}.tar"))
    surroundings = {**os.environ, "KUBECONFIG": str(cluster.kubeconfig), "PATH": f"{binaries}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", own + text],
        cwd=folder, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        timeout=COMMANDS_SECONDS_MAX, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{text}\n{done.stdout[-WORDS_MAX:]}"
    return done.stdout


def test_helm_has_installed_the_chart_of_the_registry(installed: Installed) -> None:
    """And the last command of the page has waited until everything is ready."""
    assert "STATUS: deployed" in installed.said
    everything = rf"^robotkube: ready: all \d+ components in {NAMESPACE}, {GATE}, {ARGOCD}$"
    assert re.search(everything, installed.said, re.MULTILINE), installed.said[-WORDS_MAX:]
    release = f"app.kubernetes.io/managed-by=Helm,helm.sh/chart=robotkube-{VERSION}"
    names = installed.cluster.ask(
        "-n", NAMESPACE, "get", "deployments,statefulsets", "-l", release, "-o", "name"
    ).split()
    wanted = {
        "manager",
        "broker",
        "database",
        "forge",
        "console",
        "suite-runner",
        "inspector",
        "certificates",
        "rights",
    }
    assert wanted <= {name.rpartition("/")[2] for name in names}


def test_every_image_came_from_there(installed: Installed) -> None:
    pods = json.loads(installed.cluster.ask("get", "pods", "-A", "-o", "json"))["items"]
    statuses = [pod["status"] for pod in pods if pod["metadata"]["namespace"] in (NAMESPACE, GATE, ARGOCD)]
    kinds = ("containerStatuses", "initContainerStatuses")
    runs = {one["imageID"] for status in statuses for kind in kinds for one in status.get(kind, ()) if one["imageID"]}
    names = {place.partition("@")[0].rpartition("/")[2] for place in runs}
    assert names >= OF_PLATFORM, runs
    assert runs == {f"{installed.cluster.place}/{name}@{installed.bundled[name]}" for name in names}
