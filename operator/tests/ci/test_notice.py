"""LICENSE and NOTICE: what is shipped changed is named, file by file, and both go with the Python distribution."""

from __future__ import annotations

import re
import tomllib

from ci.folders import PROJECT

CHANGED = PROJECT / "ci" / "toolchain" / "ferretdb"
NOTICE = (PROJECT / "NOTICE").read_text(encoding="utf-8")


def test_every_file_that_a_patch_changes_is_named() -> None:
    patches = [path.read_text(encoding="utf-8") for path in sorted((CHANGED / "patches").glob("*.patch"))]
    changed = {name for text in patches for name in re.findall(r"^\+\+\+ b/(\S+)$", text, re.MULTILINE)}
    assert len(changed) > 5
    assert [name for name in sorted(changed) if name not in NOTICE] == []


def test_every_file_that_is_added_is_named() -> None:
    overlay = CHANGED / "overlay"
    added = [path.relative_to(overlay).as_posix() for path in sorted(overlay.rglob("*.go"))]
    assert added
    assert [name for name in added if name not in NOTICE] == []


def test_versions_are_those_that_are_built() -> None:
    versions = dict(re.findall(r"^\s+(\S+) (v[\d.]+)", (CHANGED.parent / "go.mod").read_text(), re.MULTILINE))
    assert f"Argo CD {versions['github.com/argoproj/argo-cd/v3']}," in NOTICE
    version = re.search(r'^VERSION = "(.*)"$', (CHANGED / "build.py").read_text(), re.MULTILINE)
    assert version
    assert f"FerretDB {version[1]}," in NOTICE


def test_the_distribution_carries_both() -> None:
    project = tomllib.loads((PROJECT / "operator" / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["license"] == "Apache-2.0"
    for name in project["license-files"]:
        assert (PROJECT / "operator" / name).resolve() == PROJECT / name
    assert "Version 2.0, January 2004" in (PROJECT / "LICENSE").read_text(encoding="utf-8")
