"""Which files of a package a process needs."""

from __future__ import annotations

import pytest

from ci.images.closures import closure

SOURCES = {
    "package/__init__.py": b"",
    "package/one/__init__.py": b"",
    "package/one/__main__.py": b"from package.two import thing\n",
    "package/one/unused.py": b"import package.lonely\n",
    "package/one/own.txt": b"data of one\n",
    "package/two/__init__.py": b"",
    "package/two/thing.py": b"from . import near\n\ndef late():\n    from package import late\n",
    "package/two/near.py": b"NAME = 'package.started'\nOTHER = 'package.lonely is only spoken of'\n",
    "package/two/profiles/deep/a.xml": b"<a/>\n",
    "package/late.py": b"from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import package.lonely\n",
    "package/started.py": b"import json\n",
    "package/lonely.py": b"",
    "package/apart/__init__.py": b"",
    "package/apart/data.json": b"{}",
}


def test_all_that_may_be_imported_is_there_with_its_data_and_nothing_else() -> None:
    assert closure(SOURCES, ["package.one.__main__"]) == {
        "package/__init__.py",
        "package/one/__init__.py",
        "package/one/__main__.py",
        "package/one/own.txt",
        "package/two/__init__.py",
        "package/two/thing.py",
        "package/two/near.py",
        "package/two/profiles/deep/a.xml",
        "package/late.py",
        "package/started.py",
    }


@pytest.mark.parametrize(
    ("statement", "needed"),
    [
        ("import typing\nif typing.TYPE_CHECKING:\n    import package.lonely", False),
        ("import importlib\nimportlib.import_module('package.lonely')", True),
        ("from package import lonely", True),
        ("from package.lonely import anything", True),
        ("COMMAND = ('python3', '-m', 'package.lonely')", True),
        ("TEXT = 'see package.lonely'", False),
    ],
)
def test_how_a_module_is_named(statement: str, needed: bool) -> None:
    files = closure({**SOURCES, "package/root.py": statement.encode()}, ["package.root"])
    assert ("package/lonely.py" in files) == needed


def test_several_roots_add_up_and_circles_end() -> None:
    circle = {"a.py": b"import b", "b.py": b"import a", "c.py": b"", "d.py": b""}
    assert closure(circle, ["a", "c"]) == {"a.py", "b.py", "c.py"}


def test_a_root_that_is_not_there_is_named() -> None:
    with pytest.raises(ValueError, match=r"no module package\.nothing"):
        closure(SOURCES, ["package.nothing"])
