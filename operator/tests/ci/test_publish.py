"""Publishing what was built to a real forge: images with their bills, charts by a submission that a gate verifies."""

import functools
import hashlib
import io
import json
import tarfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pygit2
import pytest

from ci import evidence, publish
from ci.errors import SetUpError
from ci.images.image_lock import Image
from robotkube.cli.registry.source_problems import check_sources
from robotkube.registry.catalogue.core.catalogue import FOLDERS, read_catalogue
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import build_tag
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.evidence.core.verification_policy import read_verification_policy
from robotkube.registry.images.adapters import bills
from robotkube.registry.publication.loops.submitting import PUBLISHED, UNCHANGED
from robotkube.registry.suites.core.image_checks import BILL_TYPE
from tests.stages.forge.installation import Clone, Installation
from tests.stages.registry import chart_images
from tests.stages.registry.publications import Publishing, look_often
from tests.stages.registry.signed_evidence import POLICY_TEXT

pytestmark = pytest.mark.toolchain

SUITES = read_verification_policy(POLICY_TEXT).suites
BILL = b'{"bomFormat": "CycloneDX"}'
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
    archive = folder / f"{name}-{hashlib.sha256(content).hexdigest()[:8]}" / "image.tar"
    archive.parent.mkdir(exist_ok=True)
    archive.with_name(bills.FILE).write_bytes(BILL)
    with tarfile.open(archive, "w") as tar:
        for path, data in files.items():
            info = tarfile.TarInfo(path)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return Image(name, f"{REPOSITORY}/{name}@{entry['digest']}", archive)


def images(folder: Path, content: bytes, **other: bytes) -> list[Image]:
    """All that charts name, each with a layer of its own; `other`: content of some, by name with `_` for `-`."""
    layers = {name: other.get(name.replace("-", "_"), content) for name in chart_images.NAMES}
    return [image(folder, name, name.encode() + b" " + layer) for name, layer in layers.items()]


def descriptor(kind: str, data: bytes) -> dict[str, object]:
    return {"mediaType": kind, "digest": "sha256:" + hashlib.sha256(data).hexdigest(), "size": len(data)}


def _index(clone: Clone) -> pygit2.Index:
    """The files at main's tip."""
    index = pygit2.Index()
    index.read_tree(clone.repository[clone.tip()].tree)
    return index


@pytest.fixture(scope="module", autouse=True)
def _catalogue_of_its_own(installation: Installation) -> Iterator[None]:
    """Only the policies, as in a new installation: the other tests of the session have charts in theirs that were
    never packed, and versions that nothing leads to. Theirs is put back afterwards."""
    clone = installation.clone("gate", "robotkube/catalogue")
    tip = clone.tip()
    before = clone.repository[tip].tree
    gone = [entry.path for entry in _index(clone) if entry.path.startswith(("applications/", "charts/", "evidence/"))]
    assert clone.push(clone.commit(dict.fromkeys(gone), "begin\n", [tip]), "refs/heads/main") == ""
    yield
    who = pygit2.Signature("gate", "gate@forge.invalid")
    tip = clone.tip()
    commit = clone.repository.create_commit(None, who, who, "as before\n", before.id, [tip])
    assert clone.push(str(commit), "refs/heads/main") == ""


@pytest.fixture(scope="module", autouse=True)
def _sources_are_checked_once() -> Iterator[None]:
    """Validating and composing every application takes a second of a processor, and no test changes the repository's
    sources: ten publications ask for the same charts and applications, of which the first is answered in full."""
    with pytest.MonkeyPatch.context() as patching:

        @functools.cache
        def checked(names: tuple[str, ...], applications: tuple[str, ...], *rest: Any) -> None:
            check_sources(names, applications, *rest)

        patching.setattr(publish, "check_sources", lambda *given: checked(*map(_hashable, given)))
        yield


def _hashable(given: Any) -> Any:
    return tuple(given) if isinstance(given, list) else given


@pytest.fixture(autouse=True)
def _prompt(monkeypatch: pytest.MonkeyPatch) -> None:
    look_often(monkeypatch)


@pytest.fixture
def access(installation: Installation) -> publish.PublishingAccounts:
    return publish.PublishingAccounts(
        *(
            publish.ForgeAccess(installation.url, name, installation.passwords[name])
            for name in (publish.ACCOUNT, publish.IMAGE_ACCOUNT, publish.PERSON)
        )
    )


@pytest.fixture
def publishing(installation: Installation, tmp_path: Path) -> Iterator[Publishing]:
    """A gate that publishes, as that of the embedded cluster: local builds may replace each other."""
    stage = Publishing(installation, tmp_path / "gate", local_builds=True)
    stage.start()
    yield stage
    stage.stop()


def test_what_was_built_is_published_once_and_its_evidence_kept(
    installation: Installation, publishing: Publishing, access: publish.PublishingAccounts, tmp_path: Path
) -> None:
    built = images(tmp_path, b"one")
    said = list[str]()
    kept = tmp_path / "kept"
    first = publish.publish_to(access, built, kept, said.append)
    assert first.outcome.verdict == PUBLISHED
    assert {chart.name.split()[0] for chart in first.outcome.charts} == set(publish.BASE)
    assert len(publishing.runner.runs) == len(SUITES) * len(first.outcome.charts)
    assert any(line.startswith("bag-player 0.1.3: static 1  passed") for line in said)
    with OciRegistry(installation.url, "argocd", installation.passwords["argocd"]) as registry:
        for chart in first.outcome.charts:
            digest = registry.manifest_digest(f"verified/{chart.artefact.chart}", chart.digest)
            assert digest == chart.digest
    with OciRegistry(installation.url, "suite-runner", installation.passwords["suite-runner"]) as registry:
        for one in built:
            [bill] = registry.attachments(f"robotkube/{one.name}", one.reference.partition("@")[2])
            assert (bill.artifact_type, bill.data) == (BILL_TYPE, BILL)
    files = {path.relative_to(kept).as_posix(): path.read_text() for path in kept.rglob("*.json")}
    assert files == first.outcome.evidence
    again = publish.publish_to(access, built, kept)
    assert again.outcome.verdict == UNCHANGED
    assert len(publishing.runner.runs) == len(SUITES) * len(first.outcome.charts)


@pytest.mark.thorough
def test_more_charts_come_with_what_they_replace_and_the_applications_they_run(
    publishing: Publishing, access: publish.PublishingAccounts, tmp_path: Path
) -> None:
    built = images(tmp_path, b"more")
    kept = tmp_path / "kept"
    older = publish.publish_to(access, built, kept, extra=["object-detection@0.1.2"])
    assert "object-detection 0.1.2" in {chart.name for chart in older.outcome.charts}
    newer = publish.publish_to(access, built, kept, extra=["object-detection", "object-tracking"])
    names = {chart.name for chart in newer.outcome.charts}
    assert names == {"object-detection 0.2.3", "object-tracking 0.1.2", "object-tracking 0.2.3"}
    assert "object-detection 0.1.2" in newer.outcome.unchanged
    assert "applications/environment-perception.yaml" in newer.outcome.applications
    catalogue = read_catalogue({path: text for path, text in publishing.main().items() if path.startswith(FOLDERS)})
    assert [v.version for v in catalogue.charts["object-detection"] if v.state == "verified"] == ["0.1.2", "0.2.3"]
    assert catalogue.problems == ()


def test_a_chart_that_is_not_there_is_named(access: publish.PublishingAccounts, tmp_path: Path) -> None:
    with pytest.raises(SetUpError, match=r"no chart object-detection@0.9.0; there are bag-player, .*@0.1.2"):
        publish.publish_to(access, images(tmp_path, b"x"), tmp_path / "kept", extra=["object-detection@0.9.0"])


@pytest.mark.thorough
def test_another_image_gives_other_charts_and_the_old_ones_stay(
    installation: Installation, publishing: Publishing, access: publish.PublishingAccounts, tmp_path: Path
) -> None:
    published = [publish.publish_to(access, images(tmp_path, content), tmp_path / "kept") for content in (b"a", b"b")]
    old, new = ({chart.digest for chart in one.outcome.charts} for one in published)
    assert not old & new
    with OciRegistry(installation.url, "argocd", installation.passwords["argocd"]) as registry:
        for chart in (chart for one in published for chart in one.outcome.charts):  # what runs stays there
            repository = f"verified/{chart.artefact.chart}"
            tag = build_tag(chart.artefact.version, chart.digest)
            assert registry.manifest_digest(repository, tag) == chart.digest
    catalogue = read_catalogue({path: text for path, text in publishing.main().items() if path.startswith(FOLDERS)})
    assert catalogue.assurance == "verified"
    for chart in published[1].outcome.charts:
        version = next(v for v in catalogue.charts[chart.artefact.chart] if v.version == chart.artefact.version)
        assert (version.state, version.digest) == ("verified", chart.digest)


def test_another_image_of_one_service_gives_that_chart_another_digest_alone(
    publishing: Publishing, access: publish.PublishingAccounts, tmp_path: Path
) -> None:
    first = publish.publish_to(access, images(tmp_path, b"before"), tmp_path / "kept")
    assert len(first.outcome.charts) == len(publish.BASE)
    before = len(publishing.runner.runs)
    second = publish.publish_to(access, images(tmp_path, b"before", mqtt_bridge=b"after"), tmp_path / "kept")
    assert [chart.name for chart in second.outcome.charts] == ["mqtt-bridge 0.2.3"]
    assert len(publishing.runner.runs) == before + len(SUITES)


def test_a_refusal_says_what_the_gate_found(
    publishing: Publishing, access: publish.PublishingAccounts, tmp_path: Path
) -> None:
    publishing.runner.checks["static"] = (Check("pods are restricted", False, "a privileged pod", "take it out"),)
    with pytest.raises(SetUpError, match=r"the gate refused to publish, see http(?s:.*)pods are restricted") as refusal:
        publish.publish_to(access, images(tmp_path, b"refused"), tmp_path / "kept")
    assert "take it out" in str(refusal.value)
    assert not (tmp_path / "kept").exists()


def test_an_image_that_no_one_built_is_named(access: publish.PublishingAccounts, tmp_path: Path) -> None:
    with pytest.raises(SetUpError, match=r"spec.images: no reference of mqtt-bridge"):
        publish.publish_to(access, [image(tmp_path, "other", b"x")], tmp_path / "kept")


def test_an_image_without_its_bill_is_refused(access: publish.PublishingAccounts, tmp_path: Path) -> None:
    built = images(tmp_path, b"no bill")
    built[0].archive.with_name(bills.FILE).unlink()
    with pytest.raises(SetUpError, match=r"bill-.*: missing; build the images again: make images"):
        publish.publish_to(access, built, tmp_path / "kept")


@pytest.mark.parametrize("account", [publish.ACCOUNT, publish.IMAGE_ACCOUNT])
def test_a_wrong_password_is_named(access: publish.PublishingAccounts, tmp_path: Path, account: str) -> None:
    charts, pusher = (
        replace(one, password="wrong") if one.username == account else one  # noqa: S106
        for one in (access.charts, access.images)
    )
    with pytest.raises(SetUpError, match=rf"\b{account}\b"):
        publish.publish_to(publish.PublishingAccounts(charts, pusher), images(tmp_path, b"x"), tmp_path / "k")


def test_the_key_is_made_once_for_its_user_alone(tmp_path: Path) -> None:
    path = evidence.key_file(tmp_path)
    text = path.read_bytes()
    assert path.stat().st_mode & 0o777 == 0o600
    assert [file.name for file in tmp_path.iterdir()] == ["key.pem"]
    key = evidence.signing_key(tmp_path)
    assert evidence.key_file(tmp_path).read_bytes() == text
    assert evidence.kept_folder(tmp_path) == tmp_path / key.key_id
    path.write_text("broken")
    with pytest.raises(SetUpError, match=r"no PEM private key.*; remove the file to get a new key"):
        evidence.signing_key(tmp_path)


class WaitingError(Exception):
    """The gate reported that the submission waits."""


def stop_when_waiting(line: str) -> None:
    if line.startswith("Waiting: "):
        raise WaitingError(line)


def test_what_runs_by_itself_waits_for_a_person(
    installation: Installation, publishing: Publishing, access: publish.PublishingAccounts, tmp_path: Path
) -> None:
    built = images(tmp_path, b"unapproved")
    path = "applications/proximity-operator.yaml"
    catalogue = installation.clone("gate", "robotkube/catalogue")
    if path in [entry.path for entry in _index(catalogue)]:
        removal = catalogue.commit({path: None}, "away\n", [catalogue.tip()])
        assert catalogue.push(removal, "refs/heads/main") == ""
    with pytest.raises(WaitingError, match="application proximity-operator"):
        publish.publish_to(replace(access, person=None), built, tmp_path / "kept", stop_when_waiting)
    outcome = publish.publish_to(access, built, tmp_path / "kept").outcome
    assert outcome.verdict == PUBLISHED
    assert path in outcome.applications
