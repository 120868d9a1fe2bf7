"""What may run, kept to what the catalogue and the deployment repository say. While forge or OCI registry are away the
last that was read counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robotkube.delivery.inspection.core.permitted import Permitted
from robotkube.delivery.inspection.loops.release_shapes import ReleaseShapes
from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing

LATELY_SECONDS = 60.0  # a withdrawal is a plan, a commit and Argo CD's sync away from the pods


@dataclass(frozen=True)
class InstalledPlatform:
    """Whose namespaces are whose, the digests of the platform's images, and the references of those without one."""

    domain: Domain
    digests: tuple[str, ...]
    references: frozenset[str] = frozenset()


class PermittedReader:
    """The port PermittedSource; `clock` in seconds. Not for several threads."""

    def __init__(
        self,
        catalogue: CatalogueListing,
        releases: ReleaseShapes,
        installation: InstalledPlatform,
        clock: Callable[[], float],
    ) -> None:
        self._catalogue = catalogue
        self._releases = releases
        self._installation = installation
        self._clock = clock
        self._allowed: Allowed | None = None
        self._left: dict[str, float] = {}  # images and charts that left the list, with when

    def refresh(self) -> None:
        """Read what has changed."""
        listing = self._catalogue.read()
        if listing is not None:
            allowed = listing.with_platform(self._installation.digests)
            before = self._allowed or allowed
            gone = {*before.verified, *before.charts} - {*allowed.verified, *allowed.charts}
            self._left.update(dict.fromkeys(gone, self._clock()))
            self._allowed = allowed
        self._releases.refresh()

    def permitted(self) -> Permitted | None:
        """What may run now."""
        releases = self._releases.by_namespace()
        if self._allowed is None or releases is None:
            return None
        now = self._clock()
        self._left = {word: at for word, at in self._left.items() if now - at <= LATELY_SECONDS}
        own = self._installation
        return Permitted(own.domain, self._allowed, releases, own.references, frozenset(self._left))
