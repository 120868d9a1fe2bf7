"""Charts tried before they are submitted: what is run, what is not and why, and what a path names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.evidence.core.statements import Check, SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule, VerificationPolicy
from robotkube.registry.publication.adapters.tried_folders import find_tried, stand_ins
from robotkube.registry.publication.loops.trying import ON_THE_PLATFORM, TriedSuite, Trying
from robotkube.registry.publication.ports import ChartSource
from robotkube.registry.suites.ports.suites import Subject, Suite, SuiteNamespace
from tests.stages.paths import REPOSITORY
from tests.stages.registry.publications import write_sources

SERVICES = ("drive", "order", "plan")
OWN = {"static": "1", "images": "1"}


class ScriptedSuite:
    """A suite that renders what it is given, and gives the checks that a test says."""

    version = "1"

    def __init__(self, name: str, *checks: Check, error: Exception | None = None) -> None:
        self.name = name
        self.needs_namespace = name in ("interface", "install")
        self._checks, self._error = checks, error
        self.seen: list[Subject] = []

    def run(self, subject: Subject, test_namespace: SuiteNamespace | None) -> Sequence[Check]:
        assert test_namespace is None
        self.seen.append(subject)
        if self._error:
            raise self._error
        return self._checks


class NoProgram:
    def render(self, files: Mapping[str, bytes], values: Any, release: str, namespace: str) -> list[dict[str, Any]]:
        raise AssertionError("nothing is rendered here")


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    write_sources(tmp_path, "delivery", "--services", ",".join(SERVICES))
    return tmp_path


@pytest.fixture
def charts(sources: Path) -> list[ChartSource]:
    return find_tried(sources).read({})


def policy(*rules: SuiteRule) -> VerificationPolicy:
    return VerificationPolicy("tests", rules, "sha256:" + "0" * 64)


class Cluster:
    """Runs suites, or says why not."""

    def __init__(self, answer: SuiteResult | str | BaseException) -> None:
        self.answer = answer
        self.stopped = False

    def run(self, rule: SuiteRule, suite: Suite, subject: Callable[[str], Subject]) -> SuiteResult | str:
        assert subject("robotkube-try-1").artefact.chart
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer

    def stop(self) -> None:
        self.stopped = True


def tried(
    charts: Sequence[ChartSource],
    *suites: ScriptedSuite,
    lacking: Mapping[str, str] | None = None,
    cluster: Cluster | None = None,
) -> list[TriedSuite]:
    rules = [SuiteRule(name, "1", 60) for name in ("static", "images", "interface", "install")]
    own = SuiteRule("own", "1", 60, image="x@sha256:" + "1" * 64)
    hindrance = "no reference of image ros"
    named = {suite.name: suite for suite in suites}

    def hindered(chart: ChartSource, suite: str) -> str:
        return hindrance if suite == "images" else ""

    trying = Trying(named, NoProgram(), lacking or {}, hindered, lambda: 1.0, cluster)
    return trying.run(charts, policy(*rules, own))


def test_each_suite_of_the_policy_is_run_or_said_why_not(charts: list[ChartSource]) -> None:
    rows = tried(charts[:1], ScriptedSuite("static", Check("a", True)), ScriptedSuite("images", Check("b", True)))
    assert [(row.suite, row.outcome, row.reason) for row in rows] == [
        ("static", "passed", ""),
        ("images", "not run", "no reference of image ros"),
        ("interface", "not run", ON_THE_PLATFORM),
        ("install", "not run", ON_THE_PLATFORM),
        ("own", "not run", ON_THE_PLATFORM),
    ]


def test_suites_that_need_a_cluster_run_there_when_the_others_have_passed(charts: list[ChartSource]) -> None:
    suites = ScriptedSuite("static", Check("a", True)), ScriptedSuite("interface"), ScriptedSuite("install")
    passed = SuiteResult("install", "1", "passed", (Check("a", True),), 1.0)
    rows = {one.suite: (one.outcome, one.reason) for one in tried(charts[:1], *suites, cluster=Cluster(passed))}
    assert (rows["interface"], rows["install"]) == (("passed", ""), ("passed", ""))
    rows = {one.suite: (one.outcome, one.reason) for one in tried(charts[:1], *suites, cluster=Cluster("why not"))}
    assert rows["install"] == ("not run", "why not")
    failing = ScriptedSuite("static", Check("a", False, "seen")), *suites[1:]
    rows = {one.suite: (one.outcome, one.reason) for one in tried(charts[:1], *failing, cluster=Cluster(passed))}
    assert rows["install"] == ("not run", "static did not pass; it is run when that has")


def test_an_interruption_stops_what_runs_on_the_cluster(charts: list[ChartSource]) -> None:
    cluster = Cluster(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        tried(charts[:1], ScriptedSuite("static", Check("a", True)), ScriptedSuite("install"), cluster=cluster)
    assert cluster.stopped


def test_what_is_lacking_is_said_of_every_chart(charts: list[ChartSource]) -> None:
    rows = tried(charts, ScriptedSuite("static"), lacking={"static": "no helm", "images": "no platform"})
    assert {(row.suite, row.reason) for row in rows if row.suite in OWN} == {
        ("static", "no helm"),
        ("images", "no platform"),
    }
    assert [row.chart for row in rows if row.suite == "static"] == [f"delivery-{service}" for service in SERVICES]


@pytest.mark.parametrize(
    ("suite", "outcome"),
    [
        (ScriptedSuite("static", Check("a", True), Check("b", False, "seen")), "failed"),
        (ScriptedSuite("static"), "unfinished"),
        (ScriptedSuite("static", error=UnavailableError("helm cannot be started")), "unfinished"),
    ],
)
def test_what_does_not_pass_is_not_called_passed(charts: list[ChartSource], suite: ScriptedSuite, outcome: str) -> None:
    assert [one.outcome for one in tried(charts, suite) if one.suite == "static"] == [outcome] * 3


def test_a_suite_sees_the_chart_as_it_would_be_published(charts: list[ChartSource]) -> None:
    suite = ScriptedSuite("static", Check("a", True))
    tried(charts[:1], suite)
    [subject] = suite.seen
    assert subject.artefact.digest == charts[0].packed.digest
    assert subject.archive == charts[0].packed.archive
    assert subject.entry["status"] == {
        "state": "staged",
        "digest": charts[0].packed.digest,
        "images": sorted(charts[0].images),
    }
    assert "images.yaml" in subject.files
    assert "Dockerfile" not in subject.files


def test_an_image_without_a_reference_has_a_stand_in(sources: Path) -> None:
    folder = find_tried(sources / "charts" / "apps" / "delivery-plan")
    [chart] = folder.read({})
    assert stand_ins(chart) == ["ros"]
    [known] = folder.read({"ros": "host/ros@sha256:" + "1" * 64})
    assert stand_ins(known) == []


def test_a_path_names_a_chart_an_application_or_all(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chart = find_tried(sources / "charts" / "apps" / "delivery-plan")
    assert (chart.names, chart.applications) == (("delivery-plan",), ())
    write_more = sources / "charts" / "apps" / "robotkube-app"
    assert write_more.is_dir()
    every = tuple(f"delivery-{service}" for service in SERVICES)
    application = find_tried(sources / "registry" / "applications" / "delivery.yaml")
    assert (application.names, application.applications) == (every, ("delivery",))
    assert find_tried(sources).names == every
    for place, names in (
        ("charts/apps/delivery-order", ("delivery-order",)),
        ("registry/applications", ()),
        (".", every),
    ):
        monkeypatch.chdir(sources / place)
        if names:
            assert find_tried(Path()).names == names
        else:
            assert find_tried(Path("delivery.yaml")).names == every


def test_an_application_is_tried_with_the_charts_that_its_services_may_get() -> None:
    path = REPOSITORY / "registry" / "applications" / "environment-perception.yaml"
    assert find_tried(path).names == ("object-detection", "object-tracking")


def test_a_path_that_names_nothing_is_refused(tmp_path: Path, sources: Path) -> None:
    with pytest.raises(InputError, match=r"neither the folder of a chart .*; name one of them"):
        find_tried(tmp_path / "nowhere")
    alone = tmp_path.parent / f"{tmp_path.name}-alone"
    alone.mkdir()
    (alone / "Chart.yaml").write_text("name: alone\n")
    with pytest.raises(InputError, match=r"no folder above it has registry/charts.*--registry"):
        find_tried(alone)


def test_without_a_policy_the_own_suites_are_tried(sources: Path) -> None:
    folder = find_tried(sources)
    assert [rule.name for rule in folder.policy(OWN).suites] == ["static", "images", "interface", "install"]
    (sources / "registry" / "policies" / "verification.yaml").unlink()
    assert [(rule.name, rule.version) for rule in folder.policy(OWN).suites] == [("static", "1"), ("images", "1")]
