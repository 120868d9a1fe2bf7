"""Reconciling policies with the catalogue: the list of what may run becomes policies whenever main, keys or namespaces
change.

Whatever cannot be read leaves the policies as they are: a forge that is away, a key that cannot be read and a broken
file never look like a withdrawal.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.list_objects import documents_for_api
from robotkube.registry.admission.core.listing import VERIFIED, AllowedVersions, listing
from robotkube.registry.admission.core.policies import for_files
from robotkube.registry.admission.ports import CatalogueHistory, ListingMemory, PolicyPlace
from robotkube.registry.catalogue.core.chart_versions import ChartVersion, read_chart_version
from robotkube.registry.evidence.core.statements import VerifiedStatement
from robotkube.registry.evidence.ports import Verifier

FOLDERS = ("charts", "evidence")
HISTORY_COMMITS_MAX = 5000
ENVELOPES_CACHED_MAX = 8192

log = logging.getLogger(__name__)

Key = tuple[str, str]
"""Chart and version."""


class CatalogueListing:
    """The list of a catalogue's main, with the digests that its versions had before. Not for several threads."""

    def __init__(self, repository: CatalogueHistory, verifier: Verifier) -> None:
        self._repository = repository
        self._verifier = verifier
        self._verify = lru_cache(ENVELOPES_CACHED_MAX)(self._outcome)
        self.tip = ""  # of main as it was seen last
        self._seen = ""  # the commit until which history was read
        self._earlier: dict[tuple[str, ...], ChartVersion] = {}  # by all that is signed of an entry
        self._summaries: dict[str, str] = {}  # by the digest of the envelope
        self._key: tuple[str, frozenset[str]] = ("", frozenset())

    def read(self) -> AllowedVersions | None:
        """The list at main's tip under the keys trusted now; None when both are as they were, or there is no main yet.

        UnavailableError when the forge does not answer, InputError when a key cannot be read."""
        tip = self._repository.fetch()
        self.tip = tip
        keys = self._verifier.trusted()
        if not tip or (tip, keys) == self._key:
            return None
        if keys != self._key[1]:
            self._verify.cache_clear()
        self._read_history(tip)
        files = self._repository.files(tip, FOLDERS)
        current = _entries(files)
        self._summaries.update(_summaries(files))
        versions = [*filter(None, current.values()), *self._earlier.values()]
        named = {version.evidence for version in versions} & set(self._summaries)
        statements = {digest: self._verify(self._summaries[digest]) for digest in named}
        result = replace(listing(current, self._earlier.values(), statements), commit=tip)
        self._key = (tip, keys)
        return result

    def _outcome(self, text: str) -> VerifiedStatement | str:
        try:
            return self._verifier.verify(text.encode("utf-8", "surrogatepass"))
        except InputError as error:
            return str(error)

    def _read_history(self, tip: str) -> None:
        """Entries and summaries of the commits since the last time."""
        for commit, _ in self._repository.headers(self._seen, HISTORY_COMMITS_MAX):
            try:
                changes = self._repository.commit(commit).changes
            except DocumentError as error:
                log.warning("catalogue history unreadable commit=%s problem=%r", commit[:12], str(error))
                continue
            files = {path: text for path, text in changes.items() if text is not None}
            self._summaries.update(_summaries(files))
            for version in filter(None, _entries(files).values()):
                if version.state == VERIFIED:
                    signed = (version.chart, version.version, version.digest, version.entry, version.evidence)
                    self._earlier[signed] = version
        self._seen = tip


def _summaries(files: Mapping[str, str]) -> dict[str, str]:
    """Summaries in files, by the digests of their envelopes."""
    return {
        sha256(text.encode("utf-8", "surrogatepass")): text
        for path, text in files.items()
        if path.startswith("evidence/") and path.endswith("/summary.json")
    }


def _entries(files: Mapping[str, str]) -> dict[Key, ChartVersion | None]:
    """Chart and version -> the entry; None for one that cannot be read."""
    entries: dict[Key, ChartVersion | None] = {}
    for path, text in files.items():
        parts = path.removesuffix(".yaml").split("/")
        if not path.endswith(".yaml") or parts[0] != "charts" or len(parts) != 3:
            continue
        try:
            entries[parts[1], parts[2]] = read_chart_version(text, path)
        except DocumentError as error:
            log.warning("catalogue entry unusable path=%s problem=%r", path, str(error))
            entries[parts[1], parts[2]] = None
    return entries


@dataclass(frozen=True)
class Surroundings:
    """What the list does not say: whose namespaces are whose, and the digests of the platform's images."""

    domain: Domain
    platform: tuple[str, ...]


Form = Callable[[Surroundings, AllowedVersions], Sequence[Mapping[str, Any]]]
"""What a place gets written for surroundings and a list."""


def form_of_files(around: Surroundings, allowed: AllowedVersions) -> Sequence[Mapping[str, Any]]:
    """Policies with the list in them."""
    return for_files(around.domain, allowed.with_platform(around.platform))


def form_of_objects(around: Surroundings, allowed: AllowedVersions) -> Sequence[Mapping[str, Any]]:
    """Policies, and beside them the list; the platform's images are listed by who installs it."""
    return documents_for_api(around.domain, allowed)


class PolicyReconciler:
    """The policies of a place, kept to what a catalogue lists. `surroundings` are asked each time: agents join, and
    images come. Until the catalogue has been read, the list is that of `memory`: in a new cluster the platform's images
    are all that may run."""

    def __init__(
        self,
        catalogue: CatalogueListing,
        place: PolicyPlace,
        surroundings: Callable[[], Surroundings],
        memory: ListingMemory,
        form: Form = form_of_files,
    ) -> None:
        self._catalogue = catalogue
        self._place = place
        self._surroundings = surroundings
        self._memory = memory
        self._form = form
        self._listing: AllowedVersions | None = None
        self._written: tuple[Surroundings, AllowedVersions] | None = None

    @property
    def tip(self) -> str:
        """Main's tip as it was seen last; empty before that."""
        return self._catalogue.tip

    @property
    def written(self) -> AllowedVersions | None:
        """The list that was written last; None when this process has written none yet."""
        return self._written[1] if self._written else None

    def step(self) -> bool:
        """One look at surroundings and catalogue; whether the policies changed.

        Raises what `CatalogueListing.read` does, and InputError for what makes no policies; then they stay."""
        if self._listing is None:
            self._listing = self._memory.load()
        changed = self._write(self._listing)
        listed = self._catalogue.read()
        if listed is None:
            return changed
        for problem in listed.problems:
            log.warning("admission: %s", problem)
        self._listing = listed
        changed = self._write(listed) or changed
        self._memory.save(listed)
        return changed

    def _write(self, listed: AllowedVersions) -> bool:
        around = self._surroundings()
        if (around, listed) == self._written and self._place.intact():
            return False
        changed = self._place.write(self._form(around, listed))
        self._written = (around, listed)
        if changed:
            counts = (len(listed.charts), len(listed.verified), len(around.platform))
            log.info("admission policies written charts=%d images=%d platform_images=%d", *counts)
        return changed
