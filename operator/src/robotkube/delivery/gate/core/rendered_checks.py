"""Checks of what a release renders to, when an application is tried: by the words of the static suite."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.registry.catalogue.core.catalogue import Catalogue, ChartVersion
from robotkube.registry.catalogue.core.chart_versions import coverage_problems, is_compared
from robotkube.registry.charts.core.pod_images import pod_images
from robotkube.registry.evidence.core.verification_policy import VerificationPolicy
from robotkube.registry.suites.core.static_checks import Rendering, foreign_kinds, object_checks

STATIC = "static"
IMAGES, KINDS = "images", "kinds"
SAFETY = ("names", "hooks")  # asked of every release: an object in another namespace, one that runs before
POD_SECURITY = "pod-security/"
BY_COVERAGE = "images-by-digest"  # what is covered is named by its digest

Problem = tuple[str, str]
"""The rule, and the sentence with its fix."""


def rendered_problems(
    release: Release,
    version: ChartVersion,
    objects: Sequence[Mapping[str, Any]],
    catalogue: Catalogue,
    policy: VerificationPolicy,
) -> Iterator[Problem]:
    """Problems of a release's objects: images that the version's evidence does not cover, other namespaces, kinds and
    hooks, Pod Security; and whatever else the static suite asks of objects, when `policy` asks for that suite."""
    if is_compared(version, catalogue.assurance):
        yield from ((IMAGES, problem) for problem in coverage_problems(version, pod_images(objects)))
    agent = str(release.values["placement"]["agent"])
    rendering = Rendering("the sample", release.chart, release.name, agent, objects)
    whole = policy.rule(STATIC) is not None
    if not whole:
        fix = "leave it out of the chart's templates"
        yield from ((KINDS, f"{problem}; {fix}") for problem in foreign_kinds(rendering))
    for check in object_checks([rendering]):
        asked = whole or check.name in SAFETY or check.name.startswith(POD_SECURITY)
        if asked and not check.passed and check.name != BY_COVERAGE:
            yield check.name, f"{check.found}; {check.fix}"
