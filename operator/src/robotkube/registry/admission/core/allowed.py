"""The list of what may run: images and charts by digest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import CHART_NAME, DIGEST, IMAGE_BY_DIGEST

LISTED_MAX = 20_000  # of each kind: a list that is longer was not made by people


@dataclass(frozen=True)
class Allowed:
    """Digests (`sha256:<hex>`) of the images that releases may run (`verified`) and of those of the platform, and the
    charts that releases may be of, each as `<name>@<digest>`. All sorted, so that equal lists make equal policies."""

    verified: tuple[str, ...] = ()
    platform: tuple[str, ...] = ()
    charts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """InputError names what is no digest: policies are made of these words, so nothing else may stand in them."""
        for name in ("verified", "platform", "charts"):
            words = getattr(self, name)
            if len(words) > LISTED_MAX:
                raise InputError(f"allowed {name}: {len(words)} entries; at most {LISTED_MAX}")
            object.__setattr__(self, name, tuple(sorted(set(words))))
        for digest in (*self.verified, *self.platform):
            if not DIGEST.fullmatch(digest):
                raise InputError(f"allowed images: {digest[:120]!r} is no digest; write sha256:<64 hex digits>")
        for chart in self.charts:
            name, _, digest = chart.partition("@")
            if not (CHART_NAME.fullmatch(name) and DIGEST.fullmatch(digest)):
                raise InputError(f"allowed charts: {chart[:120]!r} must be <name>@sha256:<64 hex digits>")


def digests_of(references: Iterable[str]) -> tuple[str, ...]:
    """The digests in image references; InputError names one without: a tag can move between check and use."""
    digests = []
    for reference in references:
        if not IMAGE_BY_DIGEST.fullmatch(reference):
            raise InputError(f"image {reference[:200]!r} names no digest; write <repository>@sha256:<digest>")
        digests.append(reference.partition("@")[2])
    return tuple(digests)
