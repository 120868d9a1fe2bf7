"""Images of planned releases, looked up before a plan is proposed: what would run another image than those that were
verified with its chart is refused here, with its reason on the task. The gate looks again, by its own rendering.

Only releases that a plan changes are rendered, each content once. While that cannot be done nothing is refused: the
gate decides then.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.inputs import Met, Refused
from robotkube.delivery.manager.core.conflicts import DemandOutcome
from robotkube.delivery.manager.core.plans import Change
from robotkube.delivery.tasks.core.task_description import IMAGE_NOT_VERIFIED
from robotkube.errors import InputError, UnavailableError
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.core.chart_versions import coverage_problems, is_compared
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.core.values_schemas import SAMPLE_PLAN
from robotkube.registry.charts.ports import RenderedImages

RELEASES_KEPT_MAX = 4096
INITIAL = "initial/"  # how keys of demands of the initial configuration begin

log = logging.getLogger(__name__)


class VerifiedImages:
    """Lookups of what releases would run; of the last RELEASES_KEPT_MAX contents the answer is kept. `images` renders;
    without it nothing is looked up. Not for several threads at once."""

    def __init__(self, images: RenderedImages | None) -> None:
        self._images = images
        self._known: dict[str, Sequence[str] | str] = {}
        self._logged = ""

    def problems(self, changes: Iterable[Change], catalogue: Catalogue) -> Mapping[str, str]:
        """The key of each changed release that would run something else than was verified, and what that is."""
        if self._images is None:
            return {}
        refused: dict[str, str] = {}
        for release in [change.after for change in changes if change.after]:
            version = catalogue.version(release.chart, release.version)
            if version is None or not is_compared(version, catalogue.assurance):
                continue
            images = self._lookup(release, self._images)
            problems = [images] if isinstance(images, str) else list(coverage_problems(version, images or ()))
            if problems:
                refused[release.key] = "; ".join(problems)
        return refused

    def _lookup(self, release: Release, images: RenderedImages) -> Sequence[str] | str | None:
        """The images of a release, why it cannot be rendered, or None when that cannot be tried now.

        The plan that deploys a release is left out: it is in annotations alone, and another plan may ask for the same
        content."""
        content = json.dumps([release.key, release.chart, release.digest, release.values], sort_keys=True)
        if content in self._known:
            return self._known[content]
        chart = ChartReference(release.chart, release.version, release.digest)
        try:
            answer: Sequence[str] | str
            answer = tuple(images(chart, release.values, SAMPLE_PLAN, release.name, release.namespace))
        except InputError as error:
            answer = str(error)
        except UnavailableError as error:
            if self._logged != str(error):
                log.error("images not looked up, the gate does reason=%r", str(error))
            self._logged = str(error)
            return None
        self._known[content] = answer
        if len(self._known) > RELEASES_KEPT_MAX:
            self._known.pop(next(iter(self._known)))
        return answer


class ImageRefusals:
    """Demands that are refused since releases of theirs would run other images, until what they follow from changes."""

    def __init__(self) -> None:
        self._refused: dict[str, tuple[str, Refused]] = {}

    def standing(self, inputs: Callable[[str], str | None]) -> Mapping[str, Refused]:
        """The refusals that stand, by demand; `inputs` gives what a demand follows from now, None for one that is
        gone."""
        if self._refused:
            self._refused = {key: known for key, known in self._refused.items() if inputs(key) == known[0]}
        return {key: refused for key, (_, refused) in self._refused.items()}

    def add(self, refused: Mapping[str, Refused], inputs: Callable[[str], str | None]) -> None:
        """Refuse these demands from now on."""
        demands: dict[str, list[str]] = {}
        for key, refusal in refused.items():
            demands.setdefault(refusal.message, []).append(key)
            self._refused[key] = (inputs(key) or "", refusal)
        for text, keys in demands.items():
            log.error("demands refused for their images demands=%d first=%s text=%r", len(keys), keys[0], text)


def blamed(
    problems: Mapping[str, str], outcomes: Mapping[str, DemandOutcome], present: Mapping[str, Release]
) -> dict[str, Refused]:
    """The demands to refuse for `problems` (release key -> what it would run): those that newly contribute to such a
    release, or all that do when nobody is new. `present` are main's releases by path."""
    on_main = {release.key: release for release in present.values()}
    refused: dict[str, Refused] = {}
    for release, problem in sorted(problems.items()):
        users = [key for key, outcome in outcomes.items() if isinstance(outcome, Met) and release in outcome.releases]
        new = [key for key in users if not _answers(on_main.get(release), key)]
        for key in new or users:
            refused.setdefault(key, Refused(IMAGE_NOT_VERIFIED, f"release {release}: {problem}"))
    return refused


def _answers(release: Release | None, demand: str) -> bool:
    """Return whether main's release answers the demand already."""
    if release is None:
        return False
    return demand.startswith(INITIAL) or demand in {cause.task for cause in release.causes}
