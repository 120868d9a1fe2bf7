"""An image of a publisher's own, from its Dockerfile to a pod: built on the platform's image, pushed, tried, published,
asked for, and pulled by a node that no archive brought it to."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from ci.folders import PROJECT
from ci.images import preparation
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.publication.adapters.submission_folders import read_images
from robotkube.registry.suites.core.image_checks import read_reference
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.registry.own_image_sources import with_example
from tests.stages.registry.publications import write_sources

NAME = "own-greeter"
NAMESPACE = "cloud-0"
COMMAND_SECONDS_MAX = 600
TASK = {
    "apiVersion": "robotkube.io/v1alpha1",
    "kind": "TaskDescription",
    "metadata": {"name": NAME, "namespace": NAMESPACE},
    "spec": {
        "requester": "somebody",
        "event": {
            "rule": "by-hand",
            "id": f"{NAME}-1",
            "time": "2026-11-21T10:00:00Z",
            "trace": "0123456789abcdef0123456789abcdef",
        },
        "reason": "an image of its own",
        "application": NAME,
        "parameters": {},
    },
}


def robotkube(platform: Platform, folder: Path, *words: str) -> dict[str, Any]:
    """The command in the folder of the sources; its data."""
    done = subprocess.run(
        [str(PROJECT / "ci" / "python"), "-m", "robotkube.cli", *words, "-o", "json"],
        cwd=folder,
        env={**os.environ, "KUBECONFIG": str(platform.installer.kubeconfig), "XDG_CACHE_HOME": str(folder / "cache")},
        capture_output=True,
        text=True,
        timeout=COMMAND_SECONDS_MAX,
        check=False,
    )
    assert done.returncode == 0, f"{words}\n{done.stdout[-3000:]}\n{done.stderr[-6000:]}"
    return dict(json.loads(done.stdout))


def run_own_image(chart: Path, entry: Path) -> None:
    """Have the chart run its own image, as its README says."""
    template = chart / "templates" / "_app.tpl"
    lines = template.read_text().splitlines(keepends=True)
    kept = "".join(line for line in lines if not line.startswith(("files:", "  node.py:", "  answers.py:")))
    changed = {
        template: kept.replace("image: ros", f"image: {NAME}").replace(
            "/etc/robotkube/node.py", f"/opt/{NAME}/node.py"
        ),
        chart / "Chart.yaml": (chart / "Chart.yaml").read_text().replace("images: ros", f"images: {NAME}"),
        entry: entry.read_text().replace("images: [ros]", f"images: [{NAME}]"),
        chart / "Dockerfile": with_example((chart / "Dockerfile").read_text()),
    }
    for path, text in changed.items():
        assert NAME in text, path
        path.write_text(text)


def running_images(platform: Platform) -> list[str]:
    """Images of the containers of the release that are ready."""
    pods = platform.get("-n", NAMESPACE, "pods", "-l", f"app.kubernetes.io/instance={NAME}")["items"]
    states = [state for pod in pods for state in pod["status"].get("containerStatuses", ()) if state["ready"]]
    return [state["imageID"] for state in states]


@pytest.mark.thorough
def test_an_image_that_is_in_no_archive_runs(platform: Platform, tmp_path: Path) -> None:
    write_sources(tmp_path, NAME)
    run_own_image(tmp_path / "charts" / "apps" / NAME, tmp_path / "registry" / "charts" / NAME / "0.1.0.yaml")
    robotkube(platform, tmp_path, "image", "push", f"charts/apps/{NAME}")
    reference = read_images(tmp_path / "registry" / "images.yaml")[NAME]
    parts = read_reference(reference)
    assert parts is not None
    assert parts.repository == f"own-images/{NAME}"
    assert reference not in {image.reference for image in preparation.everything().images}
    robotkube(platform, tmp_path, "registry", "submit", NAME, "--application", NAME)
    with OciRegistry(platform.forge_url(), "nodes", platform.password("nodes")) as registry:
        assert registry.manifest_digest(parts.repository, parts.digest) == parts.digest
    try:
        platform.kubectl("apply", "-f", "-", text=json.dumps(TASK))
        wait = ("-n", NAMESPACE, "wait", f"taskdescription/{NAME}", "--for=condition=Ready", "--timeout=120s")
        platform.kubectl(*wait, seconds=130)
        assert [image.rpartition("@")[2] for image in running_images(platform)] == [parts.digest]
    finally:
        platform.kubectl("-n", NAMESPACE, "delete", "taskdescription", NAME, "--ignore-not-found")
        eventually("the pods are gone", lambda: not running_images(platform), seconds=90)
