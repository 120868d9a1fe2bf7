"""The build of the forge's pages: once per version of the forge, with what a program says when it fails; and the lock
of what builds them, which names no address."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from ci import console, web
from ci.errors import SetUpError

NPM = """
import pathlib, sys
pathlib.Path({said!r}).open("a").write("npm " + " ".join(sys.argv[1:]) + chr(10))
place = pathlib.Path("node_modules/pnpm/bin")
place.mkdir(parents=True)
(place / "pnpm.cjs").write_text({pnpm!r})
"""
PNPM = """
import pathlib, sys
pathlib.Path({said!r}).open("a").write("pnpm " + " ".join(sys.argv[1:4]) + chr(10))
place = pathlib.Path("node_modules/vite/bin")
place.mkdir(parents=True)
(place / "vite.js").write_text({vite!r})
"""
VITE = """
import pathlib, sys
pathlib.Path({said!r}).open("a").write("vite " + sys.argv[1] + chr(10))
if {failing!r} == "fails":
    sys.exit("web_src/js/index.ts: no")
place = pathlib.Path("public/assets")
for name in (".vite/manifest.json", "js/index.js", *([] if {failing!r} else ["licenses.txt"])):
    (place / name).parent.mkdir(parents=True, exist_ok=True)
    (place / name).write_text(name)
"""


@pytest.fixture
def said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small module, a cache of its own, and programs for npm, pnpm and Vite; gives the file of what was asked for."""
    module = tmp_path / "module"
    for name in web.FOLDERS:
        (module / name).mkdir(parents=True)
    (module / web.RESULT / "img").mkdir(parents=True)
    for name in web.FILES:
        (module / name).write_text(name)
    for folder in (module / "public", module / web.RESULT):
        folder.chmod(0o555)
    monkeypatch.setattr(web, "module_dir", lambda name: module)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    programs(tmp_path, monkeypatch)
    return tmp_path / "said"


def programs(folder: Path, monkeypatch: pytest.MonkeyPatch, failing: str = "") -> None:
    """Has scripts stand for the programs; Vite `fails`, or leaves something out."""
    said = str(folder / "said")
    vite = VITE.format(said=said, failing=failing)
    (folder / "npm.py").write_text(NPM.format(said=said, pnpm=PNPM.format(said=said, vite=vite)))
    monkeypatch.setattr(console, "node", lambda: (sys.executable, str(folder / "npm.py")))


def test_the_pages_are_built_once_and_nobody_builds_them_unasked(said: Path) -> None:
    assert web.built() is None
    assert not said.exists()
    result = web.build()
    files = {path.relative_to(result).as_posix() for path in result.rglob("*") if path.is_file()}
    assert files == {".vite/manifest.json", "js/index.js", "licenses.txt"}
    assert not (result / "img").exists(), "the module has that"
    asked = said.read_text().splitlines()
    assert [line.split()[:2] for line in asked] == [["npm", "ci"], ["pnpm", "install"], ["vite", "build"]]
    assert "--frozen-lockfile" in asked[1]
    assert web.built() == web.build() == result
    assert said.read_text().splitlines() == asked


def test_they_are_of_one_version_of_the_forge(said: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = web.build()
    sums = web.GO_SUM.read_text()
    monkeypatch.setattr(web, "GO_SUM", tmp_path / "go.sum")
    web.GO_SUM.write_text(sums + "example.org/other v1.0.0 h1:AAAA=\n")
    assert web.built() == first
    web.GO_SUM.write_text(sums.replace(f"{web.GITEA} v", f"{web.GITEA} v9"))
    assert web.built() is None


@pytest.mark.parametrize(
    ("failing", "words"),
    [
        ("fails", r"vite\.js build --logLevel warn:\nweb_src/js/index\.ts: no"),
        ("incomplete", r"made no licenses\.txt in public/assets"),
    ],
)
def test_a_build_that_fails_leaves_nothing(
    said: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str, words: str
) -> None:
    programs(tmp_path, monkeypatch, failing)
    with pytest.raises(SetUpError, match=words):
        web.build()
    assert web.built() is None
    assert list((tmp_path / "cache" / "robotkube" / "web").iterdir()) == []


def test_a_module_without_the_sources_is_refused(said: Path, tmp_path: Path) -> None:
    (tmp_path / "module" / "pnpm-lock.yaml").unlink()
    with pytest.raises(SetUpError, match=r"the forge's module has no pnpm-lock\.yaml, without which"):
        web.build()


def test_old_builds_go(said: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(web.KEPT_BUILDS + 2):
        monkeypatch.setattr(web, "FORMAT", str(number))
        newest = web.build()
    kept = list((tmp_path / "cache" / "robotkube" / "web").glob("*/assets"))
    assert len(kept) == web.KEPT_BUILDS
    assert newest in kept


def test_the_lock_names_no_address() -> None:
    lock = json.loads((web.FOLDER / "package-lock.json").read_text())
    packages = {name: one for name, one in lock["packages"].items() if name}
    assert set(packages) == {"node_modules/pnpm"}
    assert all(
        "resolved" not in package and package["integrity"].startswith("sha512-") for package in packages.values()
    )
