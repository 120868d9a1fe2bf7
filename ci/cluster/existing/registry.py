"""Comparison of images: those that were built here are in the registry from which a cluster pulls, under the same
digests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from ci.errors import InputError, SetUpError
from ci.images.image_lock import Image
from robotkube.errors import InputError as WrongInput
from robotkube.errors import RobotKubeError
from robotkube.registry.bundles.adapters.accounts import kept_account
from robotkube.registry.bundles.core.places import RegistryPlace, read_place
from robotkube.registry.charts.adapters.oci import OciRegistry


class Manifests(Protocol):
    """A registry that is asked for manifests."""

    def manifest_digest(self, repository: str, reference: str) -> str | None:
        """The digest of what a tag or digest names; None if there is nothing."""


def require(text: str, images: Sequence[Image], authority: Path | None = None) -> None:
    """SetUpError names what the registry at HOST/PATH lacks, and what brings it there; the account is that of `docker
    login`. `authority`: who signed its certificate, where that is none of the usual ones."""
    place = place_of(text)
    try:
        account = kept_account(place.host)
        with OciRegistry(f"https://{place.host}", account.user, account.password, authority=authority) as registry:
            lacking = missing(registry, place, images)
    except RobotKubeError as error:
        raise SetUpError(f"REGISTRY {place}: {error}") from error
    if lacking:
        raise SetUpError(
            f"REGISTRY {place}: has not {', '.join(lacking)}; bring them there: make bundle, then "
            f"robotkube bundle push FILE --to {place}"
        )


def place_of(text: str) -> RegistryPlace:
    """HOST/PATH as a person wrote it; InputError."""
    try:
        return read_place(text, "REGISTRY")
    except WrongInput as error:
        raise InputError(str(error)) from error


def missing(registry: Manifests, place: RegistryPlace, images: Sequence[Image]) -> list[str]:
    """Names of the images that are not there by their digest."""
    return [image.name for image in images if not _is_there(registry, place, image)]


def _is_there(registry: Manifests, place: RegistryPlace, image: Image) -> bool:
    digest = image.reference.partition("@")[2]
    repository = f"{place.path}/{image.repository.rpartition('/')[2]}"
    return registry.manifest_digest(repository, digest) == digest
