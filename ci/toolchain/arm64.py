"""`python -m ci.toolchain.arm64 [PROGRAM ...]`: compile what is written in Go for arm64, and inspect each program:
its format, its processor, and what Go says of its own build. None of them is run: this machine has another processor.

Those that are in part in C (runc, gitea) are compiled by Debian's gcc-aarch64-linux-gnu, which is installed when it is
missing. libseccomp, with which runc is linked, is Debian's of that architecture, unpacked below the user's cache
folder.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ci import packages
from ci.errors import InputError, SetUpError
from ci.folders import PROJECT, user_cache
from ci.steps import Steps
from ci.toolchain import building, go
from ci.toolchain.programs import FOLDER, GITEA, MODULES, PROGRAMS, Program

ARCHITECTURE = "arm64"
C_COMPILER = "aarch64-linux-gnu-gcc"
LIBRARIES = ("libseccomp-dev", "libseccomp2")  # Debian's packages of what C parts are linked with, beside the C library
LIBRARY_FOLDER = Path("usr", "lib", "aarch64-linux-gnu")
DATABASE = "ferretdb"  # has a build of its own
ELF_64_LITTLE = b"\x7fELF\x02\x01"  # EI_MAG to EI_DATA of the ELF specification
AARCH64 = 183  # EM_AARCH64, of the same
MACHINE_AT, HEADER_BYTES = 18, 20
TARGET = PROJECT / "build" / ARCHITECTURE


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
    building.build(program, versions, target, {**_variables(), **(_of_c_parts() if program.cgo else {})})
    return inspect(target / program.name)


def compile_database(target: Path) -> str:
    """The same of FerretDB, from its changed sources."""
    with building.of_database(_variables()) as module, tempfile.TemporaryDirectory(prefix="ferretdb-") as folder:
        source = Path(folder) / "source"
        module.copy_module(source)
        module.change(source)
        module.compile_command(source, target / DATABASE)
    return inspect(target / DATABASE)


def _variables() -> dict[str, str]:
    """A cache of its own, too: that of the tool chain goes whenever one is complete."""
    return {"GOOS": "linux", "GOARCH": ARCHITECTURE, "GOCACHE": str(_cache())}


def _of_c_parts() -> dict[str, str]:
    """The compiler for C, and where pkg-config finds libraries of that architecture: there alone, and all paths that it
    gives are below that folder."""
    root = packages.unpacked_for(ARCHITECTURE, *LIBRARIES)
    where = {"PKG_CONFIG_LIBDIR": str(root / LIBRARY_FOLDER / "pkgconfig"), "PKG_CONFIG_SYSROOT_DIR": str(root)}
    return {"CC": C_COMPILER, **where, "PKG_CONFIG_PATH": ""}


def _cache() -> Path:
    return user_cache() / f"go-build-{ARCHITECTURE}"


def chosen_of(names: Sequence[str]) -> dict[str, Program | None]:
    """The programs of these names, or all; None is FerretDB's."""
    known: dict[str, Program | None] = {program.name: program for program in PROGRAMS}
    known[DATABASE] = None
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise InputError(f"{unknown[0]}: is no program in Go of the tool chain; there is {', '.join(known)}")
    return {name: known[name] for name in names or known}


def all_of(names: Sequence[str]) -> None:
    """Compile these, or all; what C parts need is fetched before the first."""
    chosen = chosen_of(names)
    building.install_packages()
    if any(program and program.cgo for program in chosen.values()):
        packages.ensure(ARCHITECTURE)
        packages.unpacked_for(ARCHITECTURE, *LIBRARIES)
    versions = {module: go.module_version(FOLDER, module) for module in MODULES}
    versions[GITEA] = go.module_version(FOLDER / "gitea", GITEA)
    TARGET.mkdir(parents=True, exist_ok=True)
    steps = Steps(len(chosen))
    for name, program in chosen.items():
        with steps.step(f"{name} for {ARCHITECTURE}") as step:
            for former in (name, *(program.links if program else ())):
                (TARGET / former).unlink(missing_ok=True)
            step.note = compile_one(program, versions, TARGET) if program else compile_database(TARGET)
    shutil.rmtree(_cache(), ignore_errors=True)
    print(f"{TARGET}: {len(chosen)} programs for {ARCHITECTURE}, inspected and not run")


def main() -> int:
    """Exit code 0 done, 1 no such program, 3 the machine lacks something or a program failed."""
    parser = argparse.ArgumentParser(prog="python -m ci.toolchain.arm64", description=__doc__)
    parser.add_argument("program", nargs="*", help="default: all")
    try:
        all_of(parser.parse_args().program)
    except (InputError, SetUpError) as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
