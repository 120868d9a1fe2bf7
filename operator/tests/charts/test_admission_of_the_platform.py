"""The whole platform under admission, on an API server with its controllers and without nodes: installed as `make demo`
does it, nothing of it is refused, nor of what suites try and releases run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci import evidence
from ci.cluster.embedded import first_objects
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.admission.catalogue_on_disk import CatalogueOnDisk
from ci.cluster.embedded.admission.stranded import report
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster.embedded.nodes import node_processes
from ci.cluster.embedded.provider import Embedded
from ci.cluster_contract import topology
from ci.errors import SetUpError
from ci.images.image_lock import Image
from ci.installation import PLATFORM_IMAGES, Installer, platform_values
from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing, PolicyReconciler
from robotkube.registry.evidence.adapters.dsse import TrustedKeys
from robotkube.registry.suites.core.namespace_contents import HelperPod, placed
from tests.charts.conftest import APP_CHARTS, CHARTS, PLATFORM, PROFILES, Helm, Rendered
from tests.ci.cluster.embedded.admission.test_admission import SCENARIO, Forge
from tests.stages.kubernetes.controllers import controlling
from tests.stages.kubernetes.installed_chart import Cluster, prepared_cluster
from tests.stages.programs import program
from tests.stages.registry.admission_examples import APPLICATION_CONTROLLER, SUITE_RUNNER, image
from tests.stages.registry.signed_evidence import artefact, catalogue, published
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain, pytest.mark.thorough]  # on the platform in every run
NAMES = (*PLATFORM_IMAGES, "argocd", "redis", "pause")
LOCK = tuple(Image(name, image(100 + number), Path(name)) for number, name in enumerate(NAMES))
REFERENCES = {one.name: one.reference for one in LOCK}
AGENT, TESTS = "vehicle-00", "robotkube-suite-0"


class WithoutNodes(Installer):
    """Installs without waiting for what runs, and without Jobs, which would be waited for, too."""

    def rollout(self, namespace: str) -> None:
        """Nothing becomes ready without nodes."""

    def helm(self, *arguments: str, seconds: int = 60) -> str:
        """Run helm without hooks."""
        return super().helm(*arguments, "--no-hooks", seconds=seconds)


@dataclass(frozen=True)
class Calls:
    """The API server as the provider and `--dry-run` see it."""

    cluster: Cluster

    def get(self, path: str) -> dict[str, Any]:
        done = self.cluster.run("kubectl", "get", "--raw", path)
        if done.returncode:
            raise SetUpError(f"GET {path}: 404 {done.stderr}")
        return dict(json.loads(done.stdout))

    def apply(self, path: str, manifest: dict[str, Any]) -> None:
        self.cluster.kubectl("apply", "--server-side", "-f", "-", text=json.dumps(manifest))


@dataclass(frozen=True)
class Demo:
    """A cluster under admission with the platform on it, and what follows its catalogue."""

    cluster: Cluster
    folders: ClusterFolders
    installer: Installer
    wanted: topology.Topology
    forge: Forge
    reconciler: PolicyReconciler

    def install(self) -> None:
        self.installer.argocd(REFERENCES)
        self.installer.platform(REFERENCES, self.wanted)

    def apply(self, namespace: str, account: str, *documents: Any) -> str:
        """Server-side apply as an account, with its rights; what was refused, or empty."""
        text = yaml.safe_dump_all(documents)
        apply = ("apply", "--server-side", "-n", namespace, "--as", account, "-f", "-")
        done = self.cluster.run("kubectl", *apply, text=text)
        return done.stderr if done.returncode else ""

    def without_pods(self) -> list[str]:
        """Workloads that have not made all their pods."""
        listed = self.cluster.kubectl("get", "deployments,statefulsets,replicasets,jobs", "-A", "-o", "json")
        return [
            f"{one['kind']} {one['metadata']['namespace']}/{one['metadata']['name']}"
            for one in json.loads(listed)["items"]
            if one["status"].get("replicas", one["status"].get("active", 0)) != one["spec"].get("replicas", 1)
        ]

    def refusals(self) -> list[str]:
        """What controllers were refused."""
        events = json.loads(self.cluster.kubectl("get", "events", "-A", "-o", "json"))["items"]
        return [event["message"] for event in events if "denied" in event["message"]]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    folder = tmp_path_factory.mktemp("demo")
    binaries = Path(program("kubectl")).parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        folders = ClusterFolders("demo")
        wanted = topology.read(SCENARIO, {"vehicles": "2"})
        options = admission_files.prepare(folders, wanted, LOCK)
        with prepared_cluster(folder, options=options, kinds=()) as cluster, controlling(folder, cluster.kubeconfig):
            nodes = node_processes.nodes_of(wanted.nodes, plan_of(folders.name), folders)
            first_objects.create(Calls(cluster), nodes)  # type: ignore[arg-type]
            own = admission_files.folder(folders)
            profile = Embedded(folders.name, binaries).chart_profile()
            forge = Forge(folder / "forge")
            on_disk = CatalogueOnDisk(lambda: forge.repositories, own / "clones")
            reconciler = admission_files.policy_reconciler(
                folders, CatalogueListing(on_disk, TrustedKeys(own / "keys"))
            )
            installer = WithoutNodes(binaries, cluster.kubeconfig, folder, profile)
            stage = Demo(cluster, folders, installer, wanted, forge, reconciler)
            stage.install()
            yield stage


def test_every_workload_of_the_platform_gets_its_pods(demo: Demo, helm: Helm) -> None:
    """Argo CD's and the platform's, its Jobs among them; and again when it is installed on top."""
    values = platform_values(REFERENCES, demo.wanted)
    jobs = helm.template(PLATFORM, PLATFORM / "values-embedded.yaml", **values).of_kind("Job")
    components = {job["metadata"]["labels"]["app.kubernetes.io/component"] for job in jobs}
    assert components == {"bootstrap", "gate-key", "installation-test", "teardown"}
    for job in jobs:
        demo.cluster.kubectl("apply", "-f", "-", text=yaml.safe_dump(job))
    until(lambda: not demo.without_pods(), f"pods of all workloads; {demo.without_pods()}")
    pods = json.loads(demo.cluster.kubectl("get", "pods", "-A", "-o", "json"))["items"]
    assert {pod["metadata"]["namespace"] for pod in pods} >= {"robotkube", "argocd"}
    assert len(pods) >= 13
    demo.install()
    until(lambda: not demo.without_pods(), "pods of all workloads, installed again")
    assert demo.refusals() == []


def test_what_the_suite_runner_tries_runs_by_its_own_account(demo: Demo, helm: Helm) -> None:
    helper = HelperPod("suite-observer", REFERENCES["suites"], "cloud-0", 7).document()
    demo.cluster.kubectl("create", "-n", TESTS, "--as", SUITE_RUNNER, "-f", "-", text=yaml.safe_dump(helper))
    rendered = helm.template(CHARTS / "apps" / "event-detector", PROFILES / "event-detector.yaml", release="subject")
    agent = rendered.pods[0][1]["nodeSelector"]["robotkube.io/agent"]
    tried = [placed(item, TESTS, 7, agent) for item in rendered.of_kind("ConfigMap", "Deployment")]
    assert demo.apply(TESTS, SUITE_RUNNER, *tried) == ""
    until(lambda: not demo.without_pods(), "its pods")
    demo.cluster.kubectl("delete", "-n", TESTS, "--as", SUITE_RUNNER, "pod/suite-observer", "--wait=false")
    demo.cluster.kubectl("delete", "-n", TESTS, "--as", SUITE_RUNNER, "deployment/subject", "--wait=false")
    assert demo.refusals() == []


def test_every_chart_runs_on_an_agent_once_it_is_published(demo: Demo, helm: Helm) -> None:
    """Applied as Argo CD does: by the server, with the rights of its application controller."""
    rendered = {chart: of_release(helm, chart) for chart in APP_CHARTS}
    applied = {chart: one.objects for chart, one in rendered.items()}
    images = {chart: image_of(one) for chart, one in rendered.items()}
    assert len(set(images.values())) == len(APP_CHARTS)
    refused = demo.apply(AGENT, APPLICATION_CONTROLLER, *applied[APP_CHARTS[0]])
    assert f"image {images[APP_CHARTS[0]]} may not run in namespace {AGENT}" in refused
    demo.forge.install()
    demo.forge.publish(catalogue(published(evidence.signing_key(), artefact("app"), images=tuple(images.values()))))
    assert demo.reconciler.step()
    until(lambda: not demo.apply(AGENT, APPLICATION_CONTROLLER, *applied[APP_CHARTS[0]]), "the list is at work")
    for chart in APP_CHARTS[1:]:
        assert demo.apply(AGENT, APPLICATION_CONTROLLER, *applied[chart]) == ""
    until(lambda: not demo.without_pods(), "pods of all releases")
    pods = json.loads(demo.cluster.kubectl("get", "pods", "-n", AGENT, "-o", "json"))["items"]
    assert len(pods) == len(APP_CHARTS)
    assert demo.refusals() == []


def of_release(helm: Helm, chart: str) -> Rendered:
    """A release of a chart, which is a ConfigMap and a Deployment."""
    rendered = helm.template(CHARTS / "apps" / chart, PROFILES / f"{chart}.yaml", release=f"a-{chart}")
    assert rendered.of_kind("ConfigMap", "Deployment") == rendered.objects
    return rendered


def image_of(rendered: Rendered) -> str:
    """The one image of a release."""
    [(_, pod)] = rendered.pods
    [container] = pod["containers"]
    return str(container["image"])


def test_nothing_of_it_would_be_stranded(demo: Demo) -> None:
    """What `--dry-run` says of the same cluster; the forge's volume is found by its claim, which has none here."""
    stranded = report(Calls(demo.cluster), demo.folders, demo.wanted, LOCK)
    releases = [one for one in stranded.stranded if one.namespace != AGENT]
    assert releases == []
