"""`robotkube registry admission --stranded` on a real API server: what would not start again, before it is enforced."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli.main import main
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from tests.cli.test_admission_list import push
from tests.stages.kubernetes.judged_api_server import Api, judged_api_server
from tests.stages.registry.admission_examples import (
    APPLICATIONS,
    CHART,
    CHARTS,
    PROJECTS,
    application,
    image,
    path,
    workload,
)
from tests.stages.registry.signed_evidence import artefact, catalogue, published, signing_key, trusting

pytestmark = pytest.mark.toolchain
CONFIG_MAPS = "/api/v1/namespaces/robotkube/configmaps"


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """A platform without admission, with an agent, and Argo CD by a tag as its own manifests have it."""
    with judged_api_server(tmp_path_factory.mktemp("api"), None) as (server, _):
        gate = {"app.kubernetes.io/part-of": "robotkube", "app.kubernetes.io/component": "gate"}
        agent = {"robotkube.io/agent": "vehicle-00"}
        for name, labels in (("robotkube", {}), ("signing", gate), ("argocd", {}), ("vehicle-00", agent)):
            server.done("POST", "/api/v1/namespaces", {"metadata": {"name": name, "labels": labels}})
        images = {"images.yaml": write_mapping({"platform": image(2), "ros": image(4), "mongo": "mongo:8"})}
        server.done("POST", CONFIG_MAPS, {"metadata": {"name": "platform-images"}, "data": images})
        head = {"apiVersion": "argoproj.io/v1alpha1", "kind": "AppProject", "metadata": {"name": "robotkube-apps"}}
        server.done("POST", PROJECTS, {**head, "spec": {"sourceRepos": [f"{CHARTS}/*"]}})
        server.done("POST", path("Deployment", "robotkube"), workload("Deployment", image(2)))
        server.done("POST", path("Deployment", "argocd"), workload("Deployment", "quay.io/argoproj/argocd:v3"))
        server.done("POST", path("Deployment", "vehicle-00"), workload("Deployment", image(1)))
        yield server


@pytest.fixture
def arguments(api: Api, tmp_path: Path) -> list[str]:
    """The command, and a catalogue in which one chart of one image is verified."""
    (tmp_path / "password").write_text("word\n")
    bare = tmp_path / "robotkube" / "catalogue.git"
    subprocess.run(["git", "init", "-q", "--bare", "-b", "main", str(bare)], check=True, timeout=30)
    key = signing_key(tmp_path / "key")
    trusting(tmp_path / "keys", key)
    push(tmp_path, catalogue(published(key, artefact("event-detector"), images=(image(1),))))
    given = {"keys": tmp_path / "keys", "forge-url": f"file://{tmp_path}", "password-file": tmp_path / "password"}
    words = (word for name, value in given.items() for word in (f"--{name}", str(value)))
    return ["registry", "admission", "--stranded", "--kubeconfig", str(api.server.kubeconfig), *words]


def test_where_nothing_would_be_stranded_it_says_so(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Other people's workloads, Argo CD's by a tag among them, are not judged."""
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert printed.out == "nothing would be stranded (1 charts, 1 images, 2 of the platform listed)\n"
    assert (
        "images.mongo of the platform's chart: 'mongo:8' names no digest, so nothing of it would start" in printed.err
    )


def test_what_would_not_start_again_is_named_with_the_reason(
    api: Api, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    api.done("POST", path("Deployment", "vehicle-00"), workload("Deployment", image(3), "stranger"))
    api.done("POST", path("Deployment", "robotkube"), workload("Deployment", image(3), "patched"))
    api.done("POST", path("Deployment", "signing"), workload("Deployment", image(3), "another"))
    made: dict[str, Any] = application()
    made["spec"]["destination"]["namespace"] = "elsewhere"
    api.done("POST", APPLICATIONS, made)
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        f"argocd/application/vehicle-00-detector: chart {CHARTS}/event-detector at {CHART} is not verified on the "
        "catalogue's main",
        "argocd/application/vehicle-00-detector: namespace elsewhere is no agent's",
        f"robotkube/deployment/patched: image {image(3)} is not listed for this namespace",
        f"signing/deployment/another: image {image(3)} is not listed for this namespace",
        f"vehicle-00/deployment/stranger: image {image(3)} is not listed for this namespace",
    ]
    assert "5 objects would be stranded" in printed.err


def test_without_a_platform_it_says_what_is_missing(
    api: Api, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, "--platform-namespace", "argocd"]) == 2
    assert "no ConfigMap platform-images in argocd; is the platform installed?" in capsys.readouterr().err
