"""The gate's check of images on values: those that a release's pods would run against those of the chart's entry."""

from collections.abc import Sequence
from dataclasses import replace

import pytest

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.gate.core.check_results import CheckLog
from robotkube.delivery.gate.core.release_checks import Rules, release_problems
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.registry.catalogue.core.catalogue import Catalogue, ChartVersion
from robotkube.registry.charts.core.pod_images import pod_images
from robotkube.registry.charts.core.references import ChartReference
from tests.stages.attacks import shown

PATH = "releases/cloud-0/bridge.yaml"
IMAGE, FOREIGN = "forge:3000/ros@sha256:" + "3" * 64, "elsewhere:5000/ros@sha256:" + "4" * 64
DIGEST, SUMMARY = "sha256:" + "1" * 64, "sha256:" + "5" * 64
CHART = ChartReference("bridge", "0.1.0", DIGEST)
VERSION = ChartVersion(
    "bridge",
    "0.1.0",
    "verified",
    DIGEST,
    image_references=(IMAGE,),
    evidence=SUMMARY,
    assured=True,
    evidence_problem="",
)
RELEASE = Release("cloud-0", "bridge", "bridge", "0.1.0", DIGEST, {}, (), "20261121-100000-000001", SUMMARY)


def images(release: Release) -> Sequence[str]:
    """Images of a chart whose pods run what its values say."""
    if "error" in release.values:
        raise release.values["error"]
    return tuple(release.values.get("images", (IMAGE,)))


def rules(version: ChartVersion = VERSION, assurance: str = "verified") -> Rules:
    catalogue = Catalogue({}, {"bridge": (version,)}, assurance)
    return Rules("manager", frozenset(), "oci://forge/verified", catalogue, lambda *_: {}, validate, images)


def problems(values: dict[str, object], by: Rules | None = None, evidence: str = SUMMARY) -> list[str]:
    return list(release_problems(PATH, replace(RELEASE, values=values, evidence=evidence), by or rules(), CheckLog()))


def test_the_verified_image_may_run_wherever_it_comes_from() -> None:
    assert problems({}) == []
    assert problems({"images": ["mirror.example/ros:1.2@" + IMAGE.partition("@")[2]]}) == []
    assert problems({"images": []}) == []


@pytest.mark.parametrize(
    ("given", "named"), [(FOREIGN, FOREIGN), ("forge:3000/ros:1", "forge:3000/ros:1"), ("", "(none)")]
)
def test_any_other_image_is_refused(given: str, named: str) -> None:
    refused = problems({"images": [IMAGE, given]})
    assert refused == [
        f"{PATH}: spec.values: a pod would run image {named}, which was not verified with chart {CHART} "
        f"(images: {IMAGE}); leave out the values that name an image, or publish a version with this one"
    ]
    shown("gate", refused[0], "tag-moves")


def test_an_image_that_is_a_volume_is_refused_as_well() -> None:
    spec = {
        "containers": [{"name": "app", "image": IMAGE}],
        "volumes": [{"name": "v", "image": {"reference": FOREIGN}}],
    }
    of_pod = pod_images([{"kind": "Pod", "spec": spec}])
    [refusal] = problems({"images": of_pod})
    assert f"a pod would run image {FOREIGN}" in refusal
    shown("gate", refusal, "image-volume")


def test_a_chart_that_cannot_be_rendered_is_refused_and_one_that_cannot_be_tried_is_not() -> None:
    assert problems({"error": InputError("the chart cannot be rendered: no")}) == [
        f"{PATH}: the chart cannot be rendered: no"
    ]
    with pytest.raises(UnavailableError):
        problems({"error": UnavailableError("the OCI registry is away")})


def test_a_chart_that_may_not_run_is_not_rendered() -> None:
    doubted = replace(VERSION, assured=False, evidence_problem="there is no summary")
    refused = problems({"error": UnavailableError("rendered")}, rules(doubted))
    assert refused == [
        f"{PATH}: chart {CHART}: no valid evidence: there is no summary (release policy: assurance verified)"
    ]


def test_without_evidence_images_are_compared_unless_the_entry_names_none() -> None:
    staged = replace(VERSION, state="staged", assured=False, evidence="")
    assert len(problems({"images": [FOREIGN]}, rules(staged, "none"), "none")) == 1
    assert problems({"images": [FOREIGN]}, rules(replace(staged, image_references=()), "none"), "none") == []
    assert len(problems({"images": [FOREIGN]}, rules(replace(VERSION, image_references=())))) == 1
