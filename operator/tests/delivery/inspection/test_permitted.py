"""What may run, as it is read from catalogue and deployment: renderings, what main had before, and times of grace."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import Release, write_release
from robotkube.delivery.inspection.core.permitted import Permitted, ReleaseShape
from robotkube.delivery.inspection.core.pod_checks import strangers_on
from robotkube.delivery.inspection.core.workload_checks import strangers_among
from robotkube.delivery.inspection.loops.permitted import LATELY_SECONDS, InstalledPlatform, PermittedReader
from robotkube.delivery.inspection.loops.release_shapes import REMOVED_SECONDS, SETTINGS_SECONDS, ReleaseShapes
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.forge.ports.repositories import Commit
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.charts.core.references import ChartReference
from tests.stages.attacks import shown
from tests.stages.delivery.inspection.inspected_node import (
    CHART,
    DOMAIN,
    FOREIGN_IMAGE,
    NOW,
    RENDERED,
    VERIFIED,
    pod_object,
    pods,
)
from tests.stages.delivery.inspection.inspections_in_memory import Clock

DIGEST = CHART.partition("@")[2]
FIRST, SECOND, THIRD, FOURTH = (f"20260301-12000{number}-aaaaaa" for number in range(1, 5))
LISTING = AllowedVersions((CHART,), (VERIFIED,))


def release(plan: str = FIRST, name: str = "detector", **values: Any) -> Release:
    return Release("vehicle-00", name, "detector", "1.0.0", DIGEST, values, plan=plan)


class History:
    """The port DeploymentHistory, in memory: main as a list of changes."""

    def __init__(self, *releases: Release) -> None:
        self.changes: list[dict[str, str | None]] = []
        self.away = False
        self.put(*releases)

    def put(self, *releases: Release, gone: Sequence[str] = ()) -> None:
        self.changes.append({one.path: write_release(one) for one in releases} | dict.fromkeys(gone))

    def fetch(self) -> str:
        if self.away:
            raise UnavailableError("the forge does not answer")
        return f"c{len(self.changes)}"

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        files: dict[str, str | None] = {}
        for change in self.changes[: int(commit[1:])]:
            files |= change
        return {path: text for path, text in files.items() if text is not None}

    def headers(self, since: str, commits_max: int) -> Iterator[tuple[str, str]]:
        yield from ((f"c{number}", "") for number in range(len(self.changes), 0, -1))

    def irregular(self, commit: str, folders: Sequence[str]) -> Sequence[str]:
        return ()

    def commit(self, commit: str) -> Commit:
        return Commit(commit, (), "", "", self.changes[int(commit[1:]) - 1])


class Charts:
    """The port RenderedObjects: a Deployment that says with what it was rendered. `problem` is raised."""

    def __init__(self) -> None:
        self.rendered: list[tuple[str, Mapping[str, Any]]] = []
        self.problem: Exception | None = None

    def __call__(
        self, chart: ChartReference, values: Mapping[str, Any], plan: str, release: str, namespace: str
    ) -> Sequence[Mapping[str, Any]]:
        if self.problem is not None:
            raise self.problem
        self.rendered.append((plan, values))
        deployment = {"kind": "Deployment", "metadata": {"name": release}, "spec": {**RENDERED["spec"], "plan": plan}}
        return [deployment, {"kind": "ConfigMap", "metadata": {"name": release}, "data": dict(values)}]


class Listing:
    """A catalogue's list: read once for each time that it is set."""

    def __init__(self) -> None:
        self.now: AllowedVersions | None = LISTING
        self.away = False

    def read(self) -> AllowedVersions | None:
        if self.away:
            raise UnavailableError("the forge does not answer")
        now, self.now = self.now, None
        return now


class Stage:
    def __init__(self, *releases: Release) -> None:
        self.clock = Clock()
        self.history = History(*releases)
        self.charts = Charts()
        self.listing = Listing()
        self.start()

    def start(self) -> None:
        shapes = ReleaseShapes(self.history, self.charts, self.clock)
        catalogue: Any = self.listing
        self.reader = PermittedReader(catalogue, shapes, InstalledPlatform(DOMAIN, ()), self.clock)

    def read(self) -> Permitted:
        self.reader.refresh()
        permitted = self.reader.permitted()
        assert permitted is not None
        return permitted

    def shape(self) -> ReleaseShape | None:
        return self.read().release("vehicle-00", "detector")


@pytest.fixture
def stage() -> Stage:
    return Stage(release())


def _plans(shape: ReleaseShape | None) -> list[str]:
    assert shape is not None
    return [version["spec"]["plan"] for version in shape.versions("detector")]


def test_before_both_were_read_nothing_is_known(stage: Stage) -> None:
    assert stage.reader.permitted() is None
    stage.listing.away = True
    with pytest.raises(UnavailableError):
        stage.reader.refresh()
    assert stage.reader.permitted() is None


def test_a_release_is_rendered_once(stage: Stage) -> None:
    assert _plans(stage.shape()) == [FIRST]
    stage.read()
    assert len(stage.charts.rendered) == 1


def test_what_main_had_before_is_rendered_when_somebody_asks(stage: Stage) -> None:
    stage.read()
    stage.history.put(release(SECOND))
    stage.read()
    assert [plan for plan, _ in stage.charts.rendered] == [FIRST, SECOND]
    assert _plans(stage.shape()) == [SECOND, FIRST]


def test_a_process_that_starts_knows_what_main_had_before(stage: Stage) -> None:
    stage.history.put(release(SECOND))
    stage.history.put(release(THIRD))
    assert list(dict.fromkeys(_plans(stage.shape()))) == [THIRD, SECOND, FIRST]


@pytest.mark.parametrize("restart", [False, True])
def test_a_release_that_left_main_counts_for_a_while(stage: Stage, restart: bool) -> None:
    stage.read()
    stage.history.put(gone=[release().path])
    if restart:
        stage.listing.now = LISTING
        stage.start()
    assert _plans(stage.shape())[0] == FIRST
    stage.clock.now += REMOVED_SECONDS + 1
    assert stage.shape() is None
    stage.history.put(release(FOURTH))
    assert _plans(stage.shape())[0] == FOURTH


def _settings(stage: Stage, **data: str) -> list[str]:
    """What is said of a ConfigMap of the release that says this."""
    metadata = {"name": "detector", "namespace": "vehicle-00"}
    permitted = stage.read()
    return [one.message for one in strangers_among({"metadata": metadata, "data": data}, "ConfigMap", permitted)]


def test_settings_that_main_had_before_count_for_a_while(stage: Stage) -> None:
    """Argo CD may be told to ignore that they differ, and then leaves them for ever."""
    stage.history.put(release(FIRST, mode="a"))
    stage.read()
    stage.history.put(release(SECOND, mode="b"))
    assert _settings(stage, mode="a") == _settings(stage, mode="b") == []
    stage.clock.now += SETTINGS_SECONDS - 1
    stage.history.put(release(THIRD, mode="c"))
    assert _settings(stage, mode="a") == []
    stage.clock.now += 2
    [text] = _settings(stage, mode="a")
    assert "is not what the chart of release detector renders: data.mode says something else; main had it so" in text
    assert _settings(stage, mode="b") == _settings(stage, mode="c") == []
    [text] = _settings(stage, mode="x")
    assert "main had it so" not in text
    stage.clock.now += SETTINGS_SECONDS
    assert len(_settings(stage, mode="b")) == 1
    stage.history.put(release(FOURTH, mode="c", more="d"))
    assert _settings(stage, mode="c") == _settings(stage, mode="c", more="d") == []


def test_after_a_start_settings_that_main_had_before_count_as_long(stage: Stage) -> None:
    """When they were replaced is not known then."""
    stage.history.put(release(SECOND, mode="b"))
    stage.history.put(release(THIRD, mode="c"))
    assert _settings(stage, mode="b") == []
    stage.clock.now += SETTINGS_SECONDS + 1
    assert len(_settings(stage, mode="b")) == 1
    assert _plans(stage.shape())[:2] == [THIRD, SECOND]  # a Deployment may be as it was, until its pods are replaced


def test_a_file_that_cannot_be_read_counts_as_it_was(stage: Stage) -> None:
    stage.read()
    stage.history.changes.append({release().path: "kind: [broken"})
    assert _plans(stage.shape())[0] == FIRST


@pytest.mark.parametrize("problem", [UnavailableError("away"), InputError("cannot be rendered")])
def test_what_cannot_be_rendered_is_said_and_tried_again(stage: Stage, problem: Exception) -> None:
    stage.charts.problem = problem
    permitted = stage.read()
    assert permitted.releases["vehicle-00"][0].unknown == f"release vehicle-00/detector: {problem}"
    assert permitted.release("vehicle-00", "anything", "detector") is not None
    stage.charts.problem = None
    assert _plans(stage.shape()) == [FIRST]


def test_what_left_the_list_counts_for_a_while(stage: Stage) -> None:
    stage.read()
    stage.listing.now = AllowedVersions()
    permitted = stage.read()
    image = f"forge.example/robotkube/ros@{VERIFIED}"
    assert permitted.image(image, "vehicle-00")
    assert permitted.chart(CHART)
    stage.clock.now += LATELY_SECONDS + 1
    permitted = stage.read()
    assert not permitted.image(image, "vehicle-00")
    assert not permitted.chart(CHART)


def test_while_the_forge_is_away_the_last_list_counts(stage: Stage) -> None:
    """As while the gate is switched off: nothing is added to it."""
    stage.read()
    stage.listing.away = stage.history.away = True
    with pytest.raises(UnavailableError):
        stage.reader.refresh()
    permitted = stage.reader.permitted()
    assert permitted is not None
    strangers = strangers_on(pods(pod_object(image=FOREIGN_IMAGE)), (), {}, permitted, NOW)
    (message,) = [stranger.message for stranger in strangers if stranger.reason == "ForeignImage"]
    shown("nodes", message, "verifier-off")
