"""The images suite against a real registry: what the image builds write, push and attach passes it."""

from __future__ import annotations

import json
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ci.images.building import BuiltImage, build_images
from robotkube.cli import main as cli
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.images.adapters import bills
from robotkube.registry.images.adapters.own_images import describe_image
from robotkube.registry.suites.adapters.kept_layers import KeptLayers
from robotkube.registry.suites.loops.images import ImagesSuite
from robotkube.registry.suites.ports.suites import Subject
from tests.stages import http_calls
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.programs import program
from tests.stages.registry import wrong_interfaces
from tests.stages.registry.charts_under_test import subject_of
from tests.stages.registry.made_archives import write_archive
from tests.stages.registry.made_layers import COMPRESSIONS, ELF, FILES, made_layer
from tests.stages.registry.publications import write_sources
from tests.stages.registry.wrong_charts import MISTAKES, wrong_chart

pytestmark = pytest.mark.toolchain

HOST = "forge.invalid:3000"


@pytest.fixture
def organisation(forge_process: ForgeProcess) -> str:
    name = f"images-{secrets.token_hex(4)}"
    account = (forge_process.administrator, forge_process.administrator_password)
    http_calls.post(f"{forge_process.url}/api/v1/orgs", json={"username": name}, auth=account).raise_for_status()
    return name


@pytest.fixture
def registry(forge_process: ForgeProcess) -> Iterator[OciRegistry]:
    with OciRegistry(forge_process.url, forge_process.administrator, forge_process.administrator_password) as client:
        yield client


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> BuiltImage:
    """A real image of one Go program; nothing has to be fetched for it."""
    folder = tmp_path_factory.mktemp("image")
    (folder / "bin").mkdir()
    shutil.copyfile(program("ferretdb"), folder / "bin" / "ferretdb")
    return build_images(folder / "bin", folder / "cache", ["ferretdb"])["ferretdb"]


def checks_of(registry: OciRegistry, subject: Subject) -> dict[str, Check]:
    with tempfile.TemporaryDirectory() as folder:
        suite = ImagesSuite(registry, KeptLayers(Path(folder)), HOST, Jinja2Templates().render)
        return {check.name: check for check in suite.run(subject)}


def failed(registry: OciRegistry, subject: Subject) -> list[str]:
    return [name for name, check in checks_of(registry, subject).items() if not check.passed]


def test_the_bill_names_the_modules_of_a_go_program(image: BuiltImage) -> None:
    components = {one.get("bom-ref", one["name"]): one for one in json.loads(image.bill.read_bytes())["components"]}
    assert components["program:/ferretdb"]["version"] == "0.1.0"
    assert any(reference.startswith("pkg:golang/github.com/alecthomas/kong@v") for reference in components)


def test_an_image_passes_once_its_bill_is_attached(
    registry: OciRegistry, organisation: str, image: BuiltImage, tmp_path: Path
) -> None:
    repository = f"{organisation}/ros"
    assert registry.push_image(repository, image.archive) == image.digest
    images = {"ros": f"{HOST}/{repository}@{image.digest}"}
    chart = wrong_interfaces.write_chart("text-relay", {}, tmp_path / "new")
    subject = subject_of(*chart, tmp_path, images)
    assert failed(registry, subject) == ["bill-of-materials"]
    attached = bills.attach_bill(registry, repository, image.digest, image.archive)
    assert bills.attach_bill(registry, repository, image.digest, image.archive) == attached
    assert failed(registry, subject) == []
    gone = {"ros": f"{HOST}/{repository}@sha256:{'0' * 64}"}
    assert failed(registry, subject_of(*chart, tmp_path, gone)) == ["exist"]


Try = Callable[..., dict[str, dict[str, Any]]]


@pytest.fixture
def try_(
    forge_process: ForgeProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Try:
    """`registry try` of a new chart with a reference of its image: the rows of its suites, with the exit code."""
    monkeypatch.setenv("ROBOTKUBE_HELM", program("helm"))
    write_sources(tmp_path / "tried", "delivery", "--services", "plan")

    def _try(reference: str, password: str = forge_process.administrator_password) -> dict[str, dict[str, Any]]:
        (tmp_path / "password").write_text(password)
        (tmp_path / "images.yaml").write_text(json.dumps({"ros": reference}))
        words = ["--images", str(tmp_path / "images.yaml"), "--password-file", str(tmp_path / "password")]
        words += ["--forge-url", forge_process.url, "--username", forge_process.administrator, "-o", "json"]
        capsys.readouterr()
        code = cli.main(["registry", "try", str(tmp_path / "tried/charts/apps/delivery-plan"), *words])
        return {row["suite"]: {**row, "code": code} for row in json.loads(capsys.readouterr().out)["suites"]}

    return _try


def test_images_are_tried_where_a_forge_is_reached(
    try_: Try, registry: OciRegistry, organisation: str, image: BuiltImage
) -> None:
    repository = f"{organisation}/ros"
    registry.push_image(repository, image.archive)
    reference = f"{HOST}/{repository}@{image.digest}"
    row = try_(reference)["images"]
    assert (row["code"], row["outcome"]) == (1, "failed")
    assert [failure["name"] for failure in row["failures"]] == ["bill-of-materials"]
    bills.attach_bill(registry, repository, image.digest, image.archive)
    rows = try_(reference)
    assert {suite: row["outcome"] for suite, row in rows.items()} == {
        "static": "passed",
        "images": "passed",
        "interface": "not run",
        "install": "not run",
    }
    assert rows["images"]["code"] == 0
    gone = try_(f"{HOST}/{repository}@sha256:{'0' * 64}")["images"]
    assert (gone["code"], [failure["name"] for failure in gone["failures"]]) == (1, ["exist"])


def test_images_that_the_account_may_not_read_are_not_tried(
    try_: Try, registry: OciRegistry, organisation: str, image: BuiltImage
) -> None:
    registry.push_image(f"{organisation}/ros", image.archive)
    row = try_(f"{HOST}/{organisation}/ros@{image.digest}", password="wrong")["images"]  # noqa: S106
    assert (row["code"], row["outcome"]) == (0, "not run")
    assert "may not do this" in row["reason"]


def test_the_bill_of_another_image_does_not_pass_for_one(
    registry: OciRegistry, organisation: str, tmp_path: Path
) -> None:
    repository = f"{organisation}/own"
    archive = tmp_path / "own.tar"
    write_archive(archive, [COMPRESSIONS["gzip"](made_layer(FILES))])
    foreign = json.loads(describe_image(archive, "own").bill.read_bytes())
    added = write_archive(archive, [COMPRESSIONS["gzip"](made_layer({**FILES, "usr/bin/added": ELF}))])
    foreign["metadata"]["component"]["hashes"][0]["content"] = added.removeprefix("sha256:")
    registry.push_image(repository, archive)
    bills.attach_document(registry, repository, added, json.dumps(foreign).encode())
    chart = wrong_interfaces.write_chart("text-relay", {}, tmp_path / "new")
    images = {"ros": f"{HOST}/{repository}@{added}"}
    check = checks_of(registry, subject_of(*chart, tmp_path, images))["bill-of-materials"]
    assert "lacks 1 ELF file of the image: /usr/bin/added" in check.found


@pytest.mark.parametrize("name", [name for name, mistake in MISTAKES.items() if mistake.suite == "images"])
def test_a_wrong_chart_fails_in_words(
    registry: OciRegistry, organisation: str, image: BuiltImage, tmp_path: Path, name: str
) -> None:
    mistake = MISTAKES[name]
    repository = f"{organisation}/ros"
    registry.push_image(repository, image.archive)
    bills.attach_bill(registry, repository, image.digest, image.archive)
    images = {"ros": f"{HOST}/{repository}@{image.digest}"}
    subject = subject_of(*wrong_chart(name, tmp_path / "wrong"), tmp_path, images)
    checks = checks_of(registry, subject)
    assert [one for one, check in checks.items() if not check.passed] == [mistake.check]
    assert mistake.found in checks[mistake.check].found
    assert mistake.fix in checks[mistake.check].fix
