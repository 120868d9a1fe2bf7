"""The images that the platform's charts name."""

from __future__ import annotations

from ci.images.services import GROUND, SERVICE_NAMES

NAMES = (*sorted(SERVICE_NAMES), GROUND)
"""As in the annotation `robotkube.io/images` of charts; the last one is that of the earlier versions."""


def all_as(reference: str) -> dict[str, str]:
    """Every image as `reference`."""
    return dict.fromkeys(NAMES, reference)
