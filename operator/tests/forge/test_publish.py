"""Publishing to a real forge: images and charts by digest, the catalogue that names them, twice, and after a change."""

import hashlib
import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path

import httpx
import pygit2
import pytest
from installation import Installation

from ci import publish
from ci.cluster.images import Image
from ci.errors import SetUpError
from robotkube.adapters.git_clones import GitClone
from robotkube.adapters.oci_registry import Registry
from robotkube.domain.catalogue import FOLDERS, read_catalogue

REPOSITORY = "forge.robotkube.svc.cluster.local:3000/robotkube"


def image(folder: Path, name: str, content: bytes) -> Image:
    """An image of one layer in an OCI layout archive."""
    layer = content
    config = json.dumps({"architecture": "amd64", "os": "linux", "rootfs": {"type": "layers", "diff_ids": []}}).encode()
    manifest = json.dumps(
        {
            "schemaVersion": 2,
            "mediaType": "application/vnd.oci.image.manifest.v1+json",
            "config": descriptor("application/vnd.oci.image.config.v1+json", config),
            "layers": [descriptor("application/vnd.oci.image.layer.v1.tar", layer)],
        }
    ).encode()
    entry = descriptor("application/vnd.oci.image.manifest.v1+json", manifest)
    files = {f"blobs/sha256/{hashlib.sha256(data).hexdigest()}": data for data in (layer, config, manifest)}
    files["index.json"] = json.dumps({"schemaVersion": 2, "manifests": [entry]}).encode()
    archive = folder / f"{name}-{hashlib.sha256(content).hexdigest()[:8]}.tar"
    with tarfile.open(archive, "w") as tar:
        for path, data in files.items():
            info = tarfile.TarInfo(path)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return Image(name, f"{REPOSITORY}/{name}@{entry['digest']}", archive)


def descriptor(kind: str, data: bytes) -> dict[str, object]:
    return {"mediaType": kind, "digest": "sha256:" + hashlib.sha256(data).hexdigest(), "size": len(data)}


@pytest.fixture(scope="module", autouse=True)
def _catalogue_as_before(installation: Installation) -> Iterator[None]:
    """The other tests of the session have a catalogue of their own, with charts that were never packed."""
    clone = installation.clone("publisher", "robotkube/catalogue")
    before = clone.repository[clone.tip()].tree
    yield
    who = pygit2.Signature("publisher", "publisher@forge.invalid")
    tip = clone.tip()
    commit = clone.repository.create_commit(None, who, who, "as before\n", before.id, [tip])
    assert clone.push(str(commit), "refs/heads/main") == ""


@pytest.fixture
def access(installation: Installation) -> publish.ForgeAccess:
    return publish.ForgeAccess(installation.url, installation.passwords["publisher"])


def catalogue_of(installation: Installation, folder: Path) -> GitClone:
    account = ("manager", installation.passwords["manager"])
    clone = GitClone(installation.url, "robotkube/catalogue", *account, folder)
    clone.fetch()
    return clone


def test_publishing_twice_changes_nothing_and_a_new_image_gives_new_digests(
    installation: Installation, access: publish.ForgeAccess, tmp_path: Path
) -> None:
    first = publish.publish_to(access, [image(tmp_path, "ros", b"one")])
    assert first.changed
    again = publish.publish_to(access, [image(tmp_path, "ros", b"one")])
    assert not again.changed
    assert again.commit == first.commit
    second = publish.publish_to(access, [image(tmp_path, "ros", b"two")])
    assert second.changed
    assert {chart.version for chart in second.charts} == {chart.version for chart in first.charts}
    old, new = ({chart.digest for chart in found.charts} for found in (first, second))
    assert not old & new
    with Registry(installation.url, "argocd", installation.passwords["argocd"]) as registry:
        for chart in (*first.charts, *second.charts):  # what runs stays there
            repository = f"staging/{chart.name}"
            assert registry.manifest_digest(repository, chart.digest) == chart.digest
            tag = publish.local_tag(chart.version, chart.digest)
            assert registry.manifest_digest(repository, tag) == chart.digest
        for reference in second.images:
            assert registry.manifest_digest("robotkube/ros", reference.partition("@")[2])


def test_the_catalogue_holds_what_the_manager_reads(
    installation: Installation, access: publish.ForgeAccess, tmp_path: Path
) -> None:
    published = publish.publish_to(access, [image(tmp_path, "ros", b"three")])
    clone = catalogue_of(installation, tmp_path / "catalogue")
    found = read_catalogue(clone.files(published.commit, FOLDERS))
    sources = {path.name for path in (publish.REGISTRY / "applications").glob("*.yaml")}
    assert {f"{name}.yaml" for name in found.applications} == sources
    assert found.assurance == "none"
    assert [problem for problem in found.problems if "event-detector/0" not in problem] == []
    for chart in published.charts:
        version = next(v for v in found.charts[chart.name] if v.version == chart.version)
        assert (version.state, version.digest) == ("staged", chart.digest)
    commit = clone.commit(published.commit)
    assert commit.author == "publisher"
    assert all(f"RobotKube-Chart: {c.name}@{c.version}@{c.digest}" in commit.message for c in published.charts)


def test_a_state_stays_with_its_digest() -> None:
    chart = publish.PublishedChart("bridge", "0.1.0", "sha256:" + "1" * 64, ("image",))
    known = f"status: {{state: withdrawn, digest: '{chart.digest}', images: [image]}}\n"
    assert publish.chart_status(chart, known)["state"] == "withdrawn"
    other = publish.PublishedChart("bridge", "0.1.0", "sha256:" + "2" * 64, ("image",))
    assert publish.chart_status(other, known)["state"] == "staged"


def test_a_missing_image_is_named(access: publish.ForgeAccess, tmp_path: Path) -> None:
    with pytest.raises(SetUpError, match=r"spec.images: no image 'ros'; there are other"):
        publish.publish_to(access, [image(tmp_path, "other", b"x")])


def test_a_wrong_password_is_named(installation: Installation, tmp_path: Path) -> None:
    with pytest.raises(SetUpError, match="publisher"):
        publish.publish_to(publish.ForgeAccess(installation.url, "wrong"), [image(tmp_path, "ros", b"x")])


def test_manager_and_gate_write_no_charts(installation: Installation) -> None:
    for account in ("manager", "gate", "argocd", "operator-team"):
        answer = httpx.post(
            f"{installation.url}/v2/staging/app/blobs/uploads/", auth=(account, installation.passwords[account])
        )
        assert answer.status_code == 401
    assert httpx.get(f"{installation.url}/v2/staging/mqtt-bridge/tags/list").status_code == 401
