"""Programs in Go for arm64: what a file is, which cannot be compiled, and one that is compiled for real."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from ci.errors import InputError, SetUpError
from ci.toolchain import arm64, go
from ci.toolchain.programs import FOLDER, GITEA, PROGRAMS

ELF = b"\x7fELF\x02\x01\x01" + bytes(9) + b"\x02\x00"
HOOK = next(program for program in PROGRAMS if program.name == "forge-hook")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is no program of 64 bits"),
        (b"#!/bin/sh\n", "is no program of 64 bits"),
        (b"\x7fELF\x01\x01" + ELF[6:] + b"\xb7\x00", "is no program of 64 bits"),
        (ELF + b"\x3e\x00", r"is for machine 62 of ELF, not for 183 \(AArch64\)"),
    ],
)
def test_what_is_not_for_arm64_is_named(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "program").write_bytes(content)
    with pytest.raises(SetUpError, match=f"program: {words}"):
        arm64.inspect(tmp_path / "program")


def test_a_program_of_this_machine_is_none() -> None:
    with pytest.raises(SetUpError, match="is for machine"):
        arm64.inspect(Path(os.path.realpath(sys.executable)))


def test_what_cannot_be_compiled_is_said_with_the_package_that_mends_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    without = {program.name: arm64.lacking(program) for program in PROGRAMS if arm64.lacking(program)}
    assert set(without) == {program.name for program in PROGRAMS if program.cgo}
    assert without["gitea"].endswith("apt-get install gcc-aarch64-linux-gnu")
    assert "libseccomp" in without["runc"]
    (tmp_path / arm64.C_COMPILER).write_text("")
    (tmp_path / arm64.C_COMPILER).chmod(0o755)
    assert [program.name for program in PROGRAMS if arm64.lacking(program)] == ["runc"]


def test_a_name_that_is_no_program_is_refused() -> None:
    with pytest.raises(InputError, match=r"gitee: is no program in Go of the tool chain; there is kubernetes, etcd"):
        arm64.all_of(["gitee"])


@pytest.mark.toolchain
@pytest.mark.thorough
def test_a_program_is_compiled_for_arm64(tmp_path: Path) -> None:
    """The smallest one; `make arm64` does all, which takes as long as the tool chain."""
    versions = {GITEA: go.module_version(FOLDER / "gitea", GITEA)}
    assert arm64.compile_one(HOOK, versions, tmp_path).startswith("ELF, AArch64, ")
    assert not (tmp_path / HOOK.name).read_bytes().startswith(ELF + b"\x3e")
