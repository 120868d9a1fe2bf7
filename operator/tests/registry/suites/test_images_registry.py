"""The images suite against a real registry: what the image builds write, push and attach passes it."""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from ci.images import bills
from ci.images.building import BuiltImage, build_images
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.loops.images import ImagesSuite
from robotkube.registry.suites.ports.suites import Subject
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.programs import program
from tests.stages.registry import wrong_interfaces
from tests.stages.registry.charts_under_test import subject_of
from tests.stages.registry.wrong_charts import MISTAKES, wrong_chart

pytestmark = pytest.mark.toolchain

HOST = "forge.invalid:3000"


@pytest.fixture
def organisation(forge_process: ForgeProcess) -> str:
    name = f"images-{secrets.token_hex(4)}"
    account = (forge_process.administrator, forge_process.administrator_password)
    httpx.post(f"{forge_process.url}/api/v1/orgs", json={"username": name}, auth=account).raise_for_status()
    return name


@pytest.fixture
def registry(forge_process: ForgeProcess) -> Iterator[OciRegistry]:
    with OciRegistry(forge_process.url, forge_process.administrator, forge_process.administrator_password) as found:
        yield found


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> BuiltImage:
    """A real image of one Go program; nothing has to be fetched for it."""
    folder = tmp_path_factory.mktemp("image")
    (folder / "bin").mkdir()
    shutil.copyfile(program("ferretdb"), folder / "bin" / "ferretdb")
    return build_images(folder / "bin", folder / "cache", ["ferretdb"])["ferretdb"]


def checks_of(registry: OciRegistry, subject: Subject) -> dict[str, Check]:
    return {check.name: check for check in ImagesSuite(registry, HOST, Jinja2Templates().render).run(subject)}


def failed(registry: OciRegistry, subject: Subject) -> list[str]:
    return [name for name, check in checks_of(registry, subject).items() if not check.passed]


def test_the_bill_names_the_modules_of_a_go_program(image: BuiltImage) -> None:
    found = {one["bom-ref"]: one for one in json.loads(image.bill.read_bytes())["components"]}
    assert found["program:/ferretdb"]["version"] == "0.1.0"
    assert any(reference.startswith("pkg:golang/github.com/alecthomas/kong@v") for reference in found)


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


@pytest.mark.parametrize("name", [name for name, mistake in MISTAKES.items() if mistake.suite == "images"])
def test_a_wrong_chart_fails_in_words(
    registry: OciRegistry, organisation: str, image: BuiltImage, tmp_path: Path, name: str
) -> None:
    mistake, repository = MISTAKES[name], f"{organisation}/ros"
    registry.push_image(repository, image.archive)
    bills.attach_bill(registry, repository, image.digest, image.archive)
    images = {"ros": f"{HOST}/{repository}@{image.digest}"}
    subject = subject_of(*wrong_chart(name, tmp_path / "wrong"), tmp_path, images)
    checks = checks_of(registry, subject)
    assert [one for one, check in checks.items() if not check.passed] == [mistake.check]
    assert mistake.found in checks[mistake.check].found
    assert mistake.fix in checks[mistake.check].fix
