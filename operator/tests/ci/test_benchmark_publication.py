"""What `make bench` says of a publication, and what it starts and stops; the cluster itself is a stand-in."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from benchmarks.platform.publication import Costs, compare, comparison, suite_seconds
from benchmarks.registry import catalogue
from ci import publish
from ci.cluster import choosing
from ci.cluster.embedded import cleaning
from ci.errors import SetUpError
from ci.installation import Installer
from ci.steps import Steps
from robotkube.registry.evidence.core.statements import Artefact, Check, SuiteResult, suite_statement
from robotkube.registry.publication.loops.submitting import PUBLISHED, UNCHANGED, SubmissionOutcome
from scenarios import demo
from tests.stages.registry.signed_evidence import PLATFORM, Signing, signing_key


def evidence(signing: Signing, chart: str, **suites: float) -> Mapping[str, str]:
    """The files of a chart whose suites took these seconds."""
    about = Artefact(chart, "0.1.0", f"sha256:{'a' * 64}", PLATFORM)
    files = {f"{about.folder}/summary.json": "never looked into"}
    for suite, seconds in suites.items():
        result = SuiteResult(suite, "1", "passed", (Check("probes", True),), seconds)
        envelope = signing.key.sign(suite_statement(about, signing.policy.digest, result))
        files[f"{about.folder}/{suite}.json"] = envelope.decode()
    return files


@pytest.fixture
def published(tmp_path: Path) -> Mapping[str, str]:
    signing = Signing(signing_key(tmp_path / "key"))
    return {**evidence(signing, "relay", static=2.5, install=9.0), **evidence(signing, "other", static=3.5)}


@dataclass
class BenchmarkStage:
    """A machine on which the clusters `running` run. `verdict` is that of publishing again; `refusal` ends the first
    publication. `done` is what was asked for, in order, `kept` the folders that were given."""

    evidence: Mapping[str, str]
    running: set[str] = field(default_factory=set)
    verdict: str = UNCHANGED
    refusal: str = ""
    done: list[str] = field(default_factory=list)
    kept: list[Path | None] = field(default_factory=list)

    def leftovers(self, name: str) -> Sequence[str]:
        return ("process 1",) if name in self.running else ()

    def bring_up(self, request: demo.Request, steps: Steps) -> Installer:
        assert not self.running
        self.running.add(request.cluster.name)
        self.done.append(f"up {request.cluster.name} {request.settings} {request.until}")
        self.kept.append(request.kept)
        assert request.kept is not None
        assert list(request.kept.iterdir()) == []
        if self.refusal:
            raise SetUpError(self.refusal)
        steps.seconds["catalogue"] = 90.0
        return Installer(Path(), Path("kubeconfig"), Path())

    def publish(self, kubeconfig: Path, kept: Path) -> publish.Published:
        self.done.append(f"publish by {kubeconfig}")
        self.kept.append(kept)
        return publish.Published((), SubmissionOutcome(self.verdict, evidence=self.evidence))

    def down(self, name: str) -> None:
        self.done.append(f"down {name}")
        self.running.discard(name)


@pytest.fixture
def stage(published: Mapping[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> BenchmarkStage:
    made = BenchmarkStage(published)

    class Embedded:
        def __init__(self, name: str, binaries: Path) -> None:
            self.name = name

        def down(self) -> None:
            made.down(self.name)

    monkeypatch.setattr(cleaning, "leftovers", made.leftovers)
    monkeypatch.setattr(demo, "bring_up", made.bring_up)
    monkeypatch.setattr(publish, "publish", made.publish)
    monkeypatch.setattr(choosing, "Embedded", Embedded)
    monkeypatch.setattr(catalogue, "RECORD", tmp_path / "bench" / "registry.json")
    return made


def test_a_suite_takes_the_mean_over_the_charts(published: Mapping[str, str]) -> None:
    assert suite_seconds(published) == {"static": 3.0, "install": 9.0}


def test_the_first_publication_has_its_goal_and_a_slow_machine_more() -> None:
    quick = comparison(Costs(3, 200.0, 4.0, {}))
    assert (quick.ours, quick.baseline, quick.ratio_max, quick.passed) == (200.0, 4.0, 60.0, True)
    assert not comparison(Costs(3, 241.0, 4.0, {})).passed
    assert comparison(Costs(3, 470.0, 20.0, {})).passed
    assert not comparison(Costs(3, 490.0, 20.0, {})).passed


def test_it_is_measured_on_a_cluster_of_its_own_and_recorded(stage: BenchmarkStage) -> None:
    [difference] = compare()
    assert (difference.name, difference.ours, difference.unit) == ("publish 2 charts, every suite run", 90.0, "s")
    assert stage.done == ["up test {'vehicles': '3'} platform", *["publish by kubeconfig"] * 3, "down test"]
    [kept] = set(stage.kept)
    assert kept is not None
    assert not kept.exists()
    recorded = json.loads(catalogue.RECORD.read_text())
    assert recorded["publish_seconds"] == {"static": 3.0, "install": 9.0}
    assert recorded["publish_all_s"] == 90.0
    assert 0 <= recorded["publish_unchanged_s"] < 90


@pytest.mark.parametrize("name", ["demo", "test"])
def test_a_cluster_that_runs_is_stopped_and_that_is_said(
    stage: BenchmarkStage, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    stage.running.add(name)
    compare()
    assert stage.done[0] == f"down {name}"
    assert f"stopping the cluster {name}" in capsys.readouterr().err
    assert stage.running == set()


def test_a_refused_publication_leaves_no_cluster_and_no_figures(stage: BenchmarkStage) -> None:
    stage.refusal = "the gate refused to publish"
    with pytest.raises(SetUpError, match="the gate refused"):
        compare()
    assert stage.done[-1] == "down test"
    assert not catalogue.RECORD.exists()


def test_a_repetition_that_publishes_is_no_baseline(stage: BenchmarkStage) -> None:
    stage.verdict = PUBLISHED
    with pytest.raises(SetUpError, match="publishing the same again gave published, published, published"):
        compare()
    assert stage.running == set()
    assert not catalogue.RECORD.exists()
