"""Helm as the tests use it: render a chart with a profile, or see it refused."""

from __future__ import annotations

import functools
import os
import pickle
import re
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci import toolchain
from ci.cluster_contract.provider import ChartProfile
from ci.installation import stated_values
from gitops.argocd.render import render
from tests.stages.paths import REPOSITORY
from tests.stages.programs import SELDOM_COLLECTING, program
from tests.stages.registry import chart_images

CHARTS = REPOSITORY / "charts"
PROFILES = Path(__file__).parent / "profiles"
HELM_SECONDS_MAX = 60
PLATFORM = CHARTS / "robotkube"
ARCHIVED = ("charts", "gitops", "registry/policies")  # the platform chart links to the latter two
IMAGES = "forge.robotkube.svc.cluster.local:3000/robotkube"
APP_CHARTS = ("mqtt-bridge", "event-detector", "bag-player", "object-detection", "object-tracking")

SEPARATOR = re.compile("^---$", re.MULTILINE)
LOADER = yaml.CSafeLoader  # Argo CD's manifests are 34 000 lines: 0.6 s in C, 9 s in Python

Object = dict[str, Any]


@dataclass(frozen=True)
class Rendered:
    """What `helm template` wrote."""

    text: str

    @functools.cached_property
    def objects(self) -> list[Object]:
        """Of this rendering alone: who changes one changes no other's."""
        found = (pickle.loads(_documents(text)) for text in SEPARATOR.split(self.text))  # noqa: S301 - of our own
        return [document for documents in found for document in documents if document]

    def of_kind(self, *kinds: str) -> list[Object]:
        return [document for document in self.objects if document["kind"] in kinds]

    def one(self, kind: str, name: str, namespace: str | None = None) -> Object:
        """The object of this kind and name; `namespace` None is the release's own."""
        matching = [
            document
            for document in self.of_kind(kind)
            if document["metadata"]["name"] == name and document["metadata"].get("namespace") == namespace
        ]
        assert len(matching) == 1, f"{kind} {namespace}/{name}: {len(matching)} found"
        return matching[0]

    @property
    def pods(self) -> list[tuple[str, Object]]:
        """(kind/name, pod spec) of every workload."""
        workloads = self.of_kind("Deployment", "StatefulSet", "Job", "DaemonSet", "CronJob", "ReplicaSet", "Pod")
        return [(f"{w['kind']}/{w['metadata']['name']}", w["spec"]["template"]["spec"]) for w in workloads]


@functools.cache
def _documents(text: str) -> bytes:
    """What a part of a rendering says. Most parts are the same in renderings with other values, and reading all of one
    takes a quarter of what Helm does."""
    return pickle.dumps(list(yaml.load_all(text, Loader=LOADER)))


@dataclass(frozen=True)
class Helm:
    """Runs helm, once for a chart of the repository and the same values; a profile is a list of values files. Charts of
    applications that lie in folders are rendered with the images.yaml that packing adds to them."""

    binary: str
    folder: Path
    done: dict[tuple[Any, ...], subprocess.CompletedProcess[str]] = field(default_factory=dict, hash=False)

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        own = {"HOME": str(self.folder), "HELM_NAMESPACE": "robotkube"}
        return subprocess.run(
            [self.binary, *arguments],
            capture_output=True,
            text=True,
            timeout=HELM_SECONDS_MAX,
            check=False,
            env={**os.environ, **SELDOM_COLLECTING, **own},
        )

    def values(self, values: Mapping[str, Any]) -> Path:
        """A values file with this content."""
        path = self.folder / f"values-{len(list(self.folder.iterdir()))}.yaml"
        path.write_text(yaml.safe_dump(dict(values)), encoding="utf-8")
        return path

    def template(self, chart: Path, *files: Path, release: str = "robotkube", **values: Any) -> Rendered:
        done = self._template(chart, files, release, values)
        assert done.returncode == 0, done.stderr
        return Rendered(done.stdout)

    def refusal(self, chart: Path, *files: Path, release: str = "robotkube", **values: Any) -> str:
        """What helm says when it refuses these values; it is an error when it does not."""
        done = self._template(chart, files, release, values)
        assert done.returncode != 0, "the values were accepted"
        return done.stderr

    def _template(
        self, chart: Path, files: tuple[Path, ...], release: str, values: Mapping[str, Any]
    ) -> subprocess.CompletedProcess[str]:
        given = [*files, self.values(values)] if values else list(files)
        if not chart.is_relative_to(CHARTS):
            return self._render(chart, tuple(given), release)
        key = (chart, release, *(path.read_text(encoding="utf-8") for path in given))  # these charts stay as they are
        if key not in self.done:
            self.done[key] = self._render(chart, tuple(given), release)
        return self.done[key]

    def _render(self, chart: Path, given: tuple[Path, ...], release: str) -> subprocess.CompletedProcess[str]:
        options = [option for path in given for option in ("-f", str(path))]
        of_application = chart.is_dir() and chart.parent.name in ("apps", "earlier")
        return self.run("template", release, str(self._with_image(chart) if of_application else chart), *options)

    @functools.cache  # noqa: B019 - one for a session
    def _with_image(self, chart: Path) -> Path:
        folder = self.folder / f"charts-{len(list(self.folder.iterdir()))}" / chart.name
        shutil.copytree(chart, folder)  # follows the link to the library chart, as packing does
        images = {name: f"{IMAGES}/{name}@sha256:{'5' * 64}" for name in chart_images.NAMES}
        (folder / "images.yaml").write_text(yaml.safe_dump(images))
        return folder


@pytest.fixture(scope="session")
def helm(tmp_path_factory: pytest.TempPathFactory) -> Helm:
    return Helm(program("helm"), tmp_path_factory.mktemp("helm"))


@pytest.fixture(scope="session")
def charts_before(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The charts of the commit before this one. Where there is no history to look at, those that are here: then only
    the record of the first installation (golden/selectors.json) says what an upgrade may not change."""
    if not (REPOSITORY / ".git").exists():
        return CHARTS
    folder = tmp_path_factory.mktemp("before")
    archive = ["git", "archive", "HEAD~1", *ARCHIVED]
    bundle = subprocess.run(archive, cwd=REPOSITORY, capture_output=True, check=True, timeout=60).stdout
    subprocess.run(["tar", "--extract", "--directory", folder], input=bundle, check=True, timeout=60)
    return folder / "charts"


@pytest.fixture(scope="session")
def official(helm: Helm) -> Rendered:
    """The platform chart with its defaults."""
    return helm.template(PLATFORM, PROFILES / "official.yaml")


@pytest.fixture(scope="session")
def embedded(helm: Helm) -> Rendered:
    """The platform chart as the embedded cluster installs it."""
    return helm.template(PLATFORM, PLATFORM / "values-embedded.yaml", PROFILES / "embedded.yaml")


@pytest.fixture(scope="session")
def apps(helm: Helm) -> Mapping[str, Rendered]:
    """Each application chart, as a release named like its chart."""
    return {name: helm.template(CHARTS / "apps" / name, PROFILES / f"{name}.yaml", release=name) for name in APP_CHARTS}


@pytest.fixture
def golden() -> Callable[[str, str], None]:
    """Compares a text with golden/<name>.yaml; ROBOTKUBE_GOLDEN=write writes the files instead."""

    def compare(name: str, text: str) -> None:
        path = Path(__file__).parent / "golden" / f"{name}.yaml"
        if os.environ.get("ROBOTKUBE_GOLDEN") == "write":
            path.write_text(text, encoding="utf-8")
        assert path.read_text(encoding="utf-8") == text, (
            f"{path.name} differs; when that is intended: make golden, and look at git diff"
        )

    return compare


@pytest.fixture(scope="session")
def argocd() -> list[Object]:
    """Argo CD for the embedded cluster, from the manifests of the version the tool chain pins."""
    source = toolchain.module_dir("github.com/argoproj/argo-cd/v3") / "manifests" / "install.yaml"
    images = {"argocd": "registry.example/argocd@sha256:1", "redis": "registry.example/redis@sha256:2"}
    stated = stated_values(ChartProfile(("values-embedded.yaml",)))["networkPolicies"]
    return list(yaml.load_all(render(source.read_text(encoding="utf-8"), images, stated), Loader=LOADER))
