"""Labels as the conventions of Kubernetes say, on every object and pod, and selectors that no upgrade changes."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.cli.live import component_lines
from robotkube.cli.live.rollouts import DEPLOYMENT, JOB, STATEFUL_SET
from tests.stages.paths import CHARTS

Object = dict[str, Any]

pytestmark = pytest.mark.toolchain
PLATFORM = CHARTS / "robotkube"
PROFILES = Path(__file__).parent / "profiles"
APP_CHARTS = ("mqtt-bridge", "event-detector", "bag-player", "object-detection", "object-tracking")
INSTALLATIONS = {"official": ["official.yaml"], "managers": ["official.yaml", "managers.yaml"]}
CONVENTIONS = {
    f"app.kubernetes.io/{word}" for word in ("name", "instance", "component", "part-of", "version", "managed-by")
}
# What an API server refuses to change, or what must go on to find the pods that run. Not written by `make golden`.
FIRST = json.loads((Path(__file__).parent / "golden" / "selectors.json").read_text(encoding="utf-8"))


def labelled(objects: list[Object]) -> Iterator[tuple[str, Object]]:
    """Every object and every pod template: where it stands, and its labels."""
    for one in objects:
        place = f"{one['kind']} {one['metadata'].get('namespace', '')}/{one['metadata']['name']}"
        yield place, one["metadata"].get("labels", {})
        if "template" in one.get("spec", {}) and one["kind"] != "ApplicationSet":
            yield f"pods of {place}", one["spec"]["template"]["metadata"]["labels"]


def fixed(objects: list[Object]) -> dict[str, Object]:
    """What may not change in an upgrade, by kind and name."""
    keys = {"Deployment": ["selector"], "Service": ["selector"]}
    keys["StatefulSet"] = ["selector", "serviceName", "volumeClaimTemplates"]
    return {
        f"{one['kind']}/{one['metadata']['name']}": {key: one["spec"].get(key) for key in keys[one["kind"]]}
        for one in objects
        if one["kind"] in keys
    }


def installed(helm: Any, charts: Path, installation: str) -> dict[str, Object]:
    files = [PROFILES / name for name in INSTALLATIONS.get(installation, [f"{installation}.yaml"])]
    chart = charts / ("robotkube" if installation in INSTALLATIONS else f"apps/{installation}")
    return fixed(helm.template(chart, *files).objects)


@pytest.mark.parametrize("installation", FIRST)
def test_selectors_are_those_of_the_first_installation(helm: Any, installation: str) -> None:
    now = installed(helm, CHARTS, installation)
    assert {name: now.get(name) for name in FIRST[installation]} == FIRST[installation]
    assert set(now) == set(FIRST[installation]), "write what is new into golden/selectors.json by hand"


@pytest.mark.parametrize("installation", FIRST)
def test_selectors_are_those_of_the_commit_before(helm: Any, charts_before: Path, installation: str) -> None:
    now, earlier = installed(helm, CHARTS, installation), installed(helm, charts_before, installation)
    kept = set(now) & set(earlier)
    assert kept
    assert {name: now[name] for name in kept} == {name: earlier[name] for name in kept}


@pytest.mark.parametrize("installation", INSTALLATIONS)
def test_what_has_fixed_parts_else_is_made_anew_by_an_upgrade(helm: Any, installation: str) -> None:
    rendered = helm.template(PLATFORM, *(PROFILES / name for name in INSTALLATIONS[installation]))
    for job in rendered.of_kind("Job"):
        if not job["metadata"]["name"].startswith("gate-key-"):  # its name says what it is: test_gate_key.py
            assert "before-hook-creation" in job["metadata"]["annotations"]["helm.sh/hook-delete-policy"]


@pytest.mark.parametrize("installation", INSTALLATIONS)
def test_everything_carries_the_labels_of_the_conventions(helm: Any, installation: str) -> None:
    rendered = helm.template(PLATFORM, *(PROFILES / name for name in INSTALLATIONS[installation]))
    of_objects = dict(labelled(rendered.objects))
    assert len(of_objects) > 60
    assert {
        place: CONVENTIONS - set(labels) for place, labels in of_objects.items() if not set(labels) >= CONVENTIONS
    } == {}
    assert {labels["app.kubernetes.io/part-of"] for labels in of_objects.values()} == {"robotkube"}


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_releases_carry_the_labels_of_the_conventions(apps: Any, chart: str) -> None:
    of_objects = dict(labelled(apps[chart].objects))
    assert len(of_objects) == 3
    assert {
        place: CONVENTIONS - set(labels) for place, labels in of_objects.items() if not set(labels) >= CONVENTIONS
    } == {}


def test_managers_are_one_component_with_names_of_their_own(helm: Any) -> None:
    rendered = helm.template(PLATFORM, *(PROFILES / name for name in INSTALLATIONS["managers"]))
    for name in ("manager", "manager-north"):
        labels = rendered.one("Deployment", name)["metadata"]["labels"]
        assert labels["app.kubernetes.io/name"] == name
        assert labels["app.kubernetes.io/component"] == "manager"


@pytest.mark.parametrize(
    ("image", "version"),
    [
        ("docker.io/gitea/gitea:1.26.0-rootless", "1.26.0-rootless"),
        ("registry.example:5000/gitea@sha256:" + "0123456789abcdef" * 4, "0123456789ab"),
        ("registry.example:5000/gitea:1.26@sha256:" + "0123456789abcdef" * 4, "1.26"),
        ("registry.example:5000/gitea", "latest"),
        ("gitea:_" + "x" * 80, "x" * 62),
    ],
)
def test_a_pod_has_the_version_of_its_image(helm: Any, image: str, version: str) -> None:
    rendered = helm.template(PLATFORM, PROFILES / "official.yaml", images={"gitea": image})
    forge = rendered.one("StatefulSet", "forge")
    assert forge["spec"]["template"]["metadata"]["labels"]["app.kubernetes.io/version"] == version
    assert forge["metadata"]["labels"]["app.kubernetes.io/version"] == "0.1.0"


@pytest.mark.parametrize("chart", ["robotkube", *(f"apps/{name}" for name in APP_CHARTS)])
def test_another_version_of_a_chart_alone_starts_no_pod_anew(helm: Any, chart: str, tmp_path: Path) -> None:
    """Else each upgrade would take forge, broker and database away for a while."""
    profile = PROFILES / ("official.yaml" if chart == "robotkube" else f"{Path(chart).name}.yaml")
    charts = tmp_path / Path(chart).parent / "chart"
    charts.parent.mkdir(exist_ok=True)
    subprocess.run(["cp", "-rL", str(CHARTS / chart), str(charts)], check=True, timeout=60)
    described = charts / "Chart.yaml"
    metadata = yaml.safe_load(described.read_text(encoding="utf-8"))
    described.write_text(yaml.safe_dump({**metadata, "version": "7.8.9", "appVersion": "7.8.9"}), encoding="utf-8")
    old = helm.template(CHARTS / chart, profile)
    new = helm.template(charts, profile)
    assert templates(old) == templates(new)
    versions = {labels["app.kubernetes.io/version"] for place, labels in labelled(new.objects) if "pods" not in place}
    assert versions == {"7.8.9"}


def templates(rendered: Any) -> dict[str, Object]:
    """The pods of everything, as a hash of them decides whether they start anew; Jobs that are hooks run each time."""
    return {
        one["metadata"]["name"]: one["spec"]["template"] for one in rendered.of_kind("Deployment", "StatefulSet", "Job")
    }


def test_an_installation_is_followed_by_them(embedded: Any, official: Any, argocd: list[Object]) -> None:
    """`robotkube wait` finds every workload of platform and Argo CD, and their pods by the name of their component."""
    for part, objects in (("robotkube", embedded.objects), ("robotkube", official.objects), ("argocd", argocd)):
        workloads = [one for one in objects if one["kind"] in (DEPLOYMENT, STATEFUL_SET, JOB)]
        assert workloads
        for one in workloads:
            labels, of_pods = one["metadata"]["labels"], one["spec"]["template"]["metadata"]["labels"]
            assert labels[component_lines.PART] == part
            assert labels[component_lines.NAME] == of_pods[component_lines.NAME], one["metadata"]["name"]
