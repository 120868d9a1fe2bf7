"""Images that were built here as one bundle, for whoever brings them to the container runtimes of a cluster."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ci.errors import SetUpError
from ci.images.built import REPOSITORY
from ci.images.image_lock import Image
from robotkube import VERSION
from robotkube.errors import RobotKubeError
from robotkube.registry.bundles.adapters.layouts import Bundle, read_bundle
from robotkube.registry.bundles.adapters.making import BundleMaker
from robotkube.registry.images.adapters import bills


@contextmanager
def bundled(images: Sequence[Image], folder: Path) -> Iterator[Bundle]:
    """A bundle that has each of these images whole, in a folder of its own for as long as the block lasts. SetUpError
    says which of them is not as it was built, and what goes wrong inside of the block."""
    archive = folder / "bundle.tar"
    maker = BundleMaker(VERSION, REPOSITORY)
    try:
        for image in images:
            maker.add_image(image.name, image.archive, image.archive.with_name(bills.FILE), image.ground)
        maker.write(archive)
        yield read_bundle(archive)
    except RobotKubeError as error:
        raise SetUpError(str(error)) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)
