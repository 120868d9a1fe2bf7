"""Real builds: a small one always, all images in the thorough set."""

import json
import os
import re
import shutil
import subprocess
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ci import web
from ci.images import machine
from ci.images.building import NAMES, build_images
from ci.images.built import BuiltImage
from ci.images.catalogue import IMAGES, TOP
from ci.images.services import GROUND, SERVICES
from ci.reference import message_types
from robotkube.registry.images.adapters import buildah
from robotkube.registry.suites.core import image_checks
from robotkube.robots.ros.core.packaged_types import PACKAGED_IMAGES, PACKAGED_TYPES
from tests.stages import programs
from tests.stages.registry.publications import write_sources

pytestmark = pytest.mark.processes

ADDRESS = re.compile(rb"https?://([A-Za-z0-9.-]+)")
PUBLIC = {b"deb.debian.org", b"security.debian.org", b"debian.org"}


@pytest.fixture
def tools(tmp_path: Path) -> Path:
    folder = tmp_path / "bin"
    folder.mkdir()
    shutil.copyfile("/bin/true", folder / "ferretdb")
    return folder


@contextmanager
def elsewhere(tools: Path, folder: Path) -> Iterator[Path]:
    """The same programs in another folder, with other times and modes, built with another user's settings."""
    shutil.copytree(tools, folder)
    for program in folder.iterdir():
        program.chmod(0o700)
        os.utime(program, (1, 1))
    before = os.umask(0o077)
    with pytest.MonkeyPatch.context() as changed:
        changed.setenv("LC_ALL", "POSIX")
        changed.setenv("TZ", "Asia/Tokyo")
        try:
            yield folder
        finally:
            os.umask(before)


def test_two_folders_give_one_digest_and_the_second_run_is_cached(tools: Path, tmp_path: Path) -> None:
    first = build_images(tools, tmp_path / "one", ["ferretdb"])["ferretdb"]
    with elsewhere(tools, tmp_path / "other") as programs_there:
        second = build_images(programs_there, tmp_path / "two", ["ferretdb"])["ferretdb"]
    assert first.reference == second.reference
    assert first.archive.read_bytes() == second.archive.read_bytes()
    inode = first.archive.stat().st_ino
    again = build_images(tools, tmp_path / "one", ["ferretdb"])["ferretdb"]
    assert again.archive.stat().st_ino == inode
    lock = json.loads((tmp_path / "one" / "images.json").read_text())
    files = {"archive": str(first.archive), "bill": str(first.bill)}
    assert lock == {"ferretdb": {"reference": first.reference, **files, "size": first.size}}
    assert first.bill.read_bytes() == second.bill.read_bytes()


def content(image: BuiltImage, path: str) -> bytes:
    """A file of the image's layers, empty when there is none."""
    for name in (image.archive, *([image.ground] if image.ground else [])):
        with tarfile.open(name) as archive:
            blobs = {f"blobs/{digest.replace(':', '/')}" for digest in image.layers}
            for blob in sorted(blobs & set(archive.getnames())):
                with tarfile.open(fileobj=archive.extractfile(blob)) as layer:
                    if path in layer.getnames():
                        file = layer.extractfile(path)
                        return file.read() if file else b""
    return b""


def has_licences(image: BuiltImage) -> bool:
    return all(content(image, f"licenses/{name}") == (TOP / name).read_bytes() for name in ("LICENSE", "NOTICE"))


def test_an_image_that_stands_on_nothing_has_the_licences(tools: Path, tmp_path: Path) -> None:
    assert has_licences(build_images(tools, tmp_path / "cache", ["ferretdb"])["ferretdb"])


def test_changed_contents_change_key_and_digest(tools: Path, tmp_path: Path) -> None:
    first = build_images(tools, tmp_path / "cache", ["ferretdb"])["ferretdb"]
    with (tools / "ferretdb").open("ab") as file:
        file.write(b"more")
    second = build_images(tools, tmp_path / "cache", ["ferretdb"])["ferretdb"]
    assert first.digest != second.digest
    assert first.archive != second.archive


def test_a_failing_build_shows_its_output_and_leaves_nothing(tools: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    (tmp_path / "Dockerfile").write_text("FROM scratch\nCOPY absent /\n")
    cache.mkdir()
    builder = buildah.Buildah(cache / "storage", cache / "log")
    with pytest.raises(buildah.BuildError, match=r"(?s)ended with code .*absent"):
        builder.build(tmp_path, tmp_path / "Dockerfile", "localhost/x:1", {}, (), fresh=False)
    builder.clean()
    words = ["buildah", "--root", str(cache / "storage/root"), "--runroot", str(cache / "storage/run")]
    left = subprocess.run(
        [*words, "--storage-driver", "overlay", "containers", "-q"], capture_output=True, text=True, check=True
    )
    assert left.stdout.strip() == ""


def test_the_dockerfile_of_a_new_service_builds_what_the_images_suite_asks_for(tmp_path: Path) -> None:
    """On nothing, in place of an image with ROS."""
    write_sources(tmp_path / "sources", "delivery", "--services", "order,plan")
    chart, cache = tmp_path / "sources" / "charts" / "apps" / "delivery-plan", tmp_path / "cache"
    cache.mkdir()
    builder = buildah.Buildah(cache / "storage", cache / "log")
    tag = "localhost/delivery-plan:1"
    builder.build(chart, chart / "Dockerfile", tag, {"BASE": "scratch"}, (), fresh=False)
    words = ["buildah", "--root", str(cache / "storage/root"), "--runroot", str(cache / "storage/run")]
    words += ["--storage-driver", "overlay", "inspect", "--type", "image", tag]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    settings = json.loads(done.stdout)["OCIv1"]["config"]
    assert settings["Entrypoint"] == ["python3", "/opt/delivery-plan/node.py"]
    assert list(image_checks.user_problems(tag, settings)) == []
    assert list(image_checks.label_problems(tag, settings)) == []
    builder.export(tag, cache / "layout")
    names: set[str] = set()
    for blob in (cache / "layout").iterdir():
        if tarfile.is_tarfile(blob):
            with tarfile.open(blob) as layer:
                names |= set(layer.getnames())
    assert {"opt/delivery-plan/node.py", "opt/delivery-plan/answers.py"} <= names


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, BuiltImage]]:
    return [build_images(programs.folder(), tmp_path_factory.mktemp("images")) for _ in range(2)]


@pytest.mark.thorough
def test_all_images_built_twice_from_nothing_have_the_same_digests(twice: list[dict[str, BuiltImage]]) -> None:
    keys = [{name: image.archive.parent.name for name, image in built.items()} for built in twice]
    assert keys[0] == keys[1], "the sources were edited while this test was building; run it on a quiet tree"
    references = [{name: image.reference for name, image in built.items()} for built in twice]
    assert references[0] == references[1]
    bills = [{name: image.bill.read_bytes() for name, image in built.items()} for built in twice]
    assert bills[0] == bills[1]
    assert set(references[0]) == set(NAMES)


@pytest.mark.thorough
def test_images_share_the_base_layer_and_stay_small(twice: list[dict[str, BuiltImage]]) -> None:
    built = twice[0]
    base = next(iter(built["base"].layers))
    for image in IMAGES:
        if image.stands_on and image.name != "pause":
            assert next(iter(built[image.name].layers)) == base
    for service in SERVICES:
        assert list(built[service.name].layers)[:-1] == list(built[GROUND].layers)[:-1]
        assert list(built[service.name].layers.values())[-1] < 3_500_000
    layers = {digest: size for image in built.values() for digest, size in image.layers.items()}
    built_pages = web.built()  # of the forge, where `make web` has built them
    pages = sum(path.stat().st_size for path in built_pages.rglob("*") if path.is_file()) if built_pages else 0
    assert sum(layers.values()) < 842_000_000 + pages  # the suites bring helm, 60 MB, the gate chart-renderer, 36 MB


def paths_of(image: BuiltImage) -> Iterator[str]:
    """The paths of all files of the image's layers."""
    for name in (image.archive, *([image.ground] if image.ground else [])):
        with tarfile.open(name) as archive:
            blobs = {f"blobs/{digest.replace(':', '/')}" for digest in image.layers}
            for blob in sorted(blobs & set(archive.getnames())):
                with tarfile.open(fileobj=archive.extractfile(blob)) as layer:
                    yield from layer.getnames()


@pytest.mark.thorough
def test_images_know_the_message_types_that_are_listed(twice: list[dict[str, BuiltImage]]) -> None:
    listed = {package: tuple(names.split()) for package, names in PACKAGED_TYPES.items()}
    known = {name: message_types.types_among(paths_of(image)) for name, image in twice[0].items()}
    assert {name for name, types in known.items() if types} == PACKAGED_IMAGES
    assert all(types == listed for types in known.values() if types)


@pytest.mark.thorough
def test_every_image_has_the_licences(twice: list[dict[str, BuiltImage]]) -> None:
    assert [name for name, image in twice[0].items() if not has_licences(image)] == []


@pytest.mark.thorough
def test_no_address_of_the_machine_is_left_in_an_image(twice: list[dict[str, BuiltImage]]) -> None:
    sources = machine.debian_sources()
    lent = sources.read_bytes() if sources else b""
    lent += "\n".join(value for name, value in os.environ.items() if name.startswith("PIP_")).encode()
    hosts = set(ADDRESS.findall(lent)) - PUBLIC
    for image in twice[0].values():
        data = image.archive.read_bytes()
        assert not [host for host in hosts if host in data], image.name
        assert machine.MOUNTED.encode() not in data, image.name
