"""Imported images: a folder that is made from a kept one has exactly its own, and the kept one stays as it is."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from ci.cluster.embedded.host import processes
from ci.cluster.embedded.host.processes import Launcher
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.nodes import image_imports
from ci.errors import SetUpError
from ci.images.image_lock import Image
from ci.machine import cgroups
from tests.stages.platform import probe_image
from tests.stages.programs import folder as programs

pytestmark = pytest.mark.toolchain

CLUSTER = "importing"
BLOBS = "io.containerd.content.v1.content/blobs/sha256"


def image(folder: Path, name: str, program: bytes) -> Image:
    """An image whose one layer has this program."""
    archive = folder / f"{name}.tar"
    digest = probe_image.archive(archive, program, name)
    return Image(name, f"{probe_image.REPOSITORY}/{name}@{digest}", archive)


@pytest.fixture
def made(tmp_path: Path) -> Mapping[str, Image]:
    return {name: image(tmp_path, name, name.encode()) for name in ("pause", "first", "second")}


@pytest.fixture
def launcher(monkeypatch: pytest.MonkeyPatch) -> Iterator[Launcher]:
    """With a cache of its own, whose short name a socket's path has room for."""
    with tempfile.TemporaryDirectory(prefix="rk-") as cache:
        monkeypatch.setenv("XDG_CACHE_HOME", cache)
        yield Launcher(ClusterFolders(CLUSTER), programs())
        assert not processes.kill_all(CLUSTER)
        assert not cgroups.remove(CLUSTER)


def contents(root: Path) -> dict[str, str]:
    """All files of a folder, each with the digest of what is in it."""
    files = [path for path in sorted(root.rglob("*")) if path.is_file()]
    return {str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def programs_in(root: Path) -> set[str]:
    """What stands in the program of each unpacked layer."""
    return {path.read_text() for path in (root / image_imports.SNAPSHOTS).glob("*/fs/probe")}


def digests(chosen: Sequence[Image]) -> set[str]:
    return {one.reference.partition("@sha256:")[2] for one in chosen}


def test_one_more_is_imported_and_what_nobody_wants_is_gone(made: Mapping[str, Image], launcher: Launcher) -> None:
    before, after = [made["pause"], made["first"]], [made["pause"], made["second"]]
    first, count = image_imports.imported(before, launcher)
    assert (count, programs_in(first)) == (2, {"pause", "first"})
    stood = contents(first)
    second, count = image_imports.imported(after, launcher)
    assert (count, programs_in(second)) == (1, {"pause", "second"})
    assert contents(first) == stood, "the one that is kept was written to"
    blobs = {path.name for path in (second / BLOBS).iterdir()}
    assert digests(after) <= blobs
    assert not digests([made["first"]]) & blobs
    shared = digests([made["pause"]]).pop()
    assert (first / BLOBS / shared).samefile(second / BLOBS / shared)
    assert image_imports.imported(after, launcher) == (second, 0)
    assert image_imports.imported(before, launcher) == (first, 0)


def test_a_root_with_the_most_of_them_is_taken(made: Mapping[str, Image], launcher: Launcher, tmp_path: Path) -> None:
    roots = {name: image_imports.imported([made["pause"], made[name]], launcher)[0] for name in ("first", "second")}
    again = image(tmp_path, "third", b"third")
    third, count = image_imports.imported([made["pause"], made["first"], again], launcher)
    assert (count, programs_in(third)) == (1, {"pause", "first", "third"})
    assert sorted(path.name for path in third.parent.iterdir()) == sorted([third.name, roots["second"].name])


def test_what_a_killed_start_left_is_no_beginning(made: Mapping[str, Image], launcher: Launcher) -> None:
    """Its copy may lack contents that its record names."""
    first, _ = image_imports.imported([made["pause"], made["first"]], launcher)
    first.rename(first.with_suffix(image_imports.PARTIAL))
    assert image_imports.imported([made["pause"], made["second"]], launcher)[1] == 2


def test_another_maker_has_its_own(made: Mapping[str, Image], launcher: Launcher) -> None:
    first, _ = image_imports.imported([made["pause"]], launcher)
    record = json.loads((first / image_imports.RECORD).read_text())
    (first / image_imports.RECORD).write_text(json.dumps({**record, "maker": "another containerd"}))
    assert image_imports.imported([made["pause"], made["first"]], launcher)[1] == 2


def test_an_archive_with_another_image_is_refused(made: Mapping[str, Image], launcher: Launcher) -> None:
    other = Image("first", made["first"].reference, made["second"].archive)
    with pytest.raises(SetUpError, match=r"second\.tar: does not contain .*/first@sha256:"):
        image_imports.imported([made["pause"], other], launcher)
    assert image_imports.imported([made["pause"], made["first"]], launcher)[1] == 2


def test_an_archive_that_is_none_is_refused(made: Mapping[str, Image], launcher: Launcher, tmp_path: Path) -> None:
    (tmp_path / "broken.tar").write_bytes(b"nothing")
    broken = Image("first", made["first"].reference, tmp_path / "broken.tar")
    with pytest.raises(SetUpError, match=r"broken\.tar: cannot be imported: containerd: images import: "):
        image_imports.imported([made["pause"], broken], launcher)
