"""`python -m ci.toolchain.arm64 [PROGRAM ...]`: compile what is written in Go for arm64, and inspect each program:
its format, its processor, and what Go says of its own build. None of them is run: this machine has another processor.

Not for arm64: runc, whose C part needs the library libseccomp of that architecture. gitea has SQLite in C, and needs
Debian's gcc-aarch64-linux-gnu.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ci.errors import InputError, SetUpError
from ci.folders import PROJECT, user_cache
from ci.steps import Steps
from ci.toolchain import building, go
from ci.toolchain.programs import FOLDER, GITEA, MODULES, PROGRAMS, Program

ARCHITECTURE = "arm64"
C_COMPILER, C_PACKAGE = "aarch64-linux-gnu-gcc", "gcc-aarch64-linux-gnu"
DATABASE = "ferretdb"  # has a build of its own
OTHER_LIBRARIES = {"runc": "its C part needs libseccomp of arm64"}
ELF_64_LITTLE = b"\x7fELF\x02\x01"  # EI_MAG to EI_DATA of the ELF specification
AARCH64 = 183  # EM_AARCH64, of the same
MACHINE_AT, HEADER_BYTES = 18, 20
TARGET = PROJECT / "build" / ARCHITECTURE


def lacking(program: Program) -> str:
    """Why a program cannot be compiled here for arm64; empty when it can."""
    if program.name in OTHER_LIBRARIES:
        return OTHER_LIBRARIES[program.name]
    if program.cgo and shutil.which(C_COMPILER) is None:
        return f"it is in part in C, and {C_COMPILER} is not on PATH: apt-get install {C_PACKAGE}"
    return ""


def inspect(path: Path) -> str:
    """What a file is, in words. SetUpError when it is no program for arm64, by its header and by what Go wrote into
    it."""
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES)
    if not header.startswith(ELF_64_LITTLE):
        raise SetUpError(f"{path}: is no program of 64 bits (ELF, little endian)")
    machine = int.from_bytes(header[MACHINE_AT:HEADER_BYTES], "little")
    if machine != AARCH64:
        raise SetUpError(f"{path}: is for machine {machine} of ELF, not for {AARCH64} (AArch64)")
    said = go.run(["version", "-m", str(path)], Path("/"))
    for wanted in ("GOOS=linux", f"GOARCH={ARCHITECTURE}"):
        if f"\tbuild\t{wanted}" not in said:
            raise SetUpError(f"{path}: Go did not build it with {wanted}: {said.splitlines()[:1]}")
    return f"ELF, AArch64, {path.stat().st_size / building.MIB:.0f} MiB"


def compile_one(program: Program, versions: Mapping[str, str], target: Path) -> str:
    """Compile a program into `target` as for this machine, but for arm64; what it is, in words."""
    building.build(program, versions, target, _variables(program.cgo))
    return inspect(target / program.name)


def compile_database(target: Path) -> str:
    """The same of FerretDB, from its changed sources."""
    with building.of_database(_variables()) as module, tempfile.TemporaryDirectory(prefix="ferretdb-") as folder:
        source = Path(folder) / "source"
        module.copy_module(source)
        module.change(source)
        module.compile_command(source, target / DATABASE)
    return inspect(target / DATABASE)


def _variables(cgo: bool = False) -> dict[str, str]:
    """A cache of its own, too: that of the tool chain goes whenever one is complete."""
    compiler = {"CC": C_COMPILER} if cgo else {}
    return {"GOOS": "linux", "GOARCH": ARCHITECTURE, "GOCACHE": str(_cache()), **compiler}


def _cache() -> Path:
    return user_cache() / f"go-build-{ARCHITECTURE}"


def all_of(names: Sequence[str]) -> int:
    """Compile these, or all; how many were left out, each of which is told."""
    known = {program.name: program for program in PROGRAMS}
    unknown = sorted(set(names) - {*known, DATABASE})
    if unknown:
        raise InputError(
            f"{unknown[0]}: is no program in Go of the tool chain; there is {', '.join((*known, DATABASE))}"
        )
    chosen = list(names) or [*known, DATABASE]
    building.install_packages()
    versions = {module: go.module_version(FOLDER, module) for module in MODULES}
    versions[GITEA] = go.module_version(FOLDER / "gitea", GITEA)
    TARGET.mkdir(parents=True, exist_ok=True)
    left_out = 0
    steps = Steps(len(chosen))
    for name in chosen:
        with steps.step(f"{name} for {ARCHITECTURE}") as step:
            why = lacking(known[name]) if name in known else ""
            for former in (name, *(known[name].links if name in known else ())):
                (TARGET / former).unlink(missing_ok=True)
            if why:
                step.note, left_out = f"NOT BUILT: {why}", left_out + 1
            elif name == DATABASE:
                step.note = compile_database(TARGET)
            else:
                step.note = compile_one(known[name], versions, TARGET)
    shutil.rmtree(_cache(), ignore_errors=True)
    print(f"{TARGET}: {len(chosen) - left_out} programs for {ARCHITECTURE}, inspected and not run; {left_out} left out")
    return left_out


def main() -> int:
    """Exit code 0 done, 1 something was left out, 3 a program failed."""
    parser = argparse.ArgumentParser(prog="python -m ci.toolchain.arm64", description=__doc__)
    parser.add_argument("program", nargs="*", help="default: all")
    try:
        return int(bool(all_of(parser.parse_args().program)))
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
