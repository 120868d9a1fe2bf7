"""The platform's bundle in a registry as others run it, distribution with TLS, an authority of its own and tokens:
everything there has the digest that it has in the bundle, evidence is attached to what it is about, and Helm finds the
chart."""

from __future__ import annotations

import base64
import json
import os
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci import bundle as making
from ci import distribution, evidence, oras, publish
from ci.images import preparation
from robotkube.cli.main import main
from robotkube.registry.bundles.adapters.layouts import Bundle, read_bundle
from robotkube.registry.bundles.core.contents import IMAGE
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.referrers import fallback_tag
from robotkube.registry.publication.adapters import submission_folders
from tests.stages.programs import program
from tests.stages.registry.distribution import PASSWORD, USER, Distribution, running

pytestmark = [pytest.mark.toolchain, pytest.mark.thorough]

PATH = "robots/robotkube"
HELM_SECONDS_MAX = 120
UPLOAD = "http.request.method=POST"  # in the registry's log: a blob is about to come


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    """The platform's own, of everything that is built, with the evidence that is kept here."""
    path = tmp_path_factory.mktemp("bundle") / "robotkube.tar"
    prepared = preparation.everything()
    charts = submission_folders.all_charts(publish.CHARTS)
    submitted = publish.read_all(prepared.references(), evidence.kept_folder(), charts)
    making.write(path, prepared.images, submitted, making.argocd_manifests(prepared.references()))
    return read_bundle(path)


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Distribution]:
    with running(distribution.ensure() / "registry", tmp_path_factory.mktemp("registry")) as running_registry:
        yield running_registry


@pytest.fixture(scope="module")
def pushed(bundle: Bundle, registry: Distribution, tmp_path_factory: pytest.TempPathFactory) -> str:
    """HOST/PATH, where everything is afterwards."""
    password = tmp_path_factory.mktemp("account") / "password"
    password.write_text(PASSWORD)
    words = ["--to", f"{registry.host}/{PATH}", "--ca", str(registry.authority)]
    words += ["--username", USER, "--password-file", str(password), "--oras", str(oras.ensure() / "oras")]
    assert main(["bundle", "push", str(bundle.path), *words]) == 0, registry.log.read_text()[-2000:]
    return f"{registry.host}/{PATH}"


@pytest.fixture
def client(registry: Distribution) -> Iterator[OciRegistry]:
    with OciRegistry(f"https://{registry.host}", USER, PASSWORD, authority=registry.authority) as connected:
        yield connected


def test_every_digest_is_the_same(bundle: Bundle, pushed: str, client: OciRegistry) -> None:
    for item in bundle.contents.items:
        repository = f"{PATH}/{item.repository}"
        assert client.manifest_digest(repository, item.tag) == item.digest, item
        assert client.manifest(repository, item.digest) == bundle.read(item.digest)
        attached = {attachment.digest for attachment in client.attachments(repository, item.digest)}
        assert attached == {one.digest for one in item.attached}, item
    assert client.manifest_digest(f"{PATH}/bundle", bundle.contents.version) == bundle.digest
    names = {item.name for item in bundle.contents.of(IMAGE)}
    assert {image.name for image in preparation.everything().images} == names


def test_every_blob_has_its_bytes(bundle: Bundle, pushed: str, client: OciRegistry) -> None:
    """Of charts and manifests; layers of images were hashed by the registry when they came."""
    for item in (item for item in bundle.contents.items if item.kind != IMAGE):
        for digest in bundle.parts(item.digest):
            size = bundle.blobs[digest].size
            assert client.blob(f"{PATH}/{item.repository}", digest, size) == bundle.read(digest, size)


def test_this_registry_has_no_referrers_api_so_the_fallback_was_written(
    bundle: Bundle, pushed: str, client: OciRegistry
) -> None:
    item = next(item for item in bundle.contents.items if item.attached)
    assert client.manifest_digest(f"{PATH}/{item.repository}", fallback_tag(item.digest)) is not None


def test_the_same_again_copies_nothing(
    bundle: Bundle, pushed: str, registry: Distribution, tmp_path: Path, client: OciRegistry
) -> None:
    password = tmp_path / "password"
    password.write_text(PASSWORD)
    before = registry.log.read_text().count(UPLOAD)
    assert before > 0
    words = ["--to", pushed, "--ca", str(registry.authority), "--username", USER, "--password-file", str(password)]
    assert main(["bundle", "push", str(bundle.path), *words, "--oras", str(oras.ensure() / "oras")]) == 0
    assert registry.log.read_text().count(UPLOAD) == before


def test_who_has_no_account_gets_nothing(
    bundle: Bundle, pushed: str, registry: Distribution, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    password = tmp_path / "password"
    password.write_text("another")
    words = ["--to", pushed, "--ca", str(registry.authority), "--username", USER, "--password-file", str(password)]
    assert main(["bundle", "push", str(bundle.path), *words, "--oras", str(oras.ensure() / "oras")]) == 2
    assert "another" not in capsys.readouterr().err


def test_a_registry_whose_authority_is_not_named_is_not_believed(
    bundle: Bundle, pushed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bundle", "push", str(bundle.path), "--to", pushed, "--oras", str(oras.ensure() / "oras")]) == 2
    assert "certificate" in capsys.readouterr().err


def test_helm_renders_the_chart_of_the_registry(
    bundle: Bundle, pushed: str, registry: Distribution, tmp_path: Path
) -> None:
    """`helm template` reads the chart as `helm install` does, and asks no cluster."""
    account = base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode()
    (tmp_path / "config.json").write_text(json.dumps({"auths": {registry.host: {"auth": account}}}))
    fleet = {"agents": [{"name": "cloud-0", "role": "cloud"}], "secrets": {"seed": "for-this-test-only-" * 2}}
    (tmp_path / "agents.yaml").write_text(yaml.safe_dump(fleet))
    done = subprocess.run(
        [
            program("helm"),
            "template",
            "robotkube",
            f"oci://{pushed}/robotkube",
            *("--version", bundle.contents.version, "--ca-file", str(registry.authority)),
            *("--registry-config", str(tmp_path / "config.json")),
            *("--set", f"global.imageRegistry={pushed}", "--values", str(tmp_path / "agents.yaml")),
        ],
        capture_output=True,
        text=True,
        timeout=HELM_SECONDS_MAX,
        check=False,
        env={**os.environ, "HOME": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr
    named = {container["image"] for pod in pods(done.stdout) for container in pod}
    digests = {item.name: item.digest for item in bundle.contents.of(IMAGE)}
    assert named
    assert named <= {f"{pushed}/{name}@{digest}" for name, digest in digests.items()}


def pods(text: str) -> Iterator[list[Mapping[str, Any]]]:
    """The containers of every workload in YAML."""
    for document in yaml.load_all(text, Loader=yaml.CSafeLoader):
        template = ((document or {}).get("spec") or {}).get("template") or {}
        if "containers" in template.get("spec", {}):
            yield [*template["spec"].get("initContainers", ()), *template["spec"]["containers"]]
