"""What runs on a node, read off the files of its runtime and its kubelet."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.embedded.containers.beside_kubelets import CONTAINER, SANDBOX, unknown
from ci.cluster.embedded.containers.node_containers import LINKS, PODS, RECORDED, RUNNING, STATE, NodeContainers
from ci.cluster.embedded.network.pod_links import SETTLED_NS

TICK_NS = 20_000_000  # of a folder's clock, at most
TASKS, SHIMS = RUNNING
CLAIMS = {"sandbox-id": "box", "sandbox-namespace": "vehicle-00", "sandbox-name": "web-1", "sandbox-uid": "uid-web"}


def specification(kind: str, program: str, **more: str) -> dict[str, Any]:
    said = {**CLAIMS, "container-type": kind, **more}
    annotations = {f"io.kubernetes.cri.{key.replace('_', '-')}": value for key, value in said.items()}
    return {"annotations": annotations, "process": {"args": [program, "--secret=1"]}}


def run(node: Path, place: Path, name: str, document: object | None) -> Path:
    folder = node / place / name
    folder.mkdir(parents=True)
    if document is not None:
        (folder / "config.json").write_text(json.dumps(document), encoding="utf-8")
    records = node / STATE / "runc" / place.name / name
    records.mkdir(parents=True, exist_ok=True)
    (records / "state.json").touch()
    return folder


def link(node: Path, name: str) -> None:
    (node / LINKS).mkdir(exist_ok=True)
    (node / LINKS / name).symlink_to("/nowhere/0.log")


@pytest.fixture
def node(tmp_path: Path) -> Path:
    """A node on which a kubelet runs a pod of one container."""
    run(tmp_path, TASKS / "k8s.io", "box", specification(SANDBOX, "/pause"))
    run(tmp_path, TASKS / "k8s.io", "web", specification(CONTAINER, "/web", container_name="web"))
    link(tmp_path, "web-1_vehicle-00_web-web.log")
    (tmp_path / PODS / "uid-web").mkdir(parents=True)
    (tmp_path / RECORDED / "box").mkdir(parents=True)
    return tmp_path


def test_a_node_that_has_run_nothing_yet_has_nothing(tmp_path: Path) -> None:
    assert NodeContainers(tmp_path).read().containers == ()


def test_what_a_kubelet_runs_is_known(node: Path) -> None:
    seen = NodeContainers(node).read()
    assert sorted(
        (container.key, container.kind, container.sandbox, container.pod_uid, container.program)
        for container in seen.containers
    ) == [
        ("k8s.io/box", SANDBOX, "box", "uid-web", "/pause"),
        ("k8s.io/web", CONTAINER, "box", "uid-web", "/web"),
    ]
    assert (seen.pods, seen.recorded) == ({"uid-web"}, {"box"})
    assert unknown(seen) == ()


@pytest.mark.parametrize("place", [TASKS / "default", TASKS / "k8s.io", SHIMS / "moby"])
@pytest.mark.parametrize("document", [None, {}, {"process": None}, {"process": {"args": ["/bin/sh"]}}, [], "text"])
def test_whatever_else_runs_is_not(node: Path, place: Path, document: object | None) -> None:
    run(node, place, "foreign", document)
    [stranger] = unknown(NodeContainers(node).read())
    assert stranger.container.key == f"{place.name}/foreign"


def test_what_ends_is_gone(node: Path) -> None:
    reader = NodeContainers(node)
    folder = run(node, TASKS / "default", "foreign", specification(CONTAINER, "/x"))
    assert len(reader.read().containers) == 3
    folder.rename(folder.with_name(".foreign"))
    assert len(reader.read().containers) == 2
    shutil.rmtree(folder.parent)
    assert len(reader.read().containers) == 2


def test_a_file_that_was_not_whole_is_read_again(node: Path) -> None:
    reader = NodeContainers(node)
    folder = run(node, TASKS / "default", "foreign", None)
    assert [container.program for container in reader.read().containers if container.id == "foreign"] == [""]
    (folder / "config.json").write_text('{"process": {"ar', encoding="utf-8")
    assert [container.program for container in reader.read().containers if container.id == "foreign"] == [""]
    (folder / "config.json").write_text(json.dumps(specification("", "/late")), encoding="utf-8")
    assert [container.program for container in reader.read().containers if container.id == "foreign"] == ["/late"]


def test_what_waits_to_be_started_is_read_again(node: Path) -> None:
    clock = Clock()
    clock.later = 2 * SETTLED_NS
    reader = NodeContainers(node, clock)
    run(node, TASKS / "k8s.io", "foreign", specification(CONTAINER, "/x"))
    fifo = node / STATE / "runc/k8s.io/foreign/exec.fifo"
    os.mkfifo(fifo)
    assert unknown(reader.read()) == ()
    fifo.unlink()
    assert [(one.container.id, one.container.started) for one in unknown(reader.read())] == [("foreign", True)]


def test_what_runc_has_not_made_yet_is_read_again(node: Path) -> None:
    clock = Clock()
    clock.later = 2 * SETTLED_NS
    reader = NodeContainers(node, clock)
    run(node, TASKS / "k8s.io", "foreign", specification(CONTAINER, "/x"))
    state = node / STATE / "runc/k8s.io/foreign/state.json"
    state.unlink()
    assert [one.container.started for one in unknown(reader.read())] == [False]
    state.touch()
    assert [one.container.started for one in unknown(reader.read())] == [True]


def test_another_container_of_the_same_id_is_seen_to_be_another(node: Path) -> None:
    """The kubelet's link is of the one before."""
    reader = NodeContainers(node)
    assert unknown(reader.read()) == ()
    shutil.rmtree(node / TASKS / "k8s.io" / "web")
    file = run(node, TASKS / "k8s.io", "web", specification(CONTAINER, "/other", container_name="web")) / "config.json"
    [before] = (node / LINKS).iterdir()
    while file.stat().st_ctime_ns <= before.lstat().st_ctime_ns:  # the clock of files ticks in milliseconds
        file.touch()
    [stranger] = unknown(reader.read())
    assert stranger.container.program == "/other"


def test_a_node_that_cannot_be_read_is_said_to_be(node: Path) -> None:
    shutil.rmtree(node / TASKS)
    (node / TASKS).symlink_to(TASKS.name)  # a circle
    with pytest.raises(OSError, match="symbolic links"):
        NodeContainers(node).read()


class Clock:
    """Nanoseconds since 1970, as much later than now as a test says."""

    def __init__(self) -> None:
        self.later = 0

    def __call__(self) -> int:
        return time.time_ns() + self.later


def test_what_has_not_changed_for_long_is_not_read_again(node: Path) -> None:
    """Every two seconds, for every node."""
    clock = Clock()
    reader = NodeContainers(node, clock)
    assert reader.read() is not reader.read(), "a folder's clock ticks in milliseconds: another change may follow"
    clock.later = 2 * SETTLED_NS
    settled = reader.read()
    assert reader.read() is settled


@pytest.mark.parametrize(
    "change",
    [
        lambda node: run(node, TASKS / "k8s.io", "foreign", None),
        lambda node: run(node, TASKS / "default", "foreign", None),
        lambda node: run(node, SHIMS / "default", "foreign", None),
        lambda node: shutil.rmtree(node / TASKS / "k8s.io" / "web"),
        lambda node: link(node, "other.log"),
        lambda node: (node / PODS / "uid-other").mkdir(),
        lambda node: (node / RECORDED / "box").rmdir(),
    ],
)
def test_any_change_is_seen_however_long_nothing_changed(node: Path, change: Callable[[Path], object]) -> None:
    clock = Clock()
    clock.later = 2 * SETTLED_NS
    reader = NodeContainers(node, clock)
    before = reader.read()
    stamps = {place.stat().st_mtime_ns for place in node.rglob("*") if place.is_dir()}
    while time.time_ns() - max(stamps) < TICK_NS:
        continue
    change(node)
    assert reader.read() != before
