"""Coverage of images: a release may run what was verified with its chart's version, and nothing else."""

from __future__ import annotations

from collections.abc import Iterable

from robotkube.registry.catalogue.core.chart_versions import ChartVersion


def is_compared(version: ChartVersion, assurance: str) -> bool:
    """Whether the images of its releases are compared with those of the entry. One that names none, where nothing has
    to be verified, may run any."""
    return bool(version.image_references) or assurance != "none"


def coverage_problems(version: ChartVersion, images: Iterable[str]) -> Iterable[str]:
    """A sentence for each of `images` that was not verified with the version, which the signature over its entry
    covers. What counts is the digest: the same image may come from elsewhere."""
    covered = {_digest(reference) for reference in version.image_references}
    listed = ", ".join(version.image_references) or "none"
    for image in images:
        if _digest(image) not in covered:
            yield (
                f"a pod would run image {image or '(none)'}, which was not verified with chart {version.reference} "
                f"(images: {listed}); leave out the values that name an image, or publish a version with this one"
            )


def _digest(reference: str) -> str:
    """What an image reference pins; the reference itself, which nothing covers, when it pins nothing."""
    return reference.rpartition("@")[2]
