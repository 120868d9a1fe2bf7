"""A bill against the image: what is on one side only is named, whichever side it is."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from robotkube.registry.suites.adapters.image_layers import read_layer
from robotkube.registry.suites.core.bill_comparison import differences
from robotkube.registry.suites.core.image_contents import contents_of
from tests.stages.registry.made_layers import ELF, FILES, hex_of, made_layer

IMAGE = contents_of([read_layer(iter([made_layer(FILES)]))])


def listed_file(path: str, content: bytes) -> dict[str, Any]:
    return {"type": "file", "name": path, "hashes": [{"alg": "SHA-256", "content": hex_of(content)}]}


BILL: dict[str, Any] = {
    "components": [
        {"type": "library", "purl": "pkg:deb/debian/libc6@2.36-9%2Bdeb12u1?arch=amd64&distro=debian-12"},
        {"type": "library", "purl": "pkg:deb/debian/glibc@2.36-9%2Bdeb12u1?arch=source"},
        {"type": "library", "purl": "pkg:pypi/PyYAML@6.0.3"},
        {"type": "library", "purl": "pkg:golang/github.com/a/b@v1.0.0"},
        listed_file("/usr/bin/tool", ELF + b"program"),
        listed_file("/usr/bin/same-tool", ELF + b"program"),
        {"type": "application", "name": "x", "components": [listed_file("usr/lib/libx.so.1", ELF + b"library")]},
        listed_file("/usr/bin/script", b"of files that are no ELF files only the name is looked at"),
    ]
}


def without(text: str) -> dict[str, Any]:
    bill = copy.deepcopy(BILL)
    bill["components"] = [one for one in bill["components"] if text not in str(one)]
    return bill


def with_more(*components: dict[str, Any], bill: dict[str, Any] = BILL) -> dict[str, Any]:
    return {"components": [*bill["components"], *components]}


def test_a_bill_of_this_image_has_no_differences() -> None:
    assert list(differences(BILL, IMAGE)) == []


@pytest.mark.parametrize(
    ("bill", "words"),
    [
        (without("libc6"), "lacks 1 Debian package of the image: libc6 2.36-9+deb12u1"),
        (without("PyYAML"), "lacks 1 Python package of the image: pyyaml 6.0.3"),
        (without("same-tool"), "lacks 1 ELF file of the image: /usr/bin/same-tool"),
        (
            with_more({"purl": "pkg:deb/debian/gone@1.0"}),
            "names 1 Debian package that the image does not have: gone 1.0",
        ),
        (
            with_more({"purl": "pkg:deb/debian/zlib@1?arch=source"}),
            "names 1 Debian source package that the image does not have: zlib 1",
        ),
        (with_more({"purl": "pkg:pypi/six@1"}), "names 1 Python package that the image does not have: six 1"),
        (with_more(listed_file("/opt/x", ELF)), "names 1 file that the image does not have: /opt/x"),
        (
            with_more(listed_file("/usr/bin/tool", b"other")),
            "has another digest than the image for 1 ELF file: /usr/bin/tool",
        ),
        (
            with_more({"type": "file", "name": "/usr/bin/tool"}, bill=without("'/usr/bin/tool'")),
            "lacks 1 ELF file's digest of the image: /usr/bin/tool",
        ),
    ],
)
def test_one_thing_on_one_side_is_named(bill: dict[str, Any], words: str) -> None:
    assert list(differences(bill, IMAGE)) == [words]


def test_the_first_few_are_named_and_the_others_counted() -> None:
    more = [listed_file(f"/opt/{number}", b"") for number in range(8)]
    words = "names 8 files that the image does not have: /opt/0, /opt/1, /opt/2, /opt/3, /opt/4 and 3 more"
    assert list(differences(with_more(*more), IMAGE)) == [words]


@pytest.mark.parametrize("components", [None, "text", [1, None], [{"purl": 3, "components": "x"}], [{"type": "file"}]])
def test_components_of_the_wrong_form_name_nothing_or_what_is_not_there(components: Any) -> None:
    assert len(list(differences({"components": components}, IMAGE))) >= 3
