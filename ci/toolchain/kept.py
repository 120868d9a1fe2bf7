"""Programs beside those of the embedded cluster, built only by what needs them, once, and kept.

<cache>/<name>/<key>   programs of one set; the folder appears when all of them had passed their smoke tests
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ci import packages
from ci.folders import user_cache
from ci.steps import Steps
from ci.toolchain import go
from ci.toolchain.building import build, smoke_test
from ci.toolchain.programs import Program

INPUTS = ("__init__.py", "go.mod", "go.sum", "*.go")


@dataclass(frozen=True)
class Kept:
    """A set of programs of one module; `folder` has its go.mod."""

    name: str
    folder: Path
    module: str
    programs: Sequence[Program]

    def ensure(self) -> Path:
        """The folder of the programs, built if the cache lacks it; raises SetUpError naming the one that failed."""
        packages.ensure("toolchain")
        place = user_cache() / self.name / self._key()
        if place.is_dir():
            return place
        partial = place.with_name(f"{place.name}.{os.getpid()}.partial")
        partial.mkdir(parents=True)
        try:
            self._build(partial)
            for older in place.parent.glob("*"):
                if older != partial:
                    shutil.rmtree(older, ignore_errors=True)
            partial.rename(place)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
            shutil.rmtree(go.build_cache(), ignore_errors=True)
        return place

    def _key(self) -> str:
        digest = hashlib.sha256(go.version().encode())
        for path in sorted(path for pattern in INPUTS for path in self.folder.glob(pattern)):
            digest.update(path.read_bytes())
        return digest.hexdigest()[:16]

    def _build(self, target: Path) -> None:
        versions = {self.module: go.module_version(self.folder, self.module)}
        steps = Steps(len(self.programs))
        for program in self.programs:
            with steps.step(f"build {program.name}") as step:
                build(program, versions, target)
                smoke_test(program, versions[self.module], target)
                step.note = versions[self.module]
