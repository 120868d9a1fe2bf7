"""What an image is keyed by, and what a machine lends to a build."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from ci.images import machine
from ci.images.building import build_images
from ci.images.catalogue import BY_NAME, IMAGES, TOP, ImageRecipe, Sources
from ci.images.contexts import ContextError, Copied, assemble, check, key_of
from robotkube.registry.images.adapters.buildah import BuildError


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "source"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep" / "file").write_text("text")
    (folder / "program").write_text("#!/bin/sh\n")
    (folder / "program").chmod(0o755)
    return folder


def test_key_follows_contents_names_and_program_bits_only(source: Path) -> None:
    contents = (Copied(source, "there"),)
    first = key_of(contents)
    os.utime(source / "program", (1, 1))
    (source / "__pycache__").mkdir()
    (source / "__pycache__" / "x.pyc").write_text("1")
    assert key_of(contents) == first
    assert key_of((Copied(source, "elsewhere"),)) != first
    assert key_of(contents, "more") != first
    (source / "program").chmod(0o644)
    assert key_of(contents) != first


def test_context_mirrors_the_sources_without_caches(source: Path, tmp_path: Path) -> None:
    (source / "x.pyc").write_text("1")
    absent = Copied(tmp_path / "absent", "empty/folder", optional=True)
    assemble((Copied(source, "a/b"), absent), tmp_path / "context")
    files = {
        p.relative_to(tmp_path / "context").as_posix(): p for p in (tmp_path / "context").rglob("*") if p.is_file()
    }
    assert sorted(files) == ["a/b/deep/file", "a/b/program"]
    assert os.access(files["a/b/program"], os.X_OK)
    assert (tmp_path / "context" / "empty" / "folder").is_dir()


def test_modes_depend_on_the_program_bit_alone(source: Path, tmp_path: Path) -> None:
    (source / "deep" / "file").chmod(0o600)
    before = os.umask(0o077)
    try:
        assemble((Copied(source, "a/b"),), tmp_path / "context")
    finally:
        os.umask(before)
    modes = {path.name: path.stat().st_mode & 0o777 for path in (tmp_path / "context").rglob("*")}
    assert modes == {"a": 0o755, "b": 0o755, "deep": 0o755, "file": 0o644, "program": 0o755}


def sources_in(folder: Path) -> Sources:
    return Sources(folder, lambda path, module: folder, lambda: folder)


def test_the_forges_image_has_its_pages_where_they_were_built(tmp_path: Path) -> None:
    """And is the same as before where they were not."""
    without = sources_in(tmp_path)
    pages = replace(without, forge_pages=tmp_path / "pages")
    more = {*BY_NAME["gitea"].contents(pages)} - {*BY_NAME["gitea"].contents(without)}
    assert more == {Copied(tmp_path / "pages", "share/gitea/public/assets")}


def test_a_missing_program_is_named_with_what_makes_it(tmp_path: Path) -> None:
    sources = sources_in(tmp_path)
    with pytest.raises(ContextError, match=r"image ferretdb: .*/ferretdb is missing .*python -m ci\.toolchain"):
        check("ferretdb", BY_NAME["ferretdb"].contents(sources))


def test_an_unknown_image_is_refused_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="no such image: rose; there are base, pause"):
        build_images(tmp_path, tmp_path / "cache", ["rose"])
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.name)
def test_every_image_ends_as_a_numeric_user_with_labels(image: object) -> None:
    lines = BY_NAME[image.name].dockerfile.read_text().splitlines()  # type: ignore[attr-defined]
    users = [line.split()[1] for line in lines if line.startswith("USER ")]
    assert all(part.isdigit() and int(part) > 0 for part in users[-1].split(":"))
    text = "\n".join(lines)
    assert f'image.title="robotkube {image.name}"' in text  # type: ignore[attr-defined]
    assert "image.version=" in text


@pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.name)
def test_every_context_file_of_the_repository_is_there_and_copied(image: object, tmp_path: Path) -> None:
    copied = BY_NAME[image.name].contents(sources_in(tmp_path))  # type: ignore[attr-defined]
    text = BY_NAME[image.name].dockerfile.read_text()  # type: ignore[attr-defined]
    for one in copied:
        assert one.target in text or one.target.rpartition("/")[0] in text
        assert one.optional or not one.source.is_relative_to(TOP) or one.source.exists()


@pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.name)
def test_every_image_has_the_licence_and_the_notice(image: ImageRecipe, tmp_path: Path) -> None:
    """In its own layer, or in that of the base with which it begins."""
    text = image.dockerfile.read_text()
    stands_on = next(line.split()[1] for line in reversed(text.splitlines()) if line.startswith("FROM "))
    if stands_on == "scratch":
        targets = {content.target for content in image.contents(sources_in(tmp_path))}
        assert {"LICENSE", "NOTICE"} <= targets
        assert "\nCOPY LICENSE NOTICE /licenses/\n" in text
    else:
        assert (stands_on, bool(image.stands_on)) == ("${BASE}", True)


def test_pip_settings_of_files_and_variables_become_one_file(tmp_path: Path) -> None:
    home, wheels = tmp_path / "home", tmp_path / "wheels"
    (home / ".config" / "pip").mkdir(parents=True)
    wheels.mkdir()
    (home / ".config" / "pip" / "pip.conf").write_text(
        "[global]\nindex-url = https://user.invalid/simple\ntimeout = 5\n"
    )
    (tmp_path / "ca.crt").write_text("certificates")
    environment = {
        "PIP_INDEX_URL": "https://variable.invalid/simple",
        "PIP_FIND_LINKS": str(wheels),
        "SSL_CERT_FILE": str(tmp_path / "ca.crt"),
    }
    lent = machine.lend(tmp_path / "lent", environment, home, None)
    text = (tmp_path / "lent" / "pip.conf").read_text()
    assert "index-url = https://variable.invalid/simple" in text
    assert "timeout = 5" in text
    assert f"cert = {machine.CERTIFICATES}" in text
    assert (tmp_path / "lent" / "certificates.crt").read_text() == "certificates"
    assert f"{wheels}:{wheels}:ro" in lent.volumes
    targets = {volume.split(":")[1].strip("/") for volume in lent.volumes}
    assert targets <= lent.placeholders


def test_sources_are_lent_by_a_debian_of_the_same_release_only(tmp_path: Path) -> None:
    apt = tmp_path / "apt"
    (apt / "sources.list.d").mkdir(parents=True)
    (apt / "sources.list.d" / "debian.sources").write_text("Types: deb\n")
    release = tmp_path / "os-release"
    release.write_text("NAME=x\nVERSION_CODENAME=bookworm\nID=debian\n")
    assert machine.debian_sources(release, apt) == apt / "sources.list.d" / "debian.sources"
    release.write_text("NAME=x\nVERSION_CODENAME=noble\nID=ubuntu\nID_LIKE=debian\n")
    assert machine.debian_sources(release, apt) is None
