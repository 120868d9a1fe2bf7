"""`python -m ci.images`: build the images; `context NAME FOLDER`: one image's build context for `docker build`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ci.errors import SetUpError
from ci.images.building import NAMES, build_images, cache_folder, sources
from ci.images.catalogue import BY_NAME
from ci.images.contexts import ContextError, assemble, check
from ci.images.services import GROUND, SERVICE_NAMES
from ci.machine import preparing
from ci.steps import Steps
from robotkube.errors import RobotKubeError
from robotkube.registry.images.adapters.buildah import BuildError


def arguments(words: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m ci.images", description=__doc__)
    parser.add_argument("names", nargs="*", help="images to build (default: all); or context NAME FOLDER")
    parser.add_argument(
        "--toolchain-bin",
        type=Path,
        help="folder with gitea, argocd, helm, ferretdb (default: the tool chain, built when needed)",
    )
    parser.add_argument("--folder", type=Path, default=cache_folder(), help="where archives and images.json go")
    parser.add_argument("--fresh", action="store_true", help="build again without any cache")
    return parser.parse_args(words)


def write_context(name: str, folder: Path, toolchain_bin: Path) -> None:
    if name in SERVICE_NAMES:
        raise BuildError(
            f"{name} is cut from {GROUND}: build that by a context, and this with: python -m ci.images {name}"
        )
    if name not in BY_NAME:
        raise BuildError(f"no such image: {name}; there are {', '.join(BY_NAME)}")
    contents = BY_NAME[name].contents(sources(toolchain_bin))
    check(name, contents)
    assemble(contents, folder)
    (folder / "Dockerfile").write_bytes(BY_NAME[name].dockerfile.read_bytes())


def main() -> int:
    given = arguments()
    try:
        given.toolchain_bin = given.toolchain_bin or preparing.tool_chain()
        if given.names[:1] == ["context"] and len(given.names) == 3:
            write_context(given.names[1], Path(given.names[2]), given.toolchain_bin)
            return 0
        steps = Steps(len(given.names) or len(NAMES))
        built = build_images(given.toolchain_bin, given.folder, given.names, fresh=given.fresh, steps=steps)
    except (ContextError, SetUpError, RobotKubeError) as error:
        print(f"images: {error}", file=sys.stderr)
        return getattr(error, "exit_code", 1)
    except KeyboardInterrupt:
        print("images: interrupted; what was finished is kept", file=sys.stderr)
        return 130
    layers = {digest: size for image in built.values() for digest, size in image.layers.items()}
    for image in built.values():
        print(f"{image.reference} {image.size / 1e6:.0f} MB")
    print(
        f"all layers together {sum(layers.values()) / 1e6:.0f} MB; lock: {given.folder / 'images.json'}",
        file=sys.stderr,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
