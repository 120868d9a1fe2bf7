"""Builds what changed and writes the lock of images.

Every image has a key of its contents (Dockerfile, files, key of the base image, the code that normalises). An archive
whose key is there is not built again. Results appear by renaming a finished folder, so an interrupted run leaves
nothing that looks finished.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ci.images import debian, machine, normalising
from ci.images.buildah import Buildah, BuildError, require_programs
from ci.images.catalogue import BASE, BY_NAME, IMAGES, Image, Sources, go_module
from ci.images.contexts import Copied, assemble, check, key_of
from ci.steps import Steps

REPOSITORY = "forge.robotkube.svc.cluster.local:3000/robotkube"
KEPT_VERSIONS = 3
FORMAT = "1"


@dataclass(frozen=True)
class BuiltImage:
    """An image archive on this machine: `reference` is repository@digest, `size` the bytes of its layers."""

    name: str
    reference: str
    archive: Path
    size: int
    layers: dict[str, int]

    @property
    def digest(self) -> str:
        return self.reference.rpartition("@")[2]


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
    chosen = _choose(names)
    shop = Workshop(folder or cache_folder(), Sources(toolchain_bin, go_module), fresh)
    shop.folder.mkdir(parents=True, exist_ok=True)
    contents = {image.name: image.contents(shop.sources) for image in chosen}
    for name, copied in contents.items():
        check(name, copied)
    with _alone(shop.folder):
        built = _build_all(shop, chosen, contents, steps or Steps(len(chosen)))
        _write_lock(shop, built)
    return built


def _choose(names: Sequence[str]) -> tuple[Image, ...]:
    unknown = sorted(set(names) - BY_NAME.keys())
    if unknown:
        raise BuildError(f"no such image: {', '.join(unknown)}; there are {', '.join(BY_NAME)}")
    wanted = {image.name for image in IMAGES if not names or image.name in names}
    if any(BY_NAME[name].on_base for name in wanted):
        wanted.add(BASE.name)
    return tuple(image for image in IMAGES if image.name in wanted)


def keys_of(images: Sequence[Image], contents: dict[str, tuple[Copied, ...]]) -> dict[str, str]:
    """The key of each image; those on the base carry the base's key in theirs."""
    code = Path(normalising.__file__).read_text(encoding="utf-8")
    base_contents = contents.get(BASE.name) or BASE.contents(Sources(Path(), go_module))
    base = key_of(base_contents, FORMAT, code, debian.key(), BASE.dockerfile.read_text(encoding="utf-8"))
    keys = {BASE.name: base}
    for image in images:
        if image is not BASE:
            text = image.dockerfile.read_text(encoding="utf-8")
            keys[image.name] = key_of(contents[image.name], FORMAT, code, base if image.on_base else "", text)
    return keys


def _build_all(
    shop: Workshop, images: Sequence[Image], contents: dict[str, tuple[Copied, ...]], steps: Steps
) -> dict[str, BuiltImage]:
    keys = keys_of(images, contents)
    buildah = Buildah(shop.folder / ".buildah" / keys[BASE.name], shop.folder / "build.log")
    work = shop.folder / ".work"
    _clear(work)
    built: dict[str, BuiltImage] = {}
    try:
        for image in images:
            with steps.step(f"image {image.name}") as step:
                place = shop.folder / f"{image.name}-{keys[image.name]}"
                if (place / "image.json").is_file() and not shop.fresh:
                    step.note = "cached"
                else:
                    _build(shop, image, contents[image.name], keys, buildah, work)
                built[image.name] = _read(image.name, place)
    finally:
        buildah.clean()
        _clear(work)
    _forget_old(shop, keys)
    return built


def _build(
    shop: Workshop, image: Image, contents: tuple[Copied, ...], keys: dict[str, str], buildah: Buildah, work: Path
) -> None:
    require_programs()
    sources = machine.debian_sources()
    lent = machine.lend(work / "lent", *machine.current_environment(), sources)
    base_tag = f"localhost/robotkube/base:{keys[BASE.name]}"
    tag = f"localhost/robotkube/{image.name}:{keys[image.name]}"
    arguments = _provide_base(shop, image, keys, buildah, base_tag, sources)
    context, layout, result = work / "context", work / "layout", work / "result"
    for folder in (context, layout, result):
        _clear(folder)
    assemble(contents, context)
    raw_tag = f"{tag}-raw"
    buildah.build(context, image.dockerfile, raw_tag, arguments, lent.volumes, shop.fresh)
    buildah.export(raw_tag, layout)
    result.mkdir(parents=True)
    normal = normalising.normalise_image(layout, result / "image.tar", f"{REPOSITORY}/{image.name}", lent.placeholders)
    record = {
        "digest": normal.digest,
        "size": normal.size,
        "layers": {layer.digest: layer.size for layer in normal.layers},
    }
    (result / "image.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    _replace(result, shop.folder / f"{image.name}-{keys[image.name]}")


def _provide_base(
    shop: Workshop, image: Image, keys: dict[str, str], buildah: Buildah, base_tag: str, sources: Path | None
) -> dict[str, str]:
    """Make sure that what the Dockerfile stands on is in the storage; returns its build arguments.

    Images stand on the base in its normal form, so that they share its layer byte by byte.
    """
    if image is BASE:
        if shop.fresh or not buildah.has(debian.TAG):
            buildah.storage.mkdir(parents=True, exist_ok=True)
            debian.make(buildah, sources)
        return {"DEBIAN": debian.TAG}
    if not image.on_base:
        return {}
    if shop.fresh or not buildah.has(base_tag):
        buildah.load(shop.folder / f"{BASE.name}-{keys[BASE.name]}" / "image.tar", base_tag)
    return {"BASE": base_tag}


def _read(name: str, place: Path) -> BuiltImage:
    record = json.loads((place / "image.json").read_bytes())
    return BuiltImage(
        name, f"{REPOSITORY}/{name}@{record['digest']}", place / "image.tar", record["size"], record["layers"]
    )


def _write_lock(shop: Workshop, built: dict[str, BuiltImage]) -> None:
    """images.json names every image that is built, also those of earlier runs that this one did not touch."""
    known = json.loads(shop.lock.read_bytes()) if shop.lock.is_file() else {}
    kept = {name: entry for name, entry in known.items() if name in BY_NAME and Path(entry["archive"]).is_file()}
    new = {name: {"reference": i.reference, "archive": str(i.archive), "size": i.size} for name, i in built.items()}
    part = shop.lock.with_suffix(".part")
    part.write_text(json.dumps(kept | new, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    part.replace(shop.lock)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    with (folder / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _replace(made: Path, place: Path) -> None:
    _clear(place)
    made.rename(place)


def _clear(folder: Path) -> None:
    if folder.exists():
        shutil.rmtree(folder)


def _forget_old(shop: Workshop, keys: dict[str, str]) -> None:
    """Keep the newest versions of each image and the builder's storage of the present base only."""
    for name, key in keys.items():
        places = [
            p for p in shop.folder.glob(f"{name}-*") if len(p.name) == len(name) + 17 and p.name != f"{name}-{key}"
        ]
        for place in sorted(places, key=lambda p: p.stat().st_mtime, reverse=True)[KEPT_VERSIONS - 1 :]:
            _clear(place)
    for storage in (shop.folder / ".buildah").glob("*"):
        if storage.name != keys[BASE.name]:
            Buildah(storage, shop.folder / "build.log").clean()
            _clear(storage)
