"""What layers leave: whiteouts, opaque folders, links, and the packages that are stated in the files that remain."""

from __future__ import annotations

import pytest

from robotkube.errors import InputError
from robotkube.registry.suites.adapters.image_layers import read_layer
from robotkube.registry.suites.core.image_contents import ImageContents, contents_of, stated_text
from tests.stages.registry.made_layers import ELF, FILES, SITE, Content, hex_of, made_layer


def image(*layers: dict[str, Content]) -> ImageContents:
    return contents_of(read_layer(iter([made_layer(files)])) for files in layers)


def test_packages_and_elf_files_are_named() -> None:
    contents = image(FILES)
    assert contents.debian == {("libc6", "2.36-9+deb12u1")}
    assert contents.sources == {("glibc", "2.36-9+deb12u1")}
    assert contents.wheels == {("pyyaml", "6.0.3")}
    program = hex_of(ELF + b"program")
    assert contents.elf == {
        "/usr/bin/tool": program,
        "/usr/bin/same-tool": program,
        "/usr/lib/libx.so.1": hex_of(ELF + b"library"),
    }
    assert "/usr/bin/script" in contents.files


@pytest.mark.parametrize(
    ("upper", "gone"),
    [
        ({"usr/bin/.wh.tool": b""}, {"/usr/bin/tool"}),
        ({"usr/.wh.bin": b""}, {"/usr/bin/tool", "/usr/bin/same-tool"}),
        ({"usr/bin/.wh..wh..opq": b""}, {"/usr/bin/tool", "/usr/bin/same-tool"}),
        ({"lib/.wh.libx.so.1": b""}, {"/usr/lib/libx.so.1"}),
        ({"usr/bin": b"a file now"}, {"/usr/bin/tool", "/usr/bin/same-tool"}),
        ({"usr/bin/tool": b"#!/bin/sh\n"}, {"/usr/bin/tool"}),
        ({"usr/bin/tool": ("symlink", "same-tool")}, {"/usr/bin/tool"}),
        ({".wh.lib": b""}, set()),
        ({"usr/.wh.nothing": b"", "nowhere/.wh..wh..opq": b"", "usr/bin": None}, set()),
    ],
)
def test_what_a_layer_hides_is_not_there(upper: dict[str, Content], gone: set[str]) -> None:
    assert image(FILES).elf.keys() - image(FILES, upper).elf.keys() == gone


def test_a_whiteout_does_not_hide_what_its_own_layer_has() -> None:
    upper: dict[str, Content] = {"usr/bin/new": ELF, "usr/bin/.wh..wh..opq": b"", "usr/bin/.wh.new": b""}
    assert image(FILES, upper).elf.keys() == {"/usr/bin/new", "/usr/lib/libx.so.1"}


def test_a_path_leads_through_symbolic_links() -> None:
    upper: dict[str, Content] = {"lib/liby.so": ELF, "a": ("symlink", "/lib/../lib"), "a/libz.so": ELF}
    assert image(FILES, upper).elf.keys() - image(FILES).elf.keys() == {"/usr/lib/liby.so", "/usr/lib/libz.so"}
    assert image({"up": ("symlink", "../../etc"), "up/x": ELF}).elf.keys() == {"/etc/x"}


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"a": ("symlink", "b"), "b": ("symlink", "a"), "a/x": ELF}, "symbolic links lead on"),
        ({"a": ("hardlink", "usr/bin/none")}, "a hard link to /usr/bin/none, which is not there"),
        ({"a": b"x", f"{SITE}/a-1.dist-info/METADATA": ("hardlink", "a")}, "another name of a file that states no"),
    ],
)
def test_what_cannot_be_followed_is_refused(files: dict[str, Content], words: str) -> None:
    with pytest.raises(InputError, match=words):
        image(files)


def test_packages_without_dpkg_and_without_wheels() -> None:
    contents = image(
        {
            "var/lib/dpkg/status.d/tzdata": b"Package: tzdata\nVersion: 2026a\n",
            "var/lib/dpkg/status.d/tzdata.md5sums": b"Package: none\nVersion: 1\n",
            "usr/lib/python3/dist-packages/six-1.16.egg-info": b"Name: six\nVersion: 1.16.0\n",
            "opt/ros/lib/ament_x-2.egg-info/PKG-INFO": b"Name: ament_x\nVersion: 2\n",
            "opt/x/nameless-3.1.dist-info/METADATA": b"",
        }
    )
    assert contents.debian == {("tzdata", "2026a")}
    assert contents.eggs == {("six", "1.16.0"), ("ament-x", "2")}
    assert contents.wheels == {("nameless", "3.1")}


def test_only_the_lines_that_say_what_is_installed_are_kept() -> None:
    metadata = b"Name: a\r\nSummary: b\r\nVersion: 1\r\n\r\nName: in the text\r\n"
    assert stated_text("x/a-1.dist-info/METADATA", metadata) == "Name: a\nVersion: 1\n"
