"""Build contexts have fixed modes, and what they need of a base is read from the Dockerfile."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotkube.errors import InputError
from robotkube.registry.images.adapters import build_contexts
from robotkube.registry.images.adapters.build_contexts import copy_context
from robotkube.registry.images.adapters.buildah import Buildah
from robotkube.registry.images.adapters.docker import Docker
from robotkube.registry.images.adapters.engines import choose_engine
from robotkube.registry.images.core.dockerfiles import wants_base


def test_modes_do_not_depend_on_who_checked_out(tmp_path: Path) -> None:
    source, target = tmp_path / "source", tmp_path / "target"
    for name, mode in {"files/a.py": 0o600, "files/run": 0o700, "__pycache__/a.pyc": 0o644, ".git/HEAD": 0o644}.items():
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
        path.chmod(mode)
    (source / "files").chmod(0o700)
    (source / "link").symlink_to("files", target_is_directory=True)
    copy_context(source, target)
    modes = {path.relative_to(target).as_posix(): path.stat().st_mode & 0o777 for path in target.rglob("*")}
    assert modes == {"files": 0o755, "files/a.py": 0o644, "files/run": 0o755, "link": 0o755}
    assert (target / "link").readlink() == Path("files")


def test_a_folder_of_too_many_files_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build_contexts, "FILES_MAX", 1)
    (tmp_path / "source").mkdir()
    for name in ("a", "b"):
        (tmp_path / "source" / name).touch()
    with pytest.raises(InputError, match="more than 1 files; build in the folder of the Dockerfile alone"):
        copy_context(tmp_path / "source", tmp_path / "target")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("ARG BASE\nFROM ${BASE}\n", True),
        ("# x\n arg BASE \nFROM ${BASE}\n", True),
        ("ARG BASE=scratch\nFROM ${BASE}\n", False),
        ("ARG BASEMENT\nFROM scratch\n", False),
        ("FROM scratch\n", False),
    ],
)
def test_a_base_is_wanted_where_the_argument_has_no_default(text: str, wanted: bool) -> None:
    assert wants_base(text) is wanted


def test_the_first_program_that_is_here_builds(tmp_path: Path) -> None:
    def here(*programs: str) -> dict[str, str]:
        return {program: f"/usr/bin/{program}" for program in programs}

    first = choose_engine(tmp_path, which=here("docker", "buildah").get, environment={"STORAGE_DRIVER": "vfs"})
    assert isinstance(first, Buildah)
    assert (first.program, first.driver, first.fetching) == ("buildah", "vfs", True)
    assert choose_engine(tmp_path, which=here("docker", "podman").get).program == "podman"
    assert isinstance(choose_engine(tmp_path, which=here("docker").get), Docker)
    assert choose_engine(tmp_path, "docker", here("docker", "buildah").get).program == "docker"


def test_without_any_the_error_says_what_to_install(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no program that builds images is here: install buildah \(apt-get install"):
        choose_engine(tmp_path, which={}.get)
    with pytest.raises(InputError, match="podman is not on the PATH; no program"):
        choose_engine(tmp_path, "podman", {"docker": "/usr/bin/docker"}.get)
