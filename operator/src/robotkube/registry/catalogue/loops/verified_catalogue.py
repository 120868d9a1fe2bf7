"""The catalogue with its evidence verified: what manager and gate select from and check against.

The last good catalogue stays while a newer one is broken: a broken file must never look like a withdrawal. A broken
piece of evidence takes the assurance from its own chart version or application and from nothing else.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.forge.ports.repositories import RepositoryFiles
from robotkube.registry.catalogue.core.catalogue import FOLDERS, Catalogue, ChartVersion, read_catalogue
from robotkube.registry.evidence.core.application_statements import (
    ApplicationAssessment,
    assess_application,
    statement_path,
)
from robotkube.registry.evidence.core.statements import Artefact, Assessment, Listing, VerifiedStatement, assess
from robotkube.registry.evidence.core.verification_policy import PATH as POLICY_PATH
from robotkube.registry.evidence.core.verification_policy import SUMMARY, VerificationPolicy, read_verification_policy
from robotkube.registry.evidence.ports import Verifier

PLATFORMS = ("linux/amd64",)
ENVELOPES_CACHED_MAX = 8192
SCHEMAS_CACHED_MAX = 512

_Known = tuple[ChartVersion, str, tuple[str | None, ...]]

log = logging.getLogger(__name__)


class EvidenceReader:
    """Reads a catalogue from files and assesses the evidence of each chart version and of each application.

    `platforms` are those of the fleet: evidence is needed for each. What was verified once is known by its text until
    the trusted keys change. Not for several threads at once."""

    def __init__(self, verifier: Verifier, platforms: Sequence[str] = PLATFORMS) -> None:
        self._verifier = verifier
        self._platforms = tuple(platforms)
        self._verify = lru_cache(ENVELOPES_CACHED_MAX)(self._outcome)
        self._keys: frozenset[str] = frozenset()
        self._assessments: dict[tuple[str, str], tuple[_Known, Assessment]] = {}

    def trusted(self) -> frozenset[str]:
        """The trusted keys now; forgets what was verified when they changed. InputError: a key cannot be read."""
        keys = self._verifier.trusted()
        if keys != self._keys:
            self._verify.cache_clear()
            self._assessments.clear()
            self._keys = keys
        return keys

    def read(self, files: Mapping[str, str]) -> Catalogue:
        """The catalogue in `files` (path -> text, the folders of `FOLDERS`), assessed. A policy that cannot be read is
        one of its problems."""
        self.trusted()
        catalogue = read_catalogue(files)
        policy, problems = read_policy(files)
        assessed = {
            (version.chart, version.version): self._assess(version, policy, files)
            for versions in catalogue.charts.values()
            for version in versions
        }
        self._assessments = assessed
        assessments = {key: assessment for key, (_, assessment) in assessed.items()}
        applications = {name: self._judge(name, policy, files) for name in catalogue.applications}
        judged = catalogue.with_evidence(assessments, applications)
        return replace(judged, problems=(*catalogue.problems, *problems))

    def _judge(self, name: str, policy: VerificationPolicy | None, files: Mapping[str, str]) -> ApplicationAssessment:
        """The assessment of an application's statement."""
        envelope = files.get(statement_path(name))
        if envelope is None:
            return ApplicationAssessment()
        digest = sha256(envelope.encode("utf-8", "surrogatepass"))
        if policy is None:
            return ApplicationAssessment(digest, (f"the catalogue has no {POLICY_PATH} to assess its evidence by",))
        text = files[f"applications/{name}.yaml"]
        return assess_application(name, text, policy.digest, digest, self._verify(envelope))

    def _assess(
        self, version: ChartVersion, policy: VerificationPolicy | None, files: Mapping[str, str]
    ) -> tuple[_Known, Assessment]:
        """The assessment with what it depends on; the one known when that is unchanged."""
        artefacts = [Artefact(version.chart, version.version, version.digest, name) for name in self._platforms]
        names = (*(rule.name for rule in policy.suites), SUMMARY) if policy else ()
        schema = files.get(f"charts/{version.chart}/{version.version}.schema.json")
        folder = artefacts[0].folder
        texts = tuple(files.get(f"{folder}/{name}.json") for name in names)
        known = (version, policy.digest if policy else "", (*texts, schema))
        before = self._assessments.get((version.chart, version.version))
        if before and before[0] == known:
            return before
        if policy is None:
            return known, Assessment(False, "", (f"the catalogue has no {POLICY_PATH} to assess its evidence by",))
        statements = {name: self._verify(text) for name, text in zip(names, texts, strict=True) if text is not None}
        listing = Listing(version.entry, "" if schema is None else sha256(schema.encode("utf-8", "surrogatepass")))
        assessments = [assess(artefact, policy, version.evidence, statements, listing) for artefact in artefacts]
        problems = tuple(dict.fromkeys(problem for assessment in assessments for problem in assessment.problems))
        return known, Assessment(not problems, assessments[0].evidence, problems, assessments[0].findings)

    def _outcome(self, text: str) -> VerifiedStatement | str:
        try:
            return self._verifier.verify(text.encode("utf-8", "surrogatepass"))
        except InputError as error:
            return str(error)


def read_policy(files: Mapping[str, str]) -> tuple[VerificationPolicy | None, Sequence[str]]:
    """The verification policy in `files` (None when there is none or it is broken) and what is wrong with it."""
    text = files.get(POLICY_PATH)
    if text is None:
        return None, ()
    try:
        return read_verification_policy(text, POLICY_PATH), ()
    except DocumentError as error:
        return None, [f"{error.where}: {problem}" for problem in error.problems]


class AssuredCatalogue:
    """The assessed catalogue at its last good commit, and that commit's files (path -> text)."""

    def __init__(self, files: RepositoryFiles, verifier: Verifier, platforms: Sequence[str] = PLATFORMS) -> None:
        self._repository = files
        self._reader = EvidenceReader(verifier, platforms)
        self._seen: tuple[str, frozenset[str]] = ("", frozenset())
        self._reported: frozenset[str] = frozenset()  # problems of the commit that was read last
        self.tip = ""
        self.files: Mapping[str, str] = {}  # path -> text of the last good commit
        self.catalogue = Catalogue()

    def read(self) -> tuple[str, Catalogue]:
        """Read the newest commit under the keys trusted now; the last good commit and its catalogue.

        InputError when there is nothing good yet or a key cannot be read: then nothing may be planned or merged.
        UnavailableError when the forge does not answer."""
        newest = self._repository.fetch()
        if not newest:
            raise InputError("the catalogue repository has no main branch yet; nothing is planned")
        seen = (newest, self._reader.trusted())
        if seen != self._seen:
            self._adopt(newest)
            self._seen = seen
        return self.tip, self.catalogue

    def schema(self, chart: str, version: str) -> Mapping[str, Any] | None:
        """The values schema of a chart version as published; None when the catalogue has none that is a JSON object."""
        text = self.files.get(f"charts/{chart}/{version}.schema.json")
        return None if text is None else _read_schema(text)

    def _adopt(self, newest: str) -> None:
        files = self._repository.files(newest, FOLDERS)
        catalogue = self._reader.read(files)
        for problem in catalogue.problems:
            if problem not in self._reported:
                log.error("catalogue unusable commit=%s problem=%r", newest[:12], problem)
        self._reported = frozenset(catalogue.problems)
        if not catalogue.problems:
            self.tip = newest
            self.files = files
            self.catalogue = catalogue
        elif not self.tip:
            raise InputError(
                f"catalogue {newest[:12]}: {catalogue.problems[0]}; nothing is planned until it is repaired"
            )
        else:  # the commit that stays, under the keys trusted now
            self.catalogue = self._reader.read(self.files)


@lru_cache(SCHEMAS_CACHED_MAX)
def _read_schema(text: str) -> Mapping[str, Any] | None:
    try:
        schema = read_json(text)
    except ValueError:
        return None
    return schema if isinstance(schema, dict) else None
