"""Images that pods run, read from rendered objects of whatever kind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

CONTAINERS = ("containers", "initContainers", "ephemeralContainers")
DEPTH_MAX = 64


def pod_images(objects: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """Image references in `objects`, sorted: of containers of every kind, wherever a pod or a template of one stands,
    and of volumes that are images. Deeper than DEPTH_MAX nothing is read: Kubernetes has no pods there."""
    return tuple(sorted({image for item in objects for image in _images(item, 0)}))


def _images(value: Any, depth: int) -> Iterator[str]:
    if depth > DEPTH_MAX:
        return
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _own_images(key, inner)
            yield from _images(inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            yield from _images(inner, depth + 1)


def _own_images(key: Any, value: Any) -> Iterator[str]:
    """References that stand in a list of containers, or in a volume that is an image."""
    if key in CONTAINERS and isinstance(value, list):
        yield from (str(item.get("image", "")) for item in value if isinstance(item, Mapping))
    elif key == "volumes" and isinstance(value, list):
        volumes = (item.get("image") for item in value if isinstance(item, Mapping))
        yield from (str(image.get("reference", "")) for image in volumes if isinstance(image, Mapping))
