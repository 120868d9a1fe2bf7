"""A Docker engine that has the image of kind's nodes, for as long as a module of tests needs it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from ci import kind_cli
from ci.cluster import choosing
from ci.images import preparation
from ci.kind_node_image import building, naming
from tests.stages.kind.docker_engine import DockerEngine, docker_engine, left_of
from tests.stages.platform.running_platform import spoken

LOAD_SECONDS_MAX = 300


@contextmanager
def node_engine(config: pytest.Config) -> Iterator[DockerEngine]:
    """The engine, once no other cluster runs; the image is made here when it is not in the cache, in about ten minutes.
    Nothing of the engine is left afterwards, or that fails."""
    prepared = preparation.everything()
    with spoken(config):
        choosing.remove_running(lambda text: print(f"\n{text}", file=sys.stderr, flush=True))
        building.ensure()
        kind_cli.ensure()
    with docker_engine(prepared.binaries / "runc") as started:
        said = started.run("make", "kind-node-image", seconds=LOAD_SECONDS_MAX)
        assert f"{naming.reference()}\ndocker has it" in said
        yield started
    assert left_of(started) == []


def require_nothing_runs(engine: DockerEngine) -> None:
    """Fail where the engine has a container or a volume."""
    for kind in ("container", "volume"):
        assert engine.run("docker", kind, "ls", "--quiet", *(["--all"] * (kind == "container")), seconds=60) == ""
