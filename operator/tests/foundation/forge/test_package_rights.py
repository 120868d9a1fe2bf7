"""Who may read and write which organisation of the registry: what the platform chart asks for, on a real forge."""

import hashlib
import json
from collections.abc import Iterator

import httpx
import pytest

from tests.stages import http_calls
from tests.stages.attacks import shown
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import ACCOUNTS, PACKAGES, Installation

pytestmark = pytest.mark.toolchain

PACKAGE = "rights"
MANIFEST = "application/vnd.oci.image.manifest.v1+json"
EMPTY = b"{}"
LEVELS = {
    (account, organisation): PACKAGES[organisation].get(account) for account in ACCOUNTS for organisation in PACKAGES
}


def digest_of(data: bytes) -> str:
    return "sha256:" + hashlib.sha256(data).hexdigest()


def manifest() -> bytes:
    empty = {"mediaType": "application/vnd.oci.empty.v1+json", "digest": digest_of(EMPTY), "size": len(EMPTY)}
    return json.dumps({"schemaVersion": 2, "mediaType": MANIFEST, "config": empty, "layers": [empty]}).encode()


def upload(registry: httpx.Client, organisation: str, package: str) -> tuple[int, int]:
    """Status codes of a blob's and a manifest's upload."""
    path = f"/v2/{organisation}/{package}"
    blob = registry.post(f"{path}/blobs/uploads/", params={"digest": digest_of(EMPTY)}, content=EMPTY)
    return blob.status_code, put(registry, f"{path}/manifests/1").status_code


def put(registry: httpx.Client, path: str) -> httpx.Response:
    """The answer to a manifest's upload."""
    return registry.put(path, content=manifest(), headers={"Content-Type": MANIFEST})


@pytest.fixture(scope="module", autouse=True)
def _a_package_in_every_organisation(installation: Installation, forge_process: ForgeProcess) -> Iterator[None]:
    owner = (forge_process.administrator, forge_process.administrator_password)
    with http_calls.client(base_url=installation.url, auth=owner, timeout=30) as registry:
        for organisation in PACKAGES:
            assert upload(registry, organisation, PACKAGE) == (201, 201)
        yield
        for organisation in PACKAGES:
            address = f"/api/v1/packages/{organisation}/container/{PACKAGE}"
            assert registry.delete(f"{address}/1").status_code == 204


@pytest.mark.parametrize(("account", "organisation"), LEVELS)
def test_reading(installation: Installation, account: str, organisation: str) -> None:
    who = (account, installation.passwords[account])
    path = f"{installation.url}/v2/{organisation}/{PACKAGE}"
    # Gitea shows an organisation's packages to everybody who is in one of its teams, so also in those of a repository.
    repositories = [one for one in installation.setup.repositories if one.organisation == organisation]
    member = any(account in repository.access for repository in repositories)
    allowed = LEVELS[account, organisation] is not None or member
    for what in ("manifests/1", f"manifests/{digest_of(manifest())}", f"blobs/{digest_of(EMPTY)}", "tags/list"):
        answer = http_calls.get(f"{path}/{what}", auth=who, headers={"Accept": MANIFEST}, timeout=30)
        assert answer.status_code == (200 if allowed else 401), (what, answer.text)


@pytest.mark.parametrize(("account", "organisation"), LEVELS)
def test_writing(installation: Installation, account: str, organisation: str) -> None:
    who = (account, installation.passwords[account])
    allowed = LEVELS[account, organisation] == "write"
    package = f"of-{account}"
    with http_calls.client(base_url=installation.url, auth=who, timeout=30) as registry:
        assert upload(registry, organisation, package) == ((201, 201) if allowed else (401, 401))
        path = f"/v2/{organisation}/{package if allowed else PACKAGE}/manifests/{digest_of(manifest())}"
        assert registry.delete(path).status_code == (202 if allowed else 401)
        if (account, organisation) == ("publisher", "robotkube"):
            answer = put(registry, f"/v2/robotkube/{package}/manifests/1")
            said = f"{answer.status_code} {answer.reason_phrase}: {answer.text}"
            shown("elsewhere", said, "platform-image-pushed")
    there = http_calls.get(
        f"{installation.url}/v2/{organisation}/{PACKAGE}/tags/list", auth=reader(installation, organisation)
    )
    assert there.json()["tags"] == ["1"]


def reader(installation: Installation, organisation: str) -> tuple[str, str]:
    account = next(name for name, level in PACKAGES[organisation].items() if level == "read")
    return account, installation.passwords[account]


@pytest.mark.parametrize("organisation", PACKAGES)
def test_nobody_reads_without_an_account(installation: Installation, organisation: str) -> None:
    assert http_calls.get(f"{installation.url}/v2/{organisation}/{PACKAGE}/tags/list").status_code == 401


def test_the_suite_runner_sees_no_repository(installation: Installation) -> None:
    who = ("suite-runner", installation.passwords["suite-runner"])
    for repository in ("robotkube/deployment", "robotkube/catalogue"):
        address = f"{installation.url}/api/v1/repos/{repository}"
        assert http_calls.get(address, auth=who).status_code == 404
        git = f"{installation.url}/{repository}.git/info/refs?service=git-upload-pack"
        assert http_calls.get(git, auth=who).status_code in (401, 403, 404)


def test_argo_cd_sees_the_deployment_repository_only(installation: Installation) -> None:
    who = ("argocd", installation.passwords["argocd"])
    codes = [
        http_calls.get(f"{installation.url}/api/v1/repos/robotkube/{name}", auth=who).status_code
        for name in ("deployment", "catalogue")
    ]
    assert codes == [200, 404]
