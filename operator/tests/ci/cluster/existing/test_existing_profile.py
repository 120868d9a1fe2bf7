"""What a cluster of others is told: its chart's values, from where it pulls, and what of a scenario it must have."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from ci.cluster.existing import mapping
from ci.cluster.existing.nodes import GivenCluster
from ci.cluster.existing.provider import Existing
from ci.cluster.existing.removing import KEPT_KINDS
from ci.cluster_contract import topology
from ci.cluster_contract.topology import Topology
from ci.errors import InputError, SetUpError
from ci.installation import Installer, moved
from tests.stages.paths import REPOSITORY, SCENARIOS
from tests.stages.programs import program

SCENARIO = SCENARIOS / "pose-point-cloud-db-recording" / "scenario.yaml"
GOLDEN = REPOSITORY / "operator/tests/charts/golden"
POLICY = "helm.sh/resource-policy"
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
AGENTS = """
agents:
- {node: a, role: platform, agent: platform}
- {node: b, role: cloud, agent: cloud-0, capabilities: [recording]}
"""


@pytest.fixture
def wanted() -> Topology:
    return topology.read(SCENARIO, {"vehicles": "1"})


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Existing]:
    """One that is reached by its file alone: nothing of this asks it."""
    document = {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [{"name": "theirs", "cluster": {"server": "https://192.0.2.1:6443"}}],
        "users": [{"name": "theirs", "user": {"token": "t"}}],
        "contexts": [{"name": "theirs", "context": {"cluster": "theirs", "user": "theirs"}}],
        "current-context": "theirs",
    }
    (tmp_path / "kubeconfig").write_text(yaml.safe_dump(document))
    (tmp_path / "agents.yaml").write_text(AGENTS)
    (tmp_path / "values.yaml").write_text("storage: {className: fast}\nplatform: {tolerations: [{operator: Exists}]}\n")
    given = GivenCluster(
        str(tmp_path / "kubeconfig"),
        registry="registry.example.com/robots/robotkube",
        agents=tmp_path / "agents.yaml",
        values=tmp_path / "values.yaml",
    )
    provider = Existing(given)
    yield provider
    provider._nodes._api.close()


class Elsewhere(Installer):
    """A cluster with Argo CD's definitions, and without a namespace argocd."""

    def kubectl(self, *arguments: str, text: str | None = None, seconds: int = 60) -> str:
        assert arguments[0] == "get", arguments
        return "\n".join(arguments[1:4]).replace("crd", "customresourcedefinition") if "crd/" in arguments[1] else ""


def test_an_argo_cd_elsewhere_is_not_taken_for_none(cluster: Existing) -> None:
    installer = Elsewhere(Path(), Path(), Path(), cluster.chart_profile())
    with pytest.raises(SetUpError, match=r"there is no namespace argocd: .* its namespace in argocd.namespace"):
        installer.argocd({})


def test_the_chart_is_told_agents_registry_and_what_the_file_says(cluster: Existing) -> None:
    profile = cluster.chart_profile()
    assert profile.files == ()
    assert profile.registry == "registry.example.com/robots/robotkube"
    assert profile.added, "what is without its mark is somebody else's"
    values = profile.values
    assert values["global"] == {"imageRegistry": "registry.example.com/robots/robotkube"}
    assert values["agents"] == [{"name": "cloud-0", "role": "cloud", "records": True}]
    assert values["database"]["kind"] == "ferretdb"
    assert values["storage"] == {"className": "fast"}
    assert values["platform"] == {
        "nodeSelector": {"robotkube.io/role": "platform"},
        "tolerations": [{"operator": "Exists"}],
    }
    assert cluster.machines() is None
    assert any("mirror" in text for text in cluster.lacks)


def test_agents_of_a_scenario_that_have_no_node_are_named(cluster: Existing, wanted: Topology) -> None:
    with pytest.raises(InputError, match=r"agents.yaml: the scenario needs Nodes of vehicle-00 \(role vehicle, capab"):
        cluster.up(wanted, ())
    others = Topology(tuple(n for n in wanted.nodes if n.role != "vehicle"))
    mapping.require_agents(cluster._agents(), others)


def test_without_a_registry_there_is_no_installation(cluster: Existing, wanted: Topology, tmp_path: Path) -> None:
    bare = Existing(GivenCluster(str(tmp_path / "kubeconfig"), agents=tmp_path / "agents.yaml"))
    with pytest.raises(InputError, match=r"REGISTRY=HOST/PATH is needed"):
        bare.up(wanted, ())
    bare._nodes._api.close()


@pytest.mark.parametrize(
    ("text", "problem"),
    [(None, r"cannot be read.*VALUES"), ("{", "is not YAML"), ("- a", "must be a mapping, as a file of values")],
)
def test_a_file_of_values_that_is_none_is_refused(tmp_path: Path, text: str | None, problem: str) -> None:
    if text is not None:
        (tmp_path / "v.yaml").write_text(text)
    with pytest.raises(InputError, match=problem):
        mapping.read_values(tmp_path / "v.yaml")


def test_images_are_pulled_from_the_registry_by_their_digests() -> None:
    built = "forge.robotkube.svc.cluster.local:3000/robotkube/argocd@sha256:1"
    assert moved(built, "registry.example.com/r") == "registry.example.com/r/argocd@sha256:1"
    assert moved(built, "") == built


def test_every_kind_that_helm_keeps_is_removed() -> None:
    golden = (GOLDEN / f"{name}.yaml" for name in ("embedded", "official"))
    objects = [one for file in golden for one in yaml.load_all(file.read_text(), Loader=LOADER) if one]
    kept = {one["kind"] for one in objects if one["metadata"].get("annotations", {}).get(POLICY) == "keep"}
    assert kept
    assert kept <= set(KEPT_KINDS)


class OneNamespace(Installer):
    """An installer that notes what it applies."""

    applied = ""

    def kubectl(self, *arguments: str, text: str | None = None, seconds: int = 60) -> str:
        type(self).applied = text or ""
        return ""


def test_namespaces_that_are_made_have_the_mark_of_it(cluster: Existing) -> None:
    OneNamespace(Path(), Path(), Path(), cluster.chart_profile()).namespace("robotkube", {"a": "b"}, {"c": "d"})
    metadata = yaml.safe_load(OneNamespace.applied)["metadata"]
    assert metadata["annotations"] == {"c": "d", "robotkube.io/added": "demo"}


@pytest.mark.toolchain
def test_a_kubeconfig_may_be_several_files_and_a_context_have_spaces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As kubectl takes them in KUBECONFIG; one that is not there is passed over."""
    binaries = Path(program("kubectl")).parent
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    name, server = "my team's context", "https://192.0.2.1:6443"
    own = {"contexts": [{"name": name, "context": {"cluster": "theirs", "user": "theirs"}}]}
    theirs = {
        "clusters": [{"name": "theirs", "cluster": {"server": server}}],
        "users": [{"name": "theirs", "user": {"token": "t"}}],
    }
    head = {"apiVersion": "v1", "kind": "Config"}
    files = [tmp_path / "own", tmp_path / "their files" / "config", tmp_path / "nowhere"]
    files[1].parent.mkdir()
    for file, document in zip(files, (own, theirs), strict=False):
        file.write_text(yaml.safe_dump({**head, **document}))
    cluster = Existing(GivenCluster(os.pathsep.join(map(str, files)), name), binaries=binaries)
    assert cluster.name == name
    written = yaml.safe_load(cluster.kubeconfig().read_text())
    assert written["current-context"] == name
    assert [one["cluster"]["server"] for one in written["clusters"]] == [server]


def test_a_registry_where_no_mirror_finds_images_of_charts_is_named(cluster: Existing, tmp_path: Path) -> None:
    assert "find these by a mirror of that name (docs/" in cluster.lacking_images()
    elsewhere = replace(cluster._given, registry="registry.example.com/robots/fleet")
    words = Existing(elsewhere).lacking_images()
    assert (
        "by no mirror of containerd, since REGISTRY registry.example.com/robots/fleet does not end with /robotkube"
        in words
    )
