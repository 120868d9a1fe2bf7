"""Build the site: `ci/python -m ci.docs [--source ADDRESS]`; 0 done, 1 a page is wrong, 3 the machine cannot."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from ci.docs import links, loading, pages
from ci.errors import InputError, SetUpError
from ci.folders import PROJECT
from ci.machine.environments import environment

LOCK = PROJECT / "operator" / "requirements" / "docs.txt"
OUTPUT = PROJECT / "build" / "docs"
FOLDER = Path(__file__).resolve().parent
BESIDE_THE_PAGES = {"conf.py": "conf.py", "site.css": "_static/site.css"}
BUILD_SECONDS_MAX = 300


def generator() -> Path:
    """The program that makes sites, in an environment of its own."""
    return environment("docs", LOCK) / "bin" / "sphinx-build"


def assemble(address: str) -> Path:
    """Write the pages and the generator's settings into the output folder; returns their folder."""
    repository = pages.Repository(frozenset(links.files()), address)
    texts = pages.site(repository, links.text)
    shutil.rmtree(OUTPUT, ignore_errors=True)
    folder = OUTPUT / "pages"
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    beside = {FOLDER / name: target for name, target in BESIDE_THE_PAGES.items()}
    beside |= {PROJECT / name: name for name in repository.pictures()}
    for file, target in beside.items():
        (folder / target).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, folder / target)
    return folder


def build(address: str) -> Path:
    """The folder of the finished site. InputError when a page is wrong or would load something from elsewhere."""
    command = [str(generator()), "--builder", "html", "--quiet", "--fail-on-warning", "--jobs", "auto"]
    folders = [str(assemble(address)), str(OUTPUT / "site"), "--doctree-dir", str(OUTPUT / "doctrees")]
    done = subprocess.run([*command, *folders], capture_output=True, text=True, timeout=BUILD_SECONDS_MAX, check=False)
    if done.returncode:
        raise InputError(f"{done.stderr.strip()}\nThe site was not built; an index.md is the README.md of its folder.")
    foreign = list(loading.findings(OUTPUT / "site"))
    if foreign:
        raise InputError("\n".join(["the site would load from elsewhere:", *foreign]))
    return OUTPUT / "site"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="ci.docs", description="Build the documentation as a site.")
    parser.add_argument("--source", default="", help="address below which a forge shows the files of the repository")
    given = parser.parse_args(arguments)
    try:
        site = build(given.source)
    except SetUpError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print(site.relative_to(PROJECT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
