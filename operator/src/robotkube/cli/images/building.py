"""The command `robotkube image build DIR`: the folder's Dockerfile as an image that the same contents make again byte
by byte, with its bill of materials, in an archive. Nothing is sent anywhere.

Ends with 0 when the archive is written, 2 when the build failed or something is missing, 3 when the base image's OCI
registry does not answer.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from robotkube.cli.output import Table
from robotkube.cli.registry.reaching import reach
from robotkube.cli.registry.submit import IMAGES_HELP, choosing_forge
from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import CHART_NAME
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.images.adapters.base_images import fetch_base, local_tag
from robotkube.registry.images.adapters.engines import PROGRAMS, choose_engine
from robotkube.registry.images.adapters.message_packages import FOLDER, message_packages, with_messages
from robotkube.registry.images.adapters.own_images import DOCKERFILE, OwnImage, build_image
from robotkube.registry.images.core.dockerfiles import BASE, wants_base
from robotkube.registry.images.ports import Engine
from robotkube.registry.publication.adapters.tried_folders import registry_above
from robotkube.registry.suites.core.image_checks import read_reference

DEFAULT_BASE = "ros"
ARCHITECTURES = {"x86_64": "amd64", "aarch64": "arm64"}
REGISTRY = Path("registry")


@dataclass(frozen=True)
class Built:
    """An image with the program that built it."""

    image: OwnImage
    engine: str


def choosing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `build`."""
    parser.add_argument("source", type=Path, metavar="DIR", help=f"folder with a {DOCKERFILE}, such as a chart's")
    choosing_build(parser)


def choosing_build(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say how something is built."""
    parser.add_argument("--name", default="", help="of the image (default: that of the chart, the folder or the file)")
    parser.add_argument(
        "--base",
        default="",
        metavar="IMAGE",
        help=f"the build argument {BASE}: a name of the platform's images, or a reference (default: {DEFAULT_BASE}, "
        f"where the {DOCKERFILE} has none)",
    )
    parser.add_argument("--engine", default="", choices=PROGRAMS, help="what builds (default: the first that is here)")
    parser.add_argument("--archive", type=Path, metavar="FILE", help="where the image goes (default: the user's cache)")
    parser.add_argument("--registry", type=Path, metavar="FOLDER", help="the catalogue's sources (default: above DIR)")
    parser.add_argument("--images", type=Path, metavar="FILE", help=IMAGES_HELP)
    choosing_forge(parser)


def build(options: argparse.Namespace) -> Table:
    """Build; the one row says what came out."""
    built = build_source(options)
    image = built.image
    row = {"image": image.name, "digest": image.digest, "engine": built.engine}
    row |= {"archive": str(image.archive), "bill": str(image.bill)}
    return Table("images", ("image", "digest", "engine", "archive"), [row])


def build_source(options: argparse.Namespace) -> Built:
    """Build the folder that the options name."""
    folder: Path = options.source
    dockerfile = folder / DOCKERFILE
    if not dockerfile.is_file():
        raise InputError(f"{dockerfile}: missing; name the folder that has it, or an OCI layout archive to push")
    name = image_name(options.name or _own_name(folder))
    engine = choose_engine(_cache() / "engine", options.engine)
    print(f"robotkube: {engine.program} builds {dockerfile}", file=sys.stderr)
    base = options.base or (DEFAULT_BASE if wants_base(dockerfile.read_text(encoding="utf-8")) else "")
    packages = message_packages(folder)
    if packages and not base:
        needed = f"write ARG {BASE} in the {DOCKERFILE}"
        raise InputError(f"{folder / FOLDER}: is compiled into the image to build on; {needed}")
    arguments = {BASE: _provided(base, options, engine)} if base else {}
    if packages:
        print(f"robotkube: compiles message packages {', '.join(packages)}", file=sys.stderr)
        arguments[BASE] = with_messages(folder, name, arguments[BASE], engine)
    archive = options.archive or _cache() / f"{name}.tar"
    return Built(build_image(folder, name, archive, engine, arguments), engine.program)


def image_name(name: str) -> str:
    """`name`; InputError when it is none for an image."""
    if not CHART_NAME.fullmatch(name):
        raise InputError(f"image name {name!r}: use lower-case letters, digits and single hyphens; give it with --name")
    return name


def sources_of(options: argparse.Namespace) -> Path:
    """The folder of the catalogue's sources."""
    if options.registry:
        return Path(options.registry)
    return registry_above(options.source.resolve()) if options.source.is_dir() else REGISTRY


def _own_name(folder: Path) -> str:
    return folder.resolve().name


def _provided(base: str, options: argparse.Namespace, engine: Engine) -> str:
    """The base image as the engine knows it: what the platform's OCI registry has is brought to it."""
    reached = reach(options, _sources_or_none(options))
    reference = read_reference(reached.images.get(base, base))
    if reference is None:
        if base == DEFAULT_BASE and not options.base:
            problem = reached.problem or f"no image {base} is known at {reached.needed().url}"
            raise InputError(f"the {DOCKERFILE} leaves {BASE} open, and {problem}; give an image with --base")
        return base
    if reached.forge is None or reference.host != reached.host():
        return str(reference)
    tag = local_tag(reference)
    if not engine.has(tag):
        forge = reached.needed()
        print(f"robotkube: base image {reference}", file=sys.stderr)
        with (
            tempfile.TemporaryDirectory(dir=_cache(), prefix="base-") as folder,
            OciRegistry(forge.url, forge.username, forge.password) as registry,
        ):
            archive = Path(folder) / "base.tar"
            fetch_base(registry, reference, _platform(), archive)
            engine.load(archive, tag)
    return tag


def _sources_or_none(options: argparse.Namespace) -> Path:
    """The catalogue's sources, which a build does not need."""
    try:
        return sources_of(options)
    except InputError:
        return REGISTRY


def _platform() -> str:
    machine = platform.machine()
    return f"linux/{ARCHITECTURES.get(machine, machine)}"


def _cache() -> Path:
    """The folder in which archives and the engine's storage stay between builds."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    folder = (Path(base) if base.startswith("/") else Path.home() / ".cache") / "robotkube" / "own-images"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
