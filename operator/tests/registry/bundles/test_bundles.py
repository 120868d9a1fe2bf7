"""Bundles: what they hold is listed, each blob is there once, and everything has the digest that it had before."""

from __future__ import annotations

import io
import json
import re
import tarfile
from pathlib import Path

import pytest

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.bundles.adapters.accounts import RegistryAccount, given_account, kept_account
from robotkube.registry.bundles.adapters.layouts import Layout, read_bundle
from robotkube.registry.bundles.adapters.loading import load_k3s, write_images
from robotkube.registry.bundles.adapters.making import BundleMaker
from robotkube.registry.bundles.core.archives import archive_name, is_archive
from robotkube.registry.bundles.core.contents import (
    CHART,
    CONTENTS_TYPE,
    IMAGE,
    BundleContents,
    BundleItem,
    read_contents,
    write_contents,
)
from robotkube.registry.bundles.core.places import RegistryPlace, read_place
from robotkube.registry.bundles.loops.comparing import differences
from robotkube.registry.charts.adapters.oci import OciRegistry, read_layout
from robotkube.registry.images.adapters.bills import attach_document
from tests.stages.registry.asking_registry import AskingRegistry, running
from tests.stages.registry.made_archives import write_archive
from tests.stages.registry.made_bundles import EVIDENCE, PREFIX, SHARED, VERSION, chart, made, without

FOREIGN = "application/vnd.docker.image.rootfs.foreign.diff.tar.gzip"


def test_everything_is_listed_with_the_digests_that_it_had(tmp_path: Path) -> None:
    bundle = made(tmp_path)
    contents = bundle.contents
    assert [(item.name, item.repository) for item in contents.of(CHART)] == [
        ("bag-player", "charts/bag-player"),
        ("mqtt-bridge", "charts/mqtt-bridge"),
        ("robotkube", "robotkube"),
    ]
    assert contents.of(CHART)[1].digest == chart("mqtt-bridge").digest
    assert [one.title for one in contents.of(CHART)[1].attached] == ["evidence: static", "evidence: summary"]
    assert contents.of(IMAGE)[1].digest == read_layout(tmp_path / "platform.tar")[1]
    assert contents.references()["gate"] == f"{PREFIX}/gate@{contents.of(IMAGE)[0].digest}"
    assert read_contents(write_contents(contents), "contents") == contents


def test_a_tag_that_people_name_is_the_version_and_others_follow_from_the_content(tmp_path: Path) -> None:
    tags = {item.name: item.tag for item in made(tmp_path).contents.items}
    assert tags["robotkube"] == VERSION
    assert tags["mqtt-bridge"] == f"0.2.0_{chart('mqtt-bridge').digest[7:19]}"


def test_what_two_images_share_is_there_once(tmp_path: Path) -> None:
    bundle = made(tmp_path)
    with tarfile.open(bundle.path) as tar:
        names = tar.getnames()
    assert len(names) == len(set(names))
    assert f"blobs/{sha256(SHARED).replace(':', '/')}" in names


def test_the_same_parts_make_the_same_bytes(tmp_path: Path) -> None:
    first, second = (made(tmp_path, name).path.read_bytes() for name in ("one.tar", "two.tar"))
    assert first == second


def test_artefacts_have_the_digests_that_the_forge_gives_them(tmp_path: Path) -> None:
    """A commit names a chart's evidence by digest: in the bundle it is the same artefact."""
    bundle = made(tmp_path)
    with running(AskingRegistry(tokens=False)) as asking, OciRegistry(asking.url, "", "") as registry:
        registry.push_image("robotkube/platform", tmp_path / "platform.tar")
        platform = bundle.contents.of(IMAGE)[1]
        attached = attach_document(
            registry, "robotkube/platform", platform.digest, (tmp_path / "bill.json").read_bytes()
        )
    assert [one.digest for one in platform.attached] == [attached]


def test_the_index_names_what_is_attached_so_that_it_is_found(tmp_path: Path) -> None:
    """Programs that copy a layout find artefacts by what its index names."""
    bundle = made(tmp_path)
    with tarfile.open(bundle.path) as tar:
        index = json.load(tar.extractfile("index.json"))  # type: ignore[arg-type]
    named = {entry["digest"] for entry in index["manifests"]}
    assert named == {bundle.digest, *bundle.contents.digests()}
    [artefact] = [one for item in bundle.contents.of(IMAGE)[:1] for one in item.attached]
    assert json.loads(bundle.read(artefact.digest))["subject"]["digest"] == bundle.contents.of(IMAGE)[0].digest


def test_an_image_without_one_of_its_layers_is_not_bundled(tmp_path: Path) -> None:
    write_archive(tmp_path / "image.tar", [SHARED])
    without(tmp_path / "image.tar", SHARED)
    (tmp_path / "bill.json").write_bytes(b"{}")
    with pytest.raises(InputError, match=r"has no blob sha256:[0-9a-f]{64}; build the images again: make images"):
        BundleMaker(VERSION, PREFIX).add_image("image", tmp_path / "image.tar", tmp_path / "bill.json")


def test_a_changed_blob_is_found(tmp_path: Path) -> None:
    bundle = made(tmp_path)
    bundle.check()
    blob = bundle.blobs[sha256(SHARED)]
    with bundle.path.open("r+b") as file:
        file.seek(blob.offset)
        file.write(b"A")
    with pytest.raises(InputError, match=f"{sha256(SHARED)} has other bytes than it should"):
        read_bundle(bundle.path).check()


def test_an_archive_whose_blobs_changed_is_not_bundled(tmp_path: Path) -> None:
    write_archive(tmp_path / "image.tar", [SHARED])
    blob = read_layout(tmp_path / "image.tar")[0][sha256(SHARED)]
    with (tmp_path / "image.tar").open("r+b") as file:
        file.seek(blob.offset)
        file.write(b"A")
    (tmp_path / "bill.json").write_bytes(b"{}")
    maker = BundleMaker(VERSION, PREFIX)
    maker.add_image("image", tmp_path / "image.tar", tmp_path / "bill.json")
    with pytest.raises(InputError, match=r"image\.tar: blob sha256:.* has other bytes than it should"):
        maker.write(tmp_path / "bundle.tar")
    assert not (tmp_path / "bundle.tar").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"text", "no OCI layout archive"),
        (None, r"no bundle: its index\.json names 0 lists of contents; make one: make bundle"),
    ],
)
def test_what_is_no_bundle(tmp_path: Path, text: bytes | None, words: str) -> None:
    path = tmp_path / "bundle.tar"
    if text is None:
        write_archive(path, [b"layer"])
    else:
        path.write_bytes(text)
    with pytest.raises(InputError, match=words):
        read_bundle(path)


def test_a_bundle_that_lacks_a_layer_is_refused(tmp_path: Path) -> None:
    bundle = made(tmp_path)
    without(bundle.path, SHARED)
    with pytest.raises(InputError, match=f"lacks 1 of its parts, such as {sha256(SHARED)}"):
        read_bundle(bundle.path)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (b"[]", "no list of a bundle's contents"),
        (b'{"format":2}', "format: 2 is not 1; use the program of its version"),
        (
            b'{"format":1,"version":"1","prefix":"x","items":[{"kind":"image","name":"a","version":"1","digest":"x",'
            b'"size":1,"attached":[]}]}',
            "items: a: kind 'image' or a digest is not known here",
        ),
    ],
)
def test_a_list_of_another_form_is_refused(document: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_contents(document, "contents")


def test_a_version_leads_to_no_other_file(tmp_path: Path) -> None:
    """`bundle load --k3s` makes a file's name of it."""
    BundleMaker("1/../../outside", PREFIX).write(tmp_path / "bundle.tar")
    with pytest.raises(InputError, match=r"version: '1/\.\./\.\./outside' is none: a digit, then"):
        read_bundle(tmp_path / "bundle.tar")


def test_a_version_makes_an_archive_that_is_known_as_one(tmp_path: Path) -> None:
    BundleMaker("demo", PREFIX).write(tmp_path / "bundle.tar")
    with pytest.raises(InputError, match="version: 'demo' is none: a digit, then letters"):
        read_bundle(tmp_path / "bundle.tar")
    assert is_archive(archive_name(BundleContents("0.1.0-rc.1+b", PREFIX, ())))


@pytest.mark.parametrize(
    ("items", "prefix", "words"),
    [
        ([("image", "../../elsewhere", "1")], PREFIX, "items: image '../../elsewhere' '1': no name with a version"),
        ([("chart", "one", "1/2")], PREFIX, "items: chart 'one' '1/2': no name with a version"),
        ([("image", "one", "1"), ("image", "one", "2")], PREFIX, "items: image one stands 2 times"),
        ([("chart", "one", "1"), ("chart", "one", "1")], PREFIX, "items: chart one stands 2 times"),
        ([], "", "prefix: '' is not of the form HOST/PATH"),
    ],
)
def test_a_list_makes_no_other_places(items: list[tuple[str, str, str]], prefix: str, words: str) -> None:
    """Of names, versions and prefix follow repositories, tags and what is replaced in manifests."""
    listed = tuple(BundleItem(*item, "sha256:" + "0" * 64, 1) for item in items)
    with pytest.raises(InputError, match=re.escape(words)):
        read_contents(write_contents(BundleContents("1", prefix, listed)), "contents")


def with_image(path: Path, manifest: object) -> Path:
    """A bundle with an image of this manifest."""
    layout = Layout()
    item = BundleItem(IMAGE, "one", VERSION, layout.add(canonical_json(manifest)), 1)
    listing = write_contents(BundleContents(VERSION, PREFIX, (item,)))
    parts = {"config": part(b"{}"), "layers": [part(listing)]}
    for blob in (b"{}", b"layer", listing):
        layout.add(blob)
    layout.name(layout.add(canonical_json(parts)), CONTENTS_TYPE)
    layout.write(path)
    return path


def part(data: bytes, **more: object) -> dict[str, object]:
    return {"digest": sha256(data), "size": len(data), **more}


@pytest.mark.parametrize(
    ("manifest", "words"),
    [
        ([], "is neither the manifest of an image nor an index"),
        ({"config": part(b"{}")}, "is neither the manifest of an image nor an index"),
        ({"manifests": [part(b"{}")]}, "is an index of several images"),
        ({"config": part(b"{}"), "layers": [part(b"layer", urls=["https://elsewhere.example"])]}, "from elsewhere"),
        ({"config": part(b"{}"), "layers": [part(b"layer", mediaType=FOREIGN)]}, "from elsewhere"),
    ],
)
def test_an_image_is_in_the_bundle_or_the_bundle_is_refused(tmp_path: Path, manifest: object, words: str) -> None:
    """Who copies an index or a foreign layer leaves parts of it out."""
    with pytest.raises(InputError, match=words):
        read_bundle(with_image(tmp_path / "bundle.tar", manifest))


def test_links_and_sizes_that_lead_nowhere(tmp_path: Path) -> None:
    link, back = tarfile.TarInfo("index.json"), tarfile.TarInfo("blobs/sha256/" + "0" * 64)
    link.type = tarfile.SYMTYPE
    link.linkname = "/etc/passwd"
    back.size = -tarfile.BLOCKSIZE
    for name, headers in {"link.tar": [link], "back.tar": [tarfile.TarInfo("oci-layout"), back]}.items():
        blocks = b"".join(header.tobuf(tarfile.GNU_FORMAT) for header in headers)
        (tmp_path / name).write_bytes(blocks + b"\0" * tarfile.RECORDSIZE)
        with pytest.raises(InputError, match=r"no bundle|no OCI layout archive"):
            read_bundle(tmp_path / name)


@pytest.mark.parametrize("index", ["[]", '{"manifests":["x"]}'])
def test_an_index_of_another_form(tmp_path: Path, index: str) -> None:
    with tarfile.open(tmp_path / "bundle.tar", "w") as tar:
        header = tarfile.TarInfo("index.json")
        header.size = len(index)
        tar.addfile(header, io.BytesIO(index.encode()))
    with pytest.raises(InputError, match=r"its index\.json is of another form"):
        read_bundle(tmp_path / "bundle.tar")


def test_images_alone_are_what_a_runtime_imports(tmp_path: Path) -> None:
    bundle = made(tmp_path)
    write_images(bundle, tmp_path / "images.tar")
    with tarfile.open(tmp_path / "images.tar") as tar:
        index = json.load(tar.extractfile("index.json"))  # type: ignore[arg-type]
    names = [entry["annotations"]["io.containerd.image.name"] for entry in index["manifests"]]
    assert names == sorted(bundle.contents.references().values())
    (tmp_path / "k3s").mkdir()
    archive = load_k3s(bundle, tmp_path / "k3s")
    assert archive.parent == tmp_path / "k3s"
    assert re.fullmatch(r"robotkube-0\.1\.0-[0-9a-f]{12}\.tar", archive.name)
    assert archive.read_bytes() == (tmp_path / "images.tar").read_bytes()
    assert load_k3s(bundle, tmp_path / "k3s", "mine.tar") == tmp_path / "k3s" / "mine.tar"
    assert sorted(one.name for one in (tmp_path / "k3s").iterdir()) == ["mine.tar", archive.name]
    with pytest.raises(InputError, match="no such folder"):
        load_k3s(bundle, tmp_path / "nowhere")


def test_an_archives_name_follows_from_version_and_images() -> None:
    def named(version: str, *digests: str) -> str:
        items = (
            BundleItem(IMAGE, f"image-{number}", version, f"sha256:{one * 64}", 1) for number, one in enumerate(digests)
        )
        return archive_name(BundleContents(version, PREFIX, tuple(items)))

    names = {named("0.1.0", "a"), named("0.1.0", "b"), named("0.1.0", "a", "b"), named("0.2.0", "a")}
    assert len(names) == 4, "two builds of one version do not overwrite each other"
    assert named("0.1.0", "a") in names, "the same again is the same file"
    assert all(is_archive(name) and is_archive(f"{name}.part") for name in names)


@pytest.mark.parametrize(
    "name",
    [
        "robotkube-0.1.0.tar",
        "robotkube-demo-0123456789ab.tar",
        "k3s-airgap-images-amd64.tar",
        "robotkube-0.1.0-0123456789ab.txt",
    ],
)
def test_files_of_others_are_no_such_archives(name: str) -> None:
    """A bundle, what `make demo` put there and takes away, what k3s brings."""
    assert not is_archive(name)


@pytest.mark.parametrize(
    "text",
    [
        "host",
        "host/",
        "https://host/path",
        "host/Path",
        "host:port/path",
        "/path",
        "",
        "oci://a.b/c",
        "a.b/c//d",
    ],
)
def test_what_is_no_place(text: str) -> None:
    with pytest.raises(InputError, match="write HOST/PATH in lower case"):
        read_place(text)


@pytest.mark.parametrize("text", ["robots/robotkube", "registry/a/b"])
def test_a_host_that_runtimes_would_take_for_a_path(text: str) -> None:
    with pytest.raises(InputError, match=f"--registry {text}: .* has neither a dot nor a port, .* Docker Hub"):
        read_place(text, "--registry")


@pytest.mark.parametrize(
    "text", ["localhost/a/b", "registry:5000/a", "r.example/a/b/c/robotkube", "r.example/x__y/a-b.c"]
)
def test_places_of_several_segments(text: str) -> None:
    assert str(read_place(text)) == text


def test_places(tmp_path: Path) -> None:
    place = read_place("registry.example:5000/robots/robotkube/")
    assert place == RegistryPlace("registry.example:5000", "robots/robotkube")
    [item] = [one for one in made(tmp_path).contents.items if one.name == "mqtt-bridge"]
    assert place.reference(item) == f"registry.example:5000/robots/robotkube/charts/mqtt-bridge@{item.digest}"


def test_what_is_missing_in_a_registry_is_named(tmp_path: Path) -> None:
    bundle = made(tmp_path)
    [bridge] = [one for one in bundle.contents.items if one.name == "mqtt-bridge"]
    with running(AskingRegistry(tokens=False)) as asking, OciRegistry(asking.url, "", "") as registry:
        place = RegistryPlace(asking.url.removeprefix("http://"), "robots")
        assert differences(registry, place, [bridge]) == [
            f"{place}/charts/mqtt-bridge: chart {bridge.digest} is not there"
        ]
        registry.push_chart("robots/charts", chart("mqtt-bridge"))
        tag, *evidence = differences(registry, place, [bridge])
        assert tag == f"{place}/charts/mqtt-bridge:{bridge.tag}: is not there, in the bundle {bridge.digest}"
        assert [line.partition(": ")[2].partition(" (")[0] for line in evidence] == [
            "evidence: static",
            "evidence: summary",
        ] or len(evidence) == len(EVIDENCE)


def test_accounts(tmp_path: Path) -> None:
    (tmp_path / "password").write_text("secret\n")
    assert given_account("", None) is None
    assert given_account("robot", tmp_path / "password") == RegistryAccount("robot", "secret")
    with pytest.raises(InputError, match="go together"):
        given_account("robot", None)
    environment = {"DOCKER_CONFIG": str(tmp_path)}
    assert kept_account("registry.example", environment) == RegistryAccount()
    auths = {"registry.example": {"auth": RegistryAccount("robot", "a:b").encoded}}
    (tmp_path / "config.json").write_text(json.dumps({"auths": auths}))
    assert kept_account("registry.example", environment) == RegistryAccount("robot", "a:b")
    assert kept_account("other.example", environment) == RegistryAccount()
    (tmp_path / "config.json").write_text('{"auths": {"registry.example": {"auth": "%"}}}')
    with pytest.raises(InputError, match=r"auths\.registry\.example: cannot be read"):
        kept_account("registry.example", environment)
