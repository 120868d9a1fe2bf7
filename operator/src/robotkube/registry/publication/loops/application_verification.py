"""Verification of applications at publication: what a submission brings is tried, what it concerns is tried again, and
what passed is signed.

A statement is about the text of an application as the gate publishes it. So what was changed past the gate is not
signed afterwards: an application that the submission does not bring gets a new statement only when the one it has is
about the same text, or when it has none yet because an older gate published it, while the policy lets it pass.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from robotkube.errors import DocumentError, InputError
from robotkube.registry.catalogue.core.catalogue import (
    RELEASE_POLICY,
    VERIFIED,
    Catalogue,
    read_catalogue,
    read_release_policy,
)
from robotkube.registry.catalogue.loops.verified_catalogue import read_policy
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.application_statements import (
    TrialResult,
    application_statement,
    document_problems,
    statement_path,
)
from robotkube.registry.evidence.ports import Signer, Verifier
from robotkube.registry.publication.ports import ApplicationTrials

OTHERS_MAX = 100  # applications that a submission does not bring and that are tried with it

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TriedApplications:
    """What trying the applications of a submission gave: `problems` of those that it brings, and of those that it
    breaks; `passed` are results by name of those that may be signed; `files` the catalogue they were tried in."""

    problems: tuple[str, ...] = ()
    passed: Mapping[str, TrialResult] = field(default_factory=dict)
    brought: frozenset[str] = frozenset()
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def notes(self) -> Sequence[str]:
        """A sentence for each application that the submission brings and that passed."""
        return [
            f"application {name}: composed for {result.samples} samples of its parameters, "
            f"{result.releases} releases of {', '.join(f'{c.name} {c.version}' for c in result.charts)} rendered and "
            "checked"
            for name, result in sorted(self.passed.items())
            if name in self.brought
        ]


class ApplicationVerification:
    """Trials and statements of applications; `trials` composes and renders, `signer` signs, and `verifier` believes
    what is there already."""

    def __init__(self, trials: ApplicationTrials, signer: Signer, verifier: Verifier) -> None:
        self._trials = trials
        self._signer = signer
        self._verifier = verifier

    def tried(
        self,
        main: Mapping[str, str],
        after: Mapping[str, str],
        submitted: Collection[ChartReference] = (),
        unsigned: bool = False,
    ) -> TriedApplications:
        """Try the applications that differ between the catalogue's files on `main` and those `after` the change, those
        that the chart versions `submitted` may serve, and those whose links a changed one bridges; with `unsigned`
        those without a statement as well. UnavailableError when that cannot be done now."""
        brought = {_name(path) for path, text in after.items() if _is_application(path) and main.get(path) != text}
        others = self._others(read_catalogue(after), brought, set(submitted)) - brought
        if unsigned:
            names = {_name(path) for path in after if _is_application(path)}
            others |= {name for name in names - brought if statement_path(name) not in after}
        if not (brought or others):
            return TriedApplications()
        results = {
            **self._trials(after, brought, submitted),
            **self._trials(after, sorted(others)[:OTHERS_MAX], submitted),
        }
        problems = [
            f"applications/{name}.yaml: {problem}"
            for name in sorted(brought & set(results))
            for problem in results[name].problems
        ]
        problems += self._broken({name for name in others & set(results) if not results[name].passed}, main, results)
        passed = {name: result for name, result in results.items() if result.passed}
        return TriedApplications(tuple(problems), passed, frozenset(brought), after)

    def _others(
        self, catalogue: Catalogue, brought: Collection[str], submitted: Collection[ChartReference]
    ) -> frozenset[str]:
        """The applications that may get one of the submitted chart versions, and those that link by one of these or of
        the `brought` ones."""
        served = {
            application.name
            for application in catalogue.applications.values()
            for service in application.services
            if any(version.reference in submitted for version in catalogue.candidates(service.chart))
        }
        bridges = [catalogue.applications[name].bridges for name in {*served, *brought} & set(catalogue.applications)]
        kinds = {kind for of_one in bridges for kind in of_one}
        linked = {a.name for a in catalogue.applications.values() if any(link.kind in kinds for link in a.links)}
        return frozenset(served | linked)

    def _broken(
        self, failing: Collection[str], main: Mapping[str, str], results: Mapping[str, TrialResult]
    ) -> Sequence[str]:
        """Problems of applications on main that passed before; of trials that were not finished nothing is known."""
        for name in sorted(failing):
            log.warning("application does not pass name=%s reason=%r", name, results[name].problems[0])
        before = self._trials(main, failing, ()) if failing else {}
        return [
            f"applications/{name}.yaml, which is published, would not work any more: {problem}"
            for name in sorted(failing)
            if name in before and before[name].passed
            for problem in results[name].problems
            if results[name].finished
        ]

    def statements(self, tried: TriedApplications) -> dict[str, str]:
        """Signed statements, path -> envelope, of what passed and may be signed: those that differ from what is
        there."""
        policy, _ = read_policy(tried.files)
        if policy is None or tried.problems:
            return {}
        signed: dict[str, str] = {}
        for name, result in sorted(tried.passed.items()):
            if name in tried.brought or self._may_renew(name, tried.files):
                text = tried.files[f"applications/{name}.yaml"]
                statement = application_statement(name, text, policy.digest, result)
                signed[statement_path(name)] = self._signer.sign(statement).decode()
        return {path: envelope for path, envelope in signed.items() if tried.files.get(path) != envelope}

    def _may_renew(self, name: str, files: Mapping[str, str]) -> bool:
        """Return whether an application that nobody brings now may get a statement."""
        envelope = files.get(statement_path(name))
        if envelope is None:
            return _policy_of_applications(files) != VERIFIED
        try:
            known = self._verifier.verify(envelope.encode("utf-8", "surrogatepass"))
        except InputError:
            return False
        return not document_problems(name, files[f"applications/{name}.yaml"], known)


def _is_application(path: str) -> bool:
    return path.startswith("applications/") and path.endswith(".yaml") and path.count("/") == 1


def _name(path: str) -> str:
    return path.removeprefix("applications/").removesuffix(".yaml")


def _policy_of_applications(files: Mapping[str, str]) -> str:
    """What the release policy asks of applications; one that cannot be read opens nothing."""
    try:
        return read_release_policy(files.get(RELEASE_POLICY, ""), RELEASE_POLICY).applications
    except DocumentError:
        return VERIFIED
