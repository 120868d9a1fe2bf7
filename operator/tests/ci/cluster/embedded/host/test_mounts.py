"""Mounts of a cluster are counted: those below its folder, and those of its nodes' mount namespaces."""

from __future__ import annotations

from pathlib import Path

from ci.cluster.embedded.host import mounts

LINE = "{number} 1 0:{device} {root} {place} rw,relatime shared:1 - tmpfs tmpfs rw\n"
OURS = [(20, "/", "/"), (21, "/", "/proc")]


def process(proc: Path, name: str, namespace: str, lines: list[tuple[int, str, str]]) -> None:
    """A process of a made-up /proc, in a mount namespace with these mounts: device, folder of it, place."""
    (proc / name / "ns").mkdir(parents=True)
    (proc / name / "ns" / "mnt").symlink_to(namespace)
    text = "".join(LINE.format(number=n, device=d, root=root, place=at) for n, (d, root, at) in enumerate(lines, 30))
    (proc / name / "mountinfo").write_text(text)


def test_what_is_mounted_below_the_folder_is_counted_in_its_order(tmp_path: Path) -> None:
    lines = [*OURS, (22, "/", "/cache/trial/a"), (23, "/", "/cache/trial/a/b\\040c"), (24, "/", "/cache/trialist/x")]
    process(tmp_path, "self", "mnt:[1]", lines)
    assert mounts.below(Path("/cache/trial"), tmp_path) == ("/cache/trial/a", "/cache/trial/a/b c")
    assert mounts.below(Path("/cache/other"), tmp_path) == ()


def test_a_node_counts_what_it_does_not_share_with_the_machine(tmp_path: Path) -> None:
    node = [*OURS, (20, "/cache/trial/node/run", "/run/containerd"), (25, "/", "/run/containerd/rootfs")]
    process(tmp_path, "self", "mnt:[1]", OURS)
    process(tmp_path, "7", "mnt:[2]", node)
    process(tmp_path, "8", "mnt:[2]", node)
    process(tmp_path, "9", "mnt:[3]", [*OURS, (26, "/", "/run/containerd")])
    process(tmp_path, "10", "mnt:[1]", OURS)
    assert mounts.in_namespaces([10], tmp_path) == 0
    assert mounts.in_namespaces([7, 8], tmp_path) == 2
    assert mounts.in_namespaces([7, 8, 9, 10, 11], tmp_path) == 3


def test_this_machine_has_mounts() -> None:
    assert "/" in [mount.place for mount in mounts.read("self")]
