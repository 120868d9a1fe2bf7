"""Which address stands behind which port of a node's bridge, read off the files that containerd's plug-ins leave."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.embedded.network.pod_links import SETTLED_NS, NodeLinks, PodLink, read_link
from tests.stages.network.results import result, write_result

WEB = PodLink("veth46463cd1", "10.245.1.40", "shop", "web", "uid-web")
STORE = PodLink("veth90017a3e", "10.245.1.41", "shop", "store", "uid-store")


class Clock:
    """Nanoseconds since 1970, as long after the folder's last change as a test says."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.later = 0

    def __call__(self) -> int:
        return self.folder.stat().st_mtime_ns + self.later


def test_a_result_says_port_address_and_pod() -> None:
    assert read_link(result(WEB)) == WEB


def changed(**parts: Any) -> dict[str, Any]:
    return {**result(WEB), **parts}


@pytest.mark.parametrize(
    "document",
    [
        {},
        changed(cniArgs=[]),
        changed(result={}),
        changed(result={**result(WEB)["result"], "ips": []}),
        changed(result={**result(WEB)["result"], "interfaces": []}),
        result(PodLink('a" drop', "10.245.1.40", "shop", "web", "uid")),
        result(PodLink("veth1", "no address", "shop", "web", "uid")),
    ],
)
def test_what_is_no_result_gives_no_link(document: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises((KeyError, ValueError, TypeError)):
        read_link(document)
    (tmp_path / "robotkube-other-eth0").write_text(json.dumps(document), encoding="utf-8")
    assert NodeLinks(tmp_path).read() == frozenset()


def test_a_node_without_pods_has_none(tmp_path: Path) -> None:
    assert NodeLinks(tmp_path / "results").read() == frozenset()


def test_pods_come_and_go_and_what_is_of_other_networks_is_not_read(tmp_path: Path) -> None:
    links = NodeLinks(tmp_path)
    write_result(tmp_path, WEB)
    (tmp_path / "other-abc-eth0").write_text(json.dumps(result(STORE)), encoding="utf-8")
    (tmp_path / "robotkube-abc-eth0.tmp").write_text("{", encoding="utf-8")
    assert links.read() == {WEB}
    path = write_result(tmp_path, STORE)
    assert links.read() == {WEB, STORE}
    path.unlink()
    assert links.read() == {WEB}


def test_a_file_that_was_half_written_is_read_again(tmp_path: Path) -> None:
    """Its end changes the file, not the folder."""
    clock = Clock(tmp_path)
    links = NodeLinks(tmp_path, clock)
    path = write_result(tmp_path, WEB)
    whole = path.read_text(encoding="utf-8")
    path.write_text(whole[:100], encoding="utf-8")
    clock.later = 2 * SETTLED_NS
    assert links.read() == frozenset()
    path.write_text(whole, encoding="utf-8")
    assert links.read() == {WEB}


def test_a_second_change_within_the_same_tick_of_the_folder_is_seen(tmp_path: Path) -> None:
    clock = Clock(tmp_path)
    links = NodeLinks(tmp_path, clock)
    write_result(tmp_path, WEB)
    stamp = tmp_path.stat().st_mtime_ns
    assert links.read() == {WEB}
    write_result(tmp_path, STORE)
    os.utime(tmp_path, ns=(stamp, stamp))
    assert links.read() == {WEB, STORE}


def test_a_folder_that_has_not_changed_for_long_is_not_read_again(tmp_path: Path) -> None:
    """Asked twenty times a second, for every node."""
    clock = Clock(tmp_path)
    links = NodeLinks(tmp_path, clock)
    path = write_result(tmp_path, WEB)
    clock.later = 2 * SETTLED_NS
    stamp = tmp_path.stat().st_mtime_ns
    assert links.read() == {WEB}
    path.unlink()
    os.utime(tmp_path, ns=(stamp, stamp))
    assert links.read() == {WEB}, "it was read again"
