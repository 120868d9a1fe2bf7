"""The sources of the platform's images: the references of the values, a registry that has all of them, the defaults of
a bundle's chart, and the official images by tag."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci import toolchain
from ci.bundle.platform_chart import bundled_chart
from ci.images.building import NAMES
from tests.stages.paths import CHARTS

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
OFFICIAL = PLATFORM / "values-official-images.yaml"
REGISTRY = "registry.example.com:5000/robots/robotkube"
REFERENCES = {name: f"forge.robotkube/robotkube/{name}@sha256:{number:064x}" for number, name in enumerate(NAMES, 1)}
FLEET = {
    "agents": [{"name": "vehicle-00", "role": "vehicle"}, {"name": "cloud-0", "role": "cloud", "records": True}],
    "secrets": {"seed": "this-seed-is-for-tests-only-0123456789"},
}


def images(rendered: Any) -> set[str]:
    """References of all containers."""
    return {container["image"] for _, pod in rendered.pods for container in _containers(pod)}


def _containers(pod: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield from (*pod.get("initContainers", ()), *pod["containers"])


def test_one_value_moves_every_image_and_no_digest(helm: Any) -> None:
    before = helm.template(PLATFORM, PROFILE)
    after = helm.template(PLATFORM, PROFILE, **{"global": {"imageRegistry": f"{REGISTRY}/"}})
    assert images(after) == {f"{REGISTRY}/{reference.rpartition('/')[2]}" for reference in images(before)}
    moved = {reference.rpartition("/")[0] for reference in images(before)}
    left = [line for line in after.text.splitlines() if any(f"{place}/" in line for place in moved)]
    assert left == [], "what tells the inspector, people and suites of images names them as pods do"


def test_pods_keep_the_labels_of_their_images(helm: Any) -> None:
    """A pod's version is that of its image, wherever that is pulled from: moving it changes nothing else of a pod."""
    before, after = (
        {
            document["metadata"]["name"]: document["spec"]["template"]["metadata"]["labels"]
            for document in rendered.of_kind("Deployment", "StatefulSet")
        }
        for rendered in (
            helm.template(PLATFORM, PROFILE),
            helm.template(PLATFORM, PROFILE, **{"global": {"imageRegistry": REGISTRY}}),
        )
    )
    assert before == after


def test_what_is_no_registry_is_refused(helm: Any) -> None:
    said = helm.refusal(PLATFORM, PROFILE, **{"global": {"imageRegistry": "https://registry.example.com"}})
    assert "/global/imageRegistry" in said


@pytest.fixture
def bundled(tmp_path: Path) -> Path:
    """The platform's chart as a bundle has it."""
    packed = bundled_chart(
        PLATFORM, REFERENCES, {"key-1": "-----BEGIN PUBLIC KEY-----\nMCow\n-----END PUBLIC KEY-----\n"}
    )
    archive = tmp_path / "robotkube.tgz"
    archive.write_bytes(packed.archive)
    return archive


def test_the_same_digests_may_run_wherever_images_are_pulled_from(helm: Any, bundled: Path) -> None:
    """Admission and inspection name digests; moving the images lets no other one run, and strands none."""
    for more in ({}, {"global": {"imageRegistry": REGISTRY}}):
        rendered = helm.template(bundled, **FLEET, admission={"enabled": True}, **more)
        data = {one["metadata"]["name"]: one.get("data") for one in rendered.of_kind("ConfigMap")}
        running = {reference.rpartition("@sha256:")[2] for reference in images(rendered)}
        listed = {key.removeprefix("platform.") for key in data["admission-platform"]}
        known = yaml.safe_load(data["inspector"]["config.yaml"])["images"]
        everything = {reference.rpartition("@sha256:")[2] for reference in REFERENCES.values()}
        assert running <= listed <= everything
        assert running <= {reference.rpartition("@sha256:")[2] for reference in known} <= everything


def test_a_bundles_chart_needs_nothing_but_the_fleet(helm: Any, bundled: Path) -> None:
    as_built, moved = (
        helm.template(bundled, **FLEET, **more) for more in ({}, {"global": {"imageRegistry": REGISTRY}})
    )
    assert images(as_built) <= set(REFERENCES.values())
    assert images(moved) <= {f"{REGISTRY}/{reference.rpartition('/')[2]}" for reference in REFERENCES.values()}
    assert "-----BEGIN PUBLIC KEY-----" in as_built.text


def test_the_official_images_are_those_that_the_charts_name(helm: Any) -> None:
    """Nobody ran them here; what is known is that the chart takes them, and that Argo CD's manifests name the same."""
    rendered = helm.template(PLATFORM, PROFILE, OFFICIAL)
    values = yaml.safe_load(OFFICIAL.read_text())
    assert {values["images"][name] for name in ("mosquitto", "gitea", "mongo")} <= images(rendered)
    manifests = toolchain.module_dir("github.com/argoproj/argo-cd/v3") / "manifests" / "install.yaml"
    lines = manifests.read_text(encoding="utf-8").splitlines()
    argocd = {line.split()[1] for line in lines if line.strip().startswith("image: ")}
    assert set(values["inspection"]["images"]) == argocd
    assert "No test of this project ran them" in OFFICIAL.read_text().replace("\n# ", " ")
