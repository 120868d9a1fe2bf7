"""Prometheus and promtool: what the slower proofs watch the platform with. Only they build them."""

from __future__ import annotations

from pathlib import Path

from ci.toolchain.kept import Kept
from ci.toolchain.programs import VERSION, Program, Stamps, Versions

FOLDER = Path(__file__).resolve().parent
MODULE = "github.com/prometheus/prometheus"
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
    return Kept("prometheus", FOLDER, MODULE, PROGRAMS).ensure()
