"""Charts pulled, evidence attached, both copied from staging to verified: in a real registry (the forge's)."""

from __future__ import annotations

import json
import secrets
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import MANIFEST_TYPE, PackedChart, pack_chart
from robotkube.registry.charts.core.referrers import ARTEFACT_BYTES_MAX, EMPTY, EMPTY_TYPE, INDEX_TYPE, fallback_tag
from robotkube.registry.evidence.core.statements import ENVELOPE_MEDIA_TYPE, SUITE_ANNOTATION
from tests.stages import http_calls
from tests.stages.forge.gitea import ForgeProcess

pytestmark = pytest.mark.toolchain

TOGETHER = 8
TAG = "0.1.0_build"


def chart(template: str = "kind: ConfigMap\n") -> PackedChart:
    metadata = {"apiVersion": "v2", "name": "app", "version": "0.1.0"}
    files = {"Chart.yaml": json.dumps(metadata).encode(), "templates/a.yaml": template.encode()}
    return pack_chart("app", metadata, files)


@pytest.fixture
def organisations(forge_process: ForgeProcess) -> tuple[str, str]:
    account = (forge_process.administrator, forge_process.administrator_password)
    names = tuple(f"{kind}-{secrets.token_hex(4)}" for kind in ("staging", "verified"))
    for name in names:
        http_calls.post(f"{forge_process.url}/api/v1/orgs", json={"username": name}, auth=account).raise_for_status()
    return names[0], names[1]


@pytest.fixture
def registry(forge_process: ForgeProcess) -> Iterator[OciRegistry]:
    with OciRegistry(forge_process.url, forge_process.administrator, forge_process.administrator_password) as client:
        yield client


@pytest.fixture
def staging(registry: OciRegistry, organisations: tuple[str, str]) -> str:
    """The repository in staging that has the chart."""
    registry.push_chart(organisations[0], chart(), TAG)
    return f"{organisations[0]}/app"


def attach(registry: OciRegistry, repository: str, name: str, subject: str = "") -> str:
    data = canonical_json({"envelope": name})
    annotations = {SUITE_ANNOTATION: name}
    return registry.attach(repository, subject or chart().digest, ENVELOPE_MEDIA_TYPE, data, annotations)


def attached(registry: OciRegistry, repository: str) -> list[str]:
    return [attachment.annotations[SUITE_ANNOTATION] for attachment in registry.attachments(repository, chart().digest)]


def test_a_chart_comes_back_by_its_digest(registry: OciRegistry, staging: str) -> None:
    packed = chart()
    pulled = registry.pull_chart(staging, packed.digest)
    assert (pulled.digest, pulled.archive, pulled.metadata["name"]) == (packed.digest, packed.archive, "app")
    assert pulled.files["templates/a.yaml"] == b"kind: ConfigMap\n"
    assert registry.list(staging) == (TAG,)
    assert registry.manifest(staging, packed.digest) == packed.manifest
    assert registry.blob(staging, sha256(packed.config), 1000) == packed.config
    with pytest.raises(InputError, match="is longer than 10 bytes; it is not read"):
        registry.blob(staging, sha256(packed.config), 10)


def test_a_chart_that_is_not_there_is_named(registry: OciRegistry, staging: str) -> None:
    nothing = sha256(b"nothing")
    with pytest.raises(InputError, match=f"{staging} has no chart {nothing}; push it again"):
        registry.pull_chart(staging, nothing)
    with pytest.raises(InputError, match=r"has no manifest .* to attach to"):
        attach(registry, staging, "static", nothing)
    with pytest.raises(InputError, match=f"has no manifest {nothing}"):
        registry.manifest(staging, nothing)
    with pytest.raises(InputError, match=f"has no blob {nothing}"):
        registry.blob(staging, nothing, 1000)
    assert registry.attachments(staging, nothing) == []


def test_a_registry_that_is_away_is_not_the_same_as_a_missing_chart() -> None:
    with (
        OciRegistry("http://127.0.0.1:9", "gate", "x") as away,
        pytest.raises(UnavailableError, match=r"127\.0\.0\.1:9"),
    ):
        away.pull_chart("staging/app", chart().digest)


def test_what_is_attached_comes_back_in_order_and_once(registry: OciRegistry, staging: str) -> None:
    first = attach(registry, staging, "static")
    second = attach(registry, staging, "images")
    assert attach(registry, staging, "static") == first
    attachments = registry.attachments(staging, chart().digest)
    assert [attachment.digest for attachment in attachments] == [first, second]
    assert attachments[0].data == canonical_json({"envelope": "static"})
    assert (attachments[0].artifact_type, attachments[0].annotations) == (
        ENVELOPE_MEDIA_TYPE,
        {SUITE_ANNOTATION: "static"},
    )
    assert registry.manifest_digest(staging, chart().digest) == chart().digest


def test_the_list_is_the_index_of_the_specification(
    forge_process: ForgeProcess, registry: OciRegistry, staging: str
) -> None:
    digest = attach(registry, staging, "static")
    account = (forge_process.administrator, forge_process.administrator_password)
    address = f"{forge_process.url}/v2/{staging}/manifests"
    answer = http_calls.get(f"{address}/{fallback_tag(chart().digest)}", auth=account, headers={"Accept": INDEX_TYPE})
    index = answer.json()
    assert answer.headers["Content-Type"] == index["mediaType"] == INDEX_TYPE
    assert [(line["digest"], line["artifactType"]) for line in index["manifests"]] == [(digest, ENVELOPE_MEDIA_TYPE)]
    artefact = http_calls.get(f"{address}/{digest}", auth=account, headers={"Accept": MANIFEST_TYPE}).json()
    assert artefact["subject"]["digest"] == chart().digest
    assert artefact["config"] == {"mediaType": EMPTY_TYPE, "digest": sha256(EMPTY), "size": 2}


def test_two_at_once_keep_both(forge_process: ForgeProcess, registry: OciRegistry, staging: str) -> None:
    lock = threading.Lock()
    account = (forge_process.url, forge_process.administrator, forge_process.administrator_password)
    together = threading.Barrier(TOGETHER)

    def one(number: int) -> str:
        with OciRegistry(*account, lock) as own:
            together.wait(30)
            return attach(own, staging, f"suite-{number}")

    with ThreadPoolExecutor(TOGETHER) as pool:
        digests = list(pool.map(one, range(TOGETHER)))
    assert sorted(attachment.digest for attachment in registry.attachments(staging, chart().digest)) == sorted(digests)
    assert sorted(attached(registry, staging)) == [f"suite-{number}" for number in range(TOGETHER)]


def test_threads_may_share_a_client(registry: OciRegistry, staging: str) -> None:
    with ThreadPoolExecutor(TOGETHER) as pool:
        list(pool.map(lambda number: attach(registry, staging, f"suite-{number}"), range(TOGETHER)))
    assert sorted(attached(registry, staging)) == [f"suite-{number}" for number in range(TOGETHER)]


def test_a_chart_is_copied_with_the_named_attachments_and_no_others(
    registry: OciRegistry, staging: str, organisations: tuple[str, str]
) -> None:
    ours = [attach(registry, staging, name) for name in ("static", "summary")]
    attach(registry, staging, "by-a-publisher")
    target = f"{organisations[1]}/app"
    digest = chart().digest
    registry.copy_chart(staging, target, digest, TAG, ours)
    registry.copy_chart(staging, target, digest, TAG, ours)
    assert registry.manifest_digest(target, TAG) == digest
    assert registry.pull_chart(target, digest).archive == chart().archive
    assert attached(registry, target) == ["static", "summary"]
    assert [attachment.digest for attachment in registry.attachments(target, digest)] == ours
    assert attached(registry, staging) == ["static", "summary", "by-a-publisher"]


def test_a_copy_adds_to_what_is_attached_there(
    registry: OciRegistry, staging: str, organisations: tuple[str, str]
) -> None:
    first = attach(registry, staging, "static")
    target = f"{organisations[1]}/app"
    digest = chart().digest
    registry.copy_chart(staging, target, digest, TAG, [first])
    second = attach(registry, staging, "static-under-the-next-policy")
    registry.copy_chart(staging, target, digest, TAG, [second])
    assert [attachment.digest for attachment in registry.attachments(target, digest)] == [first, second]


def test_a_tag_is_never_overwritten_by_a_copy(
    registry: OciRegistry, staging: str, organisations: tuple[str, str]
) -> None:
    other = chart("kind: Secret\n")
    registry.push_chart(organisations[1], other, TAG)
    evidence = attach(registry, staging, "static")
    target = f"{organisations[1]}/app"
    with pytest.raises(InputError, match=rf"app:{TAG} is {other.digest}.*a version is never replaced"):
        registry.copy_chart(staging, target, chart().digest, TAG, [evidence])
    assert registry.manifest_digest(target, other.digest) == other.digest
    assert registry.manifest_digest(target, chart().digest) is None
    assert registry.attachments(target, chart().digest) == []


def test_an_attachment_that_is_not_there_stops_the_copy(
    registry: OciRegistry, staging: str, organisations: tuple[str, str]
) -> None:
    target = f"{organisations[1]}/app"
    with pytest.raises(InputError, match=rf"not attached to {staging}@{chart().digest}"):
        registry.copy_chart(staging, target, chart().digest, TAG, [sha256(b"nothing")])
    assert registry.list(target) == ()


def test_what_is_no_chart_is_not_pulled_and_what_is_too_large_not_attached(registry: OciRegistry, staging: str) -> None:
    evidence = attach(registry, staging, "static")
    with pytest.raises(InputError, match="no Helm chart"):
        registry.pull_chart(staging, evidence)
    with pytest.raises(InputError, match=f"at most {ARTEFACT_BYTES_MAX}"):
        registry.attach(staging, chart().digest, ENVELOPE_MEDIA_TYPE, b"x" * (ARTEFACT_BYTES_MAX + 1), {})


def test_an_account_without_the_right_is_told_so(forge_process: ForgeProcess, staging: str) -> None:
    with OciRegistry(forge_process.url, "", "") as nobody, pytest.raises(InputError, match="may not do this"):
        nobody.pull_chart(staging, chart().digest)
