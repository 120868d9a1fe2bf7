"""Prometheus and promtool, built once and kept: what the slower proofs watch the platform with. Only they build them.

<cache>/prometheus/<key>   both programs; the folder appears when both had passed their smoke tests
"""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

from ci import packages
from ci.folders import user_cache
from ci.steps import Steps
from ci.toolchain import go
from ci.toolchain.building import build, smoke_test
from ci.toolchain.programs import VERSION, Program, Stamps, Versions

FOLDER = Path(__file__).resolve().parent
MODULE = "github.com/prometheus/prometheus"
INPUTS = ("__init__.py", "go.mod", "go.sum")
TAGS = "remove_all_sd,enable_kubernetes_sd"  # it finds pods by Kubernetes alone; all the others triple what is compiled


def stamps(versions: Versions) -> Stamps:
    """The version that both programs say."""
    return {"github.com/prometheus/common/version.Version": versions[MODULE].removeprefix("v")}


PROGRAMS = tuple(
    Program(name, MODULE, f"{MODULE}/cmd/{name}", {name: VERSION}, folder=FOLDER, tags=TAGS, stamps=stamps)
    for name in ("promtool", "prometheus")
)


def ensure() -> Path:
    """The folder of both programs, built if the cache lacks it; raises SetUpError naming the one that failed."""
    packages.ensure("toolchain")
    digest = hashlib.sha256(go.version().encode())
    for name in INPUTS:
        digest.update((FOLDER / name).read_bytes())
    folder = user_cache() / "prometheus" / digest.hexdigest()[:16]
    if folder.is_dir():
        return folder
    partial = folder.with_name(f"{folder.name}.{os.getpid()}.partial")
    partial.mkdir(parents=True)
    try:
        versions = {MODULE: go.module_version(FOLDER, MODULE)}
        steps = Steps(len(PROGRAMS))
        for program in PROGRAMS:
            with steps.step(f"build {program.name}") as step:
                build(program, versions, partial)
                smoke_test(program, versions[MODULE], partial)
                step.note = versions[MODULE]
        for older in folder.parent.glob("*"):
            if older != partial:
                shutil.rmtree(older, ignore_errors=True)
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(go.build_cache(), ignore_errors=True)
    return folder
