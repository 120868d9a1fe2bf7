"""The build of the console's page: once per digest of its sources, with what a script says when it fails; and the lock
of its packages, which names no address."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest

from ci import console
from ci.errors import InputError

NPM = """
import pathlib, sys
pathlib.Path({said!r}).open("a").write(" ".join(sys.argv[1:]) + chr(10))
if sys.argv[1] == "ci":
    pathlib.Path("node_modules").mkdir()
if sys.argv[-1] == {failing!r}:
    sys.exit("src/main.tsx(1,1): error: no")
if sys.argv[-1] == "build":
    pathlib.Path("dist").mkdir()
    pathlib.Path("dist/index.html").write_text(pathlib.Path("index.html").read_text())
"""


@pytest.fixture
def said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Sources of a small page, a cache of its own, and a program for npm; gives the file of what npm was asked for."""
    sources = tmp_path / "console"
    sources.mkdir()
    for name in ("package.json", "package-lock.json", ".npmrc"):
        shutil.copyfile(console.SOURCES / name, sources / name)
    (sources / "index.html").write_text("<p>page</p>")
    monkeypatch.setattr(console, "SOURCES", sources)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    npm(tmp_path, monkeypatch)
    return tmp_path / "said"


def npm(folder: Path, monkeypatch: pytest.MonkeyPatch, failing: str = "") -> None:
    """Has a script stand for npm, which fails at the script `failing` of package.json."""
    script = folder / "npm.py"
    script.write_text(NPM.format(said=str(folder / "said"), failing=failing))
    monkeypatch.setattr(console, "node", lambda: (sys.executable, str(script)))


def test_the_page_is_built_once_and_again_when_a_source_changes(said: Path) -> None:
    first = console.build()
    assert (first / "index.html").read_text() == "<p>page</p>"
    asked = said.read_text().splitlines()
    assert [line.split()[-1] for line in asked] == ["--loglevel=error", "types", "build"]
    assert console.build() == first
    assert said.read_text().splitlines() == asked
    (console.SOURCES / "index.html").write_text("<p>other</p>")
    assert (console.build() / "index.html").read_text() == "<p>other</p>"
    assert said.read_text().splitlines()[len(asked) :] == ["run --silent types", "run --silent build"]


def test_what_is_generated_or_installed_is_no_source(said: Path) -> None:
    before = console.key()
    for name in ("node_modules/preact/index.js", "dist/index.html", "src/api.d.ts"):
        (console.SOURCES / name).parent.mkdir(parents=True, exist_ok=True)
        (console.SOURCES / name).write_text("generated")
    assert console.key() == before


def test_only_the_newest_builds_are_kept(said: Path) -> None:
    for number in range(5):
        (console.SOURCES / "index.html").write_text(str(number))
        newest = console.build()
    kept = list(newest.parent.parent.glob("*/dist"))
    assert newest in kept
    assert len(kept) == console.KEPT_BUILDS


def test_sources_are_checked_once(said: Path) -> None:
    assert console.findings() == []
    asked = said.read_text()
    assert [line.split()[-1] for line in asked.splitlines()[1:]] == ["types", "form", "check", "test"]
    assert console.findings() == []
    assert said.read_text() == asked


def test_a_finding_is_what_the_script_said_and_is_found_again(
    said: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    npm(tmp_path, monkeypatch, failing="check")
    for _ in range(2):
        (finding,) = console.findings()
        assert finding == "operator/console: npm run --silent check:\nsrc/main.tsx(1,1): error: no"


def test_a_build_that_fails_leaves_nothing(said: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    npm(tmp_path, monkeypatch, failing="build")
    with pytest.raises(InputError, match=r"operator/console: npm run --silent build:\nsrc/main\.tsx"):
        console.build()
    assert not list((tmp_path / "cache" / "robotkube" / "console").glob("*/dist"))
    npm(tmp_path, monkeypatch)
    assert console.build().is_dir()


def test_every_package_is_pinned_with_a_hash_and_no_address() -> None:
    package = json.loads((console.SOURCES / "package.json").read_text())
    for version in (package["dependencies"] | package["devDependencies"]).values():
        assert version[0].isdigit(), version
    locked = json.loads((console.SOURCES / "package-lock.json").read_text())["packages"]
    assert len(locked) > 10
    assert [name for name, entry in locked.items() if "resolved" in entry] == []
    assert [name for name, entry in locked.items() if name and not entry.get("integrity")] == []
