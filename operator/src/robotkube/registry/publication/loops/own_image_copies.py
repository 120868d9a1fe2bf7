"""What the gate copied to `own-images` for submissions, and its removal when nothing needs it any more.

A digest is needed while an open submission names it, and as long as an entry on main does, in whatever state: what runs
must be able to start again.
"""

from __future__ import annotations

import logging
from collections.abc import Collection

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.forge.ports.repositories import MainBranch
from robotkube.registry.charts.ports import ChartRegistry
from robotkube.registry.publication.core.submissions import OWN_IMAGES, Submission, own_images

ENTRIES = ("charts",)
Image = tuple[str, str]
"""Name and digest."""

log = logging.getLogger(__name__)


class OwnImageCopies:
    """The copies of submissions that this process has seen; for one thread."""

    def __init__(self, main: MainBranch, oci_registry: ChartRegistry) -> None:
        self._main = main
        self._oci_registry = oci_registry
        self._needed: dict[int, set[Image]] = {}
        self._left: set[Image] = set()

    def note(self, number: int, submission: Submission) -> None:
        """A submission, at whatever head, may have brought its images there."""
        images = {image for chart in submission.charts for image in own_images(chart.images)}
        if images:
            self._needed.setdefault(number, set()).update(images)

    def release(self, number: int) -> None:
        """A submission was decided; `clear` removes what it alone needed."""
        self._left |= self._needed.pop(number, set())

    def keep(self, numbers: Collection[int]) -> None:
        """These submissions are open; the others were closed by somebody."""
        for number in set(self._needed) - set(numbers):
            self.release(number)

    def clear(self) -> None:
        """Remove what nothing needs; what cannot be removed now is tried again in the next call."""
        self._left -= set().union(*self._needed.values())
        if not self._left:
            return
        try:
            entries = self._main.files(self._main.fetch(), ENTRIES).values()
            for image in sorted(self._left):
                if not any(image[1] in entry for entry in entries):
                    self._remove(*image)
                self._left.discard(image)
        except UnavailableError as error:
            log.warning("own images not removed images=%d reason=%s", len(self._left), error)

    def _remove(self, name: str, digest: str) -> None:
        try:
            self._oci_registry.remove_image(f"{OWN_IMAGES}/{name}", digest)
            log.info("own image removed image=%s digest=%s", name, digest)
        except InputError as error:
            log.error("own image not removed image=%s digest=%s reason=%s", name, digest, error)
