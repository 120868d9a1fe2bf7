"""Programs in Go for arm64: what a file is, which there are, and two that are compiled for real, one in part in C."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ci import packages
from ci.errors import InputError, SetUpError
from ci.toolchain import arm64, go
from ci.toolchain.programs import FOLDER, GITEA, PROGRAMS, Program

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


def test_all_programs_of_the_tool_chain_are_compiled_when_none_is_named() -> None:
    assert list(arm64.chosen_of([])) == [*(program.name for program in PROGRAMS), arm64.DATABASE]
    assert list(arm64.chosen_of(["runc", "ferretdb"])) == ["runc", "ferretdb"]


def test_a_name_that_is_no_program_is_refused() -> None:
    with pytest.raises(InputError, match=r"gitee: is no program in Go of the tool chain; there is kubernetes, etcd"):
        arm64.chosen_of(["gitee"])


@pytest.mark.toolchain
@pytest.mark.thorough
def test_a_program_is_compiled_for_arm64(tmp_path: Path) -> None:
    """The smallest one; `make arm64` does all, which takes as long as the tool chain."""
    versions = {GITEA: go.module_version(FOLDER / "gitea", GITEA)}
    assert arm64.compile_one(HOOK, versions, tmp_path).startswith("ELF, AArch64, ")
    assert not (tmp_path / HOOK.name).read_bytes().startswith(ELF + b"\x3e")


C_PART = """package main

// #cgo pkg-config: libseccomp
// #include <seccomp.h>
import "C"

func main() { C.seccomp_version() }
"""


@pytest.mark.toolchain
@pytest.mark.thorough
def test_a_part_in_c_is_linked_with_the_library_of_arm64(tmp_path: Path) -> None:
    """What runc is: Go, C, and libseccomp, of which the system gets neither the files nor the architecture."""
    (tmp_path / "go.mod").write_text("module example.com/linked\n")
    (tmp_path / "main.go").write_text(C_PART)
    (tmp_path / "bin").mkdir()
    before = _architectures()
    packages.ensure(arm64.ARCHITECTURE)
    linked = Program("linked", "example.com/linked", ".", {}, folder=tmp_path, cgo=True)
    assert arm64.compile_one(linked, {}, tmp_path / "bin").startswith("ELF, AArch64, ")
    assert b"\0libseccomp.so.2\0" in (tmp_path / "bin" / "linked").read_bytes()
    assert _architectures() == before


@pytest.mark.toolchain
@pytest.mark.thorough
def test_a_library_that_debian_has_not_is_named_with_the_architecture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(SetUpError, match=r"^apt-get download no-such-library for arm64 failed: .*no-such-library"):
        packages.unpacked_for(arm64.ARCHITECTURE, "no-such-library")
    assert list((tmp_path / "robotkube" / "debian").iterdir()) == []


def _architectures() -> str:
    command = ["dpkg", "--print-foreign-architectures"]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout
