"""Builds what changed and writes the lock of images.

Every image has a key of its contents (Dockerfile, files, key of the base image, format of the archives). An archive
whose key is there is not built again. Results appear by renaming a finished folder, so an interrupted run leaves
nothing that looks finished.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ci import console, web
from ci.images import cutting, debian, machine
from ci.images.built import (
    ARCHIVE,
    REPOSITORY,
    BuiltImage,
    is_built,
    read_built,
    read_record,
    write_lock,
    write_record,
)
from ci.images.catalogue import BASE, BY_NAME, IMAGES, ImageRecipe, Sources, go_module
from ci.images.contexts import Copied, assemble, check, key_of
from ci.images.debian import require_programs
from ci.images.services import GROUND, SERVICES, Service, entry_points, modules_of, read_sources, starts
from ci.steps import Steps
from robotkube.registry.images.adapters import bills, normalising
from robotkube.registry.images.adapters.buildah import Buildah, BuildError

KEPT_VERSIONS = 3
NAMES = (*BY_NAME, *(service.name for service in SERVICES))
UMASK = 0o022


@dataclass(frozen=True)
class Workshop:
    """One run's folders and settings below the cache folder `folder`."""

    folder: Path
    sources: Sources
    fresh: bool

    @property
    def lock(self) -> Path:
        return self.folder / "images.json"


def cache_folder() -> Path:
    """The user's cache folder for images."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robotkube" / "images"


def sources(toolchain_bin: Path) -> Sources:
    """The places where this machine has what images are made of."""
    return Sources(toolchain_bin, go_module, console.build, web.built())


def build_images(
    toolchain_bin: Path,
    folder: Path | None = None,
    names: Sequence[str] = (),
    *,
    fresh: bool = False,
    steps: Steps | None = None,
) -> dict[str, BuiltImage]:
    """Build the images `names` (default all) and the base they stand on; returns them by name and writes images.json.

    `toolchain_bin` holds the programs gitea, argocd, helm and ferretdb. `fresh` builds again without any cache. One
    run at a time per cache folder; a second one waits. Raises BuildError or ContextError.
    """
    chosen, cut = _choose(names)
    shop = Workshop(folder or cache_folder(), sources(toolchain_bin), fresh)
    shop.folder.mkdir(parents=True, exist_ok=True)
    contents = {image.name: image.contents(shop.sources) for image in chosen}
    for name, copied in contents.items():
        check(name, copied)
    with _alone(shop.folder), _umask():
        steps = steps or Steps(len(chosen) + len(cut))
        built = _build_all(shop, chosen, contents, steps)
        built |= cut_services(shop, cut, built, steps) if cut else {}
        write_lock(shop.lock, built, NAMES)
    return built


def _choose(names: Sequence[str]) -> tuple[tuple[ImageRecipe, ...], tuple[Service, ...]]:
    """The images to build, and those to cut from one of them; all without names."""
    unknown = sorted(set(names) - set(NAMES))
    if unknown:
        raise BuildError(f"no such image: {', '.join(unknown)}; there are {', '.join(NAMES)}")
    cut = tuple(service for service in SERVICES if not names or service.name in names)
    wanted = {image.name for image in IMAGES if not names or image.name in names} | ({GROUND} if cut else set())
    for image in reversed(IMAGES):
        if image.name in wanted and image.stands_on:
            wanted.add(image.stands_on)
    return tuple(image for image in IMAGES if image.name in wanted), cut


def key_of_image(image: ImageRecipe, contents: tuple[Copied, ...], keys: Mapping[str, str]) -> str:
    """The key of what the image is made of, the image it stands on included, whose key is in `keys`."""
    ground = debian.key() if image is BASE else keys[image.stands_on] if image.stands_on else ""
    return key_of(contents, normalising.FORMAT, ground, image.dockerfile.read_text(encoding="utf-8"))


def _build_all(
    shop: Workshop, images: Sequence[ImageRecipe], contents: dict[str, tuple[Copied, ...]], steps: Steps
) -> dict[str, BuiltImage]:
    keys = {BASE.name: key_of_image(BASE, BASE.contents(shop.sources), {})}
    for image in images:
        keys[image.name] = key_of_image(image, contents[image.name], keys)
    base_key = keys[BASE.name]
    buildah = Buildah(shop.folder / ".buildah" / base_key, shop.folder / "build.log")
    bench = Bench(shop, buildah, shop.folder / ".work", keys)
    _clear(bench.work)
    places: dict[str, Path] = {}
    try:
        for image in images:
            with steps.step(f"image {image.name}") as step:
                place, cached = _provide(bench, image, contents[image.name])
                places[image.name] = place
                bills.ensure_bill(place / ARCHIVE, image.name, read_record(place)["digest"])
                step.note = "cached" if cached else ""
    finally:
        if bench.work.exists():
            buildah.clean()
        _clear(bench.work)
    _forget_old(shop, places, base_key)
    return {name: read_built(name, place) for name, place in places.items()}


@dataclass(frozen=True)
class Bench:
    """What one run works with: the builder, a folder that is gone afterwards, the images' keys."""

    shop: Workshop
    buildah: Buildah
    work: Path
    keys: Mapping[str, str]

    def tag(self, name: str) -> str:
        """The finished image in the builder's storage."""
        return f"localhost/robotkube/{name}:{self.keys[name]}"

    def place(self, name: str) -> Path:
        """The folder of the image's archive, whether it is there or not."""
        return self.shop.folder / f"{name}-{self.keys[name]}"


def cut_services(
    shop: Workshop, cut: Sequence[Service], built: Mapping[str, BuiltImage], steps: Steps
) -> dict[str, BuiltImage]:
    """The images of services, cut from the one that `built` has."""
    ground = cutting.read_ground(built[GROUND].archive)
    files = read_sources()
    commands = entry_points()
    places: dict[str, Path] = {}
    for service in cut:
        with steps.step(f"image {service.name}") as step:
            paths = modules_of(service, files, commands)
            started = starts(service, commands)
            key = cutting.key_of_cut(service, ground, started, {path: files[path] for path in paths})
            place = places[service.name] = shop.folder / f"{service.name}-{key}"
            step.note = "cached" if is_built(place) and not shop.fresh else ""
            if not step.note:
                _cut(shop, service, ground, started, paths, place)
            bills.ensure_bill(place / ARCHIVE, service.name, read_record(place)["digest"], ground.archive)
    _keep_newest(shop, places)
    return {name: read_built(name, place, ground.archive) for name, place in places.items()}


def _cut(
    shop: Workshop,
    service: Service,
    ground: cutting.Ground,
    started: Sequence[tuple[str, str]],
    paths: frozenset[str],
    place: Path,
) -> None:
    result = shop.folder / ".cut"
    _clear(result)
    result.mkdir()
    name = f"{REPOSITORY}/{service.name}"
    write_record(result, cutting.write_cut(service, ground, started, paths, result / ARCHIVE, name))
    _clear(place)
    result.rename(place)


def _provide(bench: Bench, image: ImageRecipe, contents: tuple[Copied, ...]) -> tuple[Path, bool]:
    """The folder of the image's archive, and whether it was there already."""
    place = bench.place(image.name)
    if is_built(place) and not bench.shop.fresh:
        return place, True
    if not bench.work.exists():
        require_programs(bench.shop.folder)
        bench.buildah.log.unlink(missing_ok=True)
        bench.buildah.clean()
        bench.work.mkdir()
    context, result = bench.work / "context", bench.work / "result"
    for folder in (context, result):
        _clear(folder)
    assemble(contents, context)
    if key_of_image(image, contents, bench.keys) != bench.keys[image.name]:
        raise BuildError(f"image {image.name}: its files changed while they were copied; run again")
    _build(bench, image, f"{bench.tag(image.name)}-raw", context, result)
    _clear(place)
    result.rename(place)
    return place, False


def _build(bench: Bench, image: ImageRecipe, tag: str, context: Path, result: Path) -> None:
    """Build in `context`; `result` gets the archive and a record of it."""
    sources = machine.debian_sources()
    lent = machine.lend(bench.work / "lent", *machine.current_environment(), sources)
    arguments = _provide_base(bench, image, sources)
    exported = bench.work / "exported"
    _clear(exported)
    bench.buildah.build(context, image.dockerfile, tag, arguments, lent.volumes, bench.shop.fresh)
    bench.buildah.export(tag, exported)
    result.mkdir()
    treatment = hashlib.sha256("\n".join([normalising.FORMAT, *sorted(lent.placeholders)]).encode()).hexdigest()
    known = {} if bench.shop.fresh else _known_layers(bench, image, treatment)
    normal = normalising.normalise_image(
        exported, result / ARCHIVE, f"{REPOSITORY}/{image.name}", lent.placeholders, known
    )
    write_record(result, normal, treatment=treatment, origins=dict(normal.origins))


def _known_layers(bench: Bench, image: ImageRecipe, treatment: str) -> dict[str, normalising.KnownLayer]:
    """Layers that archives of what it stands on and of earlier versions of this image hold, by the builder's digests of
    them."""
    known: dict[str, normalising.KnownLayer] = {}
    folders = [*bench.shop.folder.glob(f"{image.name}-*"), bench.place(image.stands_on or BASE.name)]
    for folder in folders:
        record = read_record(folder) if is_built(folder) else {}
        if record.get("treatment") != treatment:
            continue
        normal_forms = {digest: digest for digest in record["layers"]}  # a normal form is its own normal form
        for origin, digest in (record["origins"] | normal_forms).items():
            blob = normalising.Blob(digest, record["layers"][digest])
            known[origin] = normalising.KnownLayer(folder / ARCHIVE, blob)
    return known


def _provide_base(bench: Bench, image: ImageRecipe, sources: Path | None) -> dict[str, str]:
    """Make sure that what the Dockerfile stands on is in the storage; returns its build arguments.

    Images stand on others in their normal form, so that they share its layers byte by byte.
    """
    if image is BASE:
        if bench.shop.fresh or not bench.buildah.has(debian.TAG):
            bench.buildah.storage.mkdir(parents=True, exist_ok=True)
            debian.make(bench.buildah, sources)
        return {"DEBIAN": debian.TAG}
    if not image.stands_on:
        return {}
    ground = bench.tag(image.stands_on)
    if not bench.buildah.has(ground):
        bench.buildah.load(bench.place(image.stands_on) / ARCHIVE, ground)
    return {"BASE": ground}


@contextmanager
def _umask() -> Iterator[None]:
    """Modes of new files and folders end up in images: they must not depend on who builds."""
    before = os.umask(UMASK)
    try:
        yield
    finally:
        os.umask(before)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    with (folder / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _clear(folder: Path) -> None:
    if folder.exists():
        shutil.rmtree(folder)


def _forget_old(shop: Workshop, places: dict[str, Path], base_key: str) -> None:
    """Keep the newest versions of each image and the builder's storage of the present base only."""
    _keep_newest(shop, places)
    for storage in (shop.folder / ".buildah").glob("*"):
        if storage.name != base_key:
            Buildah(storage, shop.folder / "build.log").clean()
            _clear(storage)


def _keep_newest(shop: Workshop, places: Mapping[str, Path]) -> None:
    for name, present in places.items():
        others = [p for p in shop.folder.glob(f"{name}-*") if len(p.name) == len(present.name) and p != present]
        for place in sorted(others, key=lambda p: p.stat().st_mtime, reverse=True)[KEPT_VERSIONS - 1 :]:
            _clear(place)
