"""A bundle compared with a registry: whether everything is there, under the digests that it has in the bundle."""

from __future__ import annotations

from collections.abc import Sequence

from robotkube.registry.bundles.core.contents import BundleItem
from robotkube.registry.bundles.core.places import RegistryPlace
from robotkube.registry.bundles.ports import PushedTo


def differences(registry: PushedTo, place: RegistryPlace, items: Sequence[BundleItem]) -> list[str]:
    """What is missing or other below a place, each a sentence; empty when nothing is."""
    return [problem for item in items for problem in _of_one(registry, place, item)]


def _of_one(registry: PushedTo, place: RegistryPlace, item: BundleItem) -> list[str]:
    repository = place.repository(item)
    where = f"{place.host}/{repository}"
    if registry.manifest_digest(repository, item.digest) is None:
        return [f"{where}: {item.kind} {item.digest} is not there"]
    problems = []
    tagged = registry.manifest_digest(repository, item.tag)
    if tagged != item.digest:
        problems.append(f"{where}:{item.tag}: is {tagged or 'not there'}, in the bundle {item.digest}")
    attached = (
        {attachment.digest for attachment in registry.attachments(repository, item.digest)} if item.attached else set()
    )
    missing = [one for one in item.attached if one.digest not in attached]
    return [*problems, *(f"{where}@{item.digest}: {one.title} ({one.digest}) is not attached" for one in missing)]
