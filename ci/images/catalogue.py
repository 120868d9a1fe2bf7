"""The images: what each is made of and what it stands on."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ci.images.contexts import ContextError, Copied

TOP = Path(__file__).resolve().parent.parent.parent
DOCKERFILES = TOP / "operator" / "images"
MODULE_SECONDS_MAX = 300


@dataclass(frozen=True)
class Sources:
    """The sources of programs, Go modules' files and pages; `module` maps (module path, folder of the go.mod naming
    it) to its folder, `page` builds the console's page when it is not there and gives its folder; `forge_pages`: what
    the forge's pages load, None where nobody has built that (`make web`)."""

    toolchain_bin: Path
    module: Callable[[str, str], Path]
    page: Callable[[], Path]
    forge_pages: Path | None = None


@cache
def go_module(path: str, folder: str) -> Path:
    """The folder of a Go module that ci/`folder`/go.mod names, fetched if it is not in the module cache."""
    command = ["go", "mod", "download", "-json", path]
    done = subprocess.run(
        command, cwd=TOP / "ci" / folder, capture_output=True, text=True, timeout=MODULE_SECONDS_MAX, check=False
    )
    module = json.loads(done.stdout or "{}")
    if done.returncode or "Dir" not in module:
        raise ContextError(f"go module {path} (ci/{folder}/go.mod): {module.get('Error') or done.stderr.strip()}")
    return Path(module["Dir"])


@dataclass(frozen=True)
class ImageRecipe:
    """An image to build: `name` is also the folder of its Dockerfile; `stands_on`: the image it begins with (or is
    built in), empty: none."""

    name: str
    contents: Callable[[Sources], tuple[Copied, ...]]
    stands_on: str = "base"

    @property
    def dockerfile(self) -> Path:
        return DOCKERFILES / self.name / "Dockerfile"


def _repository(path: str, *, executable: bool = False, optional: bool = False) -> Copied:
    return Copied(TOP / path, path, executable, optional)


def _script(path: str) -> Copied:
    return _repository(path, executable=True)


def _program(sources: Sources, name: str) -> Copied:
    return Copied(sources.toolchain_bin / name, f"bin/{name}", executable=True)


def _package() -> tuple[Copied, ...]:
    """The Python package and what makes its commands."""
    return (
        _repository("operator/src/robotkube"),
        _repository("operator/pyproject.toml"),
        _script("operator/images/install-commands"),
    )


def _ros(_: Sources) -> tuple[Copied, ...]:
    return (
        _repository("operator/requirements/robot.txt"),
        _repository("operator/native/robotkube_rcl.c"),
        _script("operator/native/build"),
        _script("operator/images/ros/prune"),
        *_package(),
    )


def _platform(sources: Sources) -> tuple[Copied, ...]:
    return (
        _repository("operator/requirements/platform.txt"),
        _program(sources, "chart-renderer"),
        Copied(sources.page(), "operator/console/dist"),
        *_package(),
        _repository("gitops", optional=True),
        _repository("registry/schemas", optional=True),
    )


def _suites(sources: Sources) -> tuple[Copied, ...]:
    return (_program(sources, "helm"),)


def _gitea(sources: Sources) -> tuple[Copied, ...]:
    module = sources.module("code.gitea.io/gitea", "toolchain/gitea")
    data = [Copied(module / name, f"share/gitea/{name}") for name in ("options", "templates", "public")]
    if sources.forge_pages:
        data.append(Copied(sources.forge_pages, "share/gitea/public/assets"))
    return (_program(sources, "gitea"), _program(sources, "forge-hook"), *data)


def _argocd(sources: Sources) -> tuple[Copied, ...]:
    module = sources.module("github.com/argoproj/argo-cd/v3", "toolchain")
    scripts = ("entrypoint.sh", "hack/gpg-wrapper.sh", "hack/git-verify-wrapper.sh")
    wrappers = [Copied(module / path, f"share/argocd/{Path(path).name}", executable=True) for path in scripts]
    return (_program(sources, "argocd"), _program(sources, "helm"), *wrappers)


def _licences() -> tuple[Copied, ...]:
    """What goes into /licenses of every image: the base's layer brings it to those that begin with it."""
    return (_repository("LICENSE"), _repository("NOTICE"))


def _base(_: Sources) -> tuple[Copied, ...]:
    scripts = ("install-packages", "install-git", "compile-python")
    return (*(_script(f"operator/images/base/{name}") for name in scripts), *_licences())


BASE = ImageRecipe("base", _base, stands_on="")
IMAGES: tuple[ImageRecipe, ...] = (  # each after the one it stands on
    BASE,
    ImageRecipe("pause", lambda _: (_repository("operator/images/pause/pause.c"), *_licences())),
    ImageRecipe("mosquitto", lambda _: ()),
    ImageRecipe("redis", lambda _: ()),
    ImageRecipe("gitea", _gitea),
    ImageRecipe("argocd", _argocd),
    ImageRecipe("ferretdb", lambda sources: (_program(sources, "ferretdb"), *_licences()), stands_on=""),
    ImageRecipe("platform", _platform),
    ImageRecipe("suites", _suites, stands_on="platform"),
    ImageRecipe("ros", _ros),
)
BY_NAME = {image.name: image for image in IMAGES}
