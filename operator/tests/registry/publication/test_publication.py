"""The publication loop with all but the keys in memory: verdicts and kept results."""

import json
import threading
from pathlib import Path

import pytest

from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.foundation.forge.ports.repositories import Commit
from robotkube.foundation.runtime.adapters.prometheus_series import series_text
from robotkube.registry.catalogue.core.catalogue import read_catalogue
from robotkube.registry.charts.core.packing import PackedChart
from robotkube.registry.evidence.adapters.dsse import KeyFile
from robotkube.registry.evidence.core.statements import Artefact, Check, SuiteResult, suite_statement
from robotkube.registry.evidence.core.verification_policy import PATH as POLICY_PATH
from robotkube.registry.publication.loops.publication import FAILURE_SECONDS_MAX, POLL_SECONDS, publication_metrics
from robotkube.registry.publication.loops.verification import MARGIN_SECONDS
from robotkube.registry.suites.core.requests import SuiteProgress
from tests.stages.pauses import Pauses
from tests.stages.registry import submissions
from tests.stages.registry.publication_in_memory import POLICY, PublicationStage, assured, status_of
from tests.stages.registry.submissions import CATALOGUE, SUITES, application, chart, entry_path, key, trusted


@pytest.fixture
def stage(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


# -- published -------------------------------------------------------------------------------------------------------


def test_a_submission_that_passes_is_published_with_its_evidence(stage: PublicationStage) -> None:
    packed, spec = chart()
    head = stage.submit((packed, spec), **{"applications/relaying.yaml": application()})
    text = stage.settle(head)
    assert stage.merged(head)
    assert "## Verified: relay 0.1.0, application relaying" in text
    assert status_of(stage, packed)["state"] == "verified"
    assert status_of(stage, packed)["policy"] == POLICY.digest
    assert assured(stage, packed)
    assert read_catalogue(stage.main()).problems == ()
    schema = json.loads(stage.main()["charts/relay/0.1.0.schema.json"])
    assert schema["default"] == {"rate": 10}
    assert schema["required"] == ["rate"]
    assert stage.main()[f"keys/{stage.signer.key_id}.pem"] == stage.signer.public_key
    assert stage.registry.manifest_digest("verified/relay", f"0.1.0_{packed.digest[7:19]}") == packed.digest
    attached = stage.registry.attachments("verified/relay", packed.digest)
    assert {one.annotations["robotkube.io/suite"] for one in attached} == {*SUITES, "summary"}
    folder = f"evidence/relay/0.1.0_{packed.digest[7:19]}"
    assert {sha256(one.data) for one in attached} == {
        sha256(text.encode()) for path, text in stage.main().items() if path.startswith(folder)
    }
    assert stage.published == 1


def test_a_chart_that_replaces_one_is_tested_against_it(stage: PublicationStage) -> None:
    first, second = chart(), chart(version="0.2.0", replaces="0.1.0")
    stage.settle(stage.submit(first))
    stage.settle(stage.submit(second))
    assert status_of(stage, second[0])["state"] == "verified"
    replaced = stage.runner.requests[-1].replaced
    assert replaced is not None
    assert (replaced.artefact.digest, replaced.repository) == (first[0].digest, "verified/relay")


def test_applications_alone_are_published(stage: PublicationStage) -> None:
    stage.settle(stage.submit(chart()))
    runs = list(stage.runner.runs)
    number = stage.submit(**{"applications/relaying.yaml": application()})
    assert "## Verified: application relaying" in stage.settle(number)
    assert stage.merged(number)
    assert stage.main()["applications/relaying.yaml"] == application()
    assert stage.runner.runs == runs


def test_the_same_submission_twice_is_published_once(stage: PublicationStage) -> None:
    first, second = stage.submit(chart()), stage.submit(chart())
    stage.settle(first)
    tip = stage.catalogue.tip
    assert "## Already published: relay 0.1.0" in stage.settle(second)
    assert not stage.merged(second)
    assert stage.catalogue.tip == tip
    assert len(stage.runner.runs) == len(SUITES)
    assert stage.gate.statistics.verdicts == {"published": 1, "refused": 0, "unchanged": 1, "failed": 0}


def test_two_submissions_at_once_are_both_published(stage: PublicationStage) -> None:
    one, other = chart(), chart("other")
    numbers = [stage.submit(one), stage.submit(other)]
    for number in numbers:
        stage.settle(number)
    assert all(map(stage.merged, numbers))
    assert assured(stage, one[0])
    assert assured(stage, other[0])


# -- refused ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suite", SUITES)
def test_a_failed_suite_refuses_with_check_finding_and_fix(stage: PublicationStage, suite: str) -> None:
    packed, spec = chart()
    stage.runner.checks[suite] = (
        Check("it is there", True),
        Check("container relay is not privileged", False, "privileged: true | `x` <b>@all</b>", "remove `privileged`"),
    )
    number = stage.submit((packed, spec))
    text = stage.settle(number)
    assert not stage.merged(number)
    assert "## Refused: relay 0.1.0" in text
    assert f"Nothing was published. {suite} of relay failed." in text
    assert "- container relay is not privileged\n  - found: `privileged: true | 'x' <b>@all</b>`" in text
    assert "do: remove \\`privileged\\`" in text
    assert entry_path(packed) not in stage.main()
    assert "verified/relay" not in stage.registry.charts
    attached = {
        attachment.annotations["robotkube.io/suite"]: attachment
        for attachment in stage.registry.attachments("staging/relay", packed.digest)
    }
    plain = {"static", "images"}
    assert set(attached) == (plain if suite in plain else set(SUITES))
    predicate = stage.verifier.verify(attached[suite].data).statement["predicate"]
    assert (predicate["result"], predicate["failedTests"]) == ("FAILED", ["container relay is not privileged"])


def test_a_failed_suite_runs_again_in_the_next_submission_and_only_that(stage: PublicationStage) -> None:
    packed = chart()
    stage.runner.checks["interface"] = (Check("topics", False, "none", "declare them"),)
    stage.settle(stage.submit(packed))
    del stage.runner.checks["interface"]
    stage.start()
    number = stage.submit(packed)
    text = stage.settle(number)
    assert stage.merged(number)
    assert stage.runner.runs.count(("relay", "interface")) == 2
    assert stage.runner.runs.count(("relay", "static")) == 1
    assert "| static 1 | passed | 1.5 s | kept result |" in text
    assert "| interface 1 | passed | 1.5 s | ended " in text
    assert assured(stage, packed[0])


@pytest.mark.parametrize("suite", ["static", "images"])
def test_what_is_wrong_without_a_test_namespace_takes_none(stage: PublicationStage, suite: str) -> None:
    """Not for the other chart of the submission either; every suite that needs none is told, so that all of it can be
    mended at once."""
    stage.runner.checks[suite] = (Check("probes", False, "none", "add them"),)
    number = stage.submit(chart(), chart("other"))
    text = stage.settle(number)
    assert not stage.merged(number)
    assert {name for _, name in stage.runner.runs} == {"static", "images"}
    assert text.count("| interface 1 | not run |") == 2
    assert f"{suite} of other failed, {suite} of relay failed" in text


def test_an_unfinished_suite_is_not_a_passed_one(stage: PublicationStage) -> None:
    result = SuiteResult("install", "1", "unfinished", (Check("became ready", True),), 60.0)
    stage.runner.progress["install"] = SuiteProgress("finished", result)
    number = stage.submit(chart())
    text = stage.settle(number)
    assert not stage.merged(number)
    assert "install of relay did not finish" in text


@pytest.mark.parametrize(
    "result",
    [
        SuiteResult("install", "1", "passed", (), 1.0),
        SuiteResult("install", "2", "passed", (Check("a", True),), 1.0),
        SuiteResult("static", "1", "passed", (Check("a", True),), 1.0),
        SuiteResult("install", "1", "passed", (Check("a", True), Check("b", False, "found", "fix")), 1.0),
    ],
)
def test_a_result_that_proves_nothing_refuses(stage: PublicationStage, result: SuiteResult) -> None:
    stage.runner.progress["install"] = SuiteProgress("finished", result)
    number = stage.submit(chart())
    assert "## Refused" in stage.settle(number)
    assert not stage.merged(number)


def test_a_suite_that_does_not_end_is_unfinished_after_its_time(stage: PublicationStage) -> None:
    stage.runner.progress["install"] = SuiteProgress("running")
    number = stage.submit(chart())
    stage.gate.round()
    stage.now += 60 + MARGIN_SECONDS
    stage.gate.round()
    assert "| install 1 | running |" in stage.text(number)
    stage.now += 1
    assert "still running after 120 s" in stage.settle(number)


def test_while_suites_run_the_comment_says_so(stage: PublicationStage) -> None:
    stage.runner.progress["install"] = SuiteProgress("queued", reason="all test namespaces are in use")
    number = stage.submit(chart())
    stage.gate.round()
    text = stage.text(number)
    assert "## Checking: relay 0.1.0" in text
    assert "3 of 4 suites passed so far." in text
    assert "| install 1 | queued |  | all test namespaces are in use |" in text
    del stage.runner.progress["install"]
    stage.settle(number)
    assert stage.merged(number)


def test_a_runner_that_is_away_decides_nothing(stage: PublicationStage) -> None:
    stage.runner.fail = UnavailableError("suite-runner http://runner: refused")
    number = stage.submit(chart())
    for _ in range(5):
        stage.now += 10_000
        stage.gate.round()
    assert "## Waiting: relay 0.1.0" in stage.text(number)
    assert "It waits: suite-runner http://runner: refused" in stage.text(number)
    stage.runner.fail = None
    stage.settle(number)
    assert stage.merged(number)


def test_rounds_that_failed_are_repeated_after_a_back_off(
    stage: PublicationStage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopping = threading.Event()
    pauses = Pauses(4, stopping)
    stage.catalogue.away = True
    monkeypatch.setattr(stage.gate, "_woken", pauses)
    monkeypatch.setattr(stage.gate, "_jitter", lambda: 0.5)
    stage.gate.run(stopping)
    longest = FAILURE_SECONDS_MAX / 2
    assert pauses.seconds == [POLL_SECONDS / 2, longest, longest, longest]


def test_a_request_that_the_runner_refuses_is_told(stage: PublicationStage) -> None:
    stage.runner.fail = InputError("suite-runner: 400 entry: must be a mapping")
    assert "found: `suite-runner: 400 entry: must be a mapping`" in stage.settle(stage.submit(chart()))


# -- kept results ----------------------------------------------------------------------------------------------------


def kept_files(stage: PublicationStage) -> dict[str, str]:
    """The evidence as `registry submit --kept` puts it into a submission."""
    return {path: text for path, text in stage.main().items() if path.startswith("evidence/")}


def another_stage(stage: PublicationStage, folder: Path) -> PublicationStage:
    """A new cluster with the same key."""
    fresh = PublicationStage(folder)
    fresh.signer, fresh.verifier = stage.signer, stage.verifier
    fresh.start()
    return fresh


def test_kept_evidence_is_used_in_another_cluster_with_the_same_key(stage: PublicationStage, tmp_path: Path) -> None:
    packed = chart()
    stage.settle(stage.submit(packed))
    fresh = another_stage(stage, tmp_path / "fresh")
    number = fresh.submit(packed, **kept_files(stage))
    text = fresh.settle(number)
    assert fresh.merged(number)
    assert fresh.runner.runs == []
    assert text.count("kept result") == len(SUITES)
    assert kept_files(fresh) == kept_files(stage)
    assert status_of(fresh, packed[0]) == status_of(stage, packed[0])
    assert assured(fresh, packed[0])


def test_a_commit_that_cannot_be_read_is_refused(stage: PublicationStage, monkeypatch: pytest.MonkeyPatch) -> None:
    def unreadable(number: int) -> Commit:
        raise DocumentError(f"commit {number}", ["changes more than 1000 files; split it"])

    number = stage.submit(chart())
    monkeypatch.setattr(stage.catalogue, "proposal", unreadable)
    assert "changes more than 1000 files; split it" in stage.settle(number)
    assert not stage.merged(number)


def test_one_changed_byte_is_verified_again(stage: PublicationStage) -> None:
    packed, changed = chart(), chart(text="kind: ConfigMap \n")
    stage.settle(stage.submit(packed))
    stage.local_builds = True
    stage.start()
    number = stage.submit(changed)
    stage.settle(number)
    assert stage.merged(number)
    assert len(stage.runner.runs) == 2 * len(SUITES)
    assert assured(stage, changed[0])


def test_a_changed_entry_is_verified_again(stage: PublicationStage) -> None:
    """The digest covers the entry: what it claims cannot be changed under results that were found for another."""
    first, second = chart(), chart(description="Claims something else")
    assert first[0].digest != second[0].digest
    stage.settle(stage.submit(first))
    stage.local_builds = True
    stage.start()
    number = stage.submit((first[0], second[1]))
    assert "was packed with another entry" in stage.settle(number)
    assert not stage.merged(number)


def test_what_somebody_changed_on_main_is_restored_by_submitting_again(stage: PublicationStage) -> None:
    packed = chart()
    stage.settle(stage.submit(packed))
    before = stage.main()
    path = entry_path(packed[0])
    schema = path.removesuffix(".yaml") + ".schema.json"
    for changed, old, new in ((path, "description: ", "description: Not "), (schema, '"type"', '"kind"')):
        stage.catalogue.push({changed: before[changed].replace(old, new, 1)}, "by hand")
        assert stage.main() != before
        assert not assured(stage, packed[0])
        stage.start()
        number = stage.submit(packed)
        stage.settle(number)
        assert stage.merged(number)
        assert stage.main() == before
    assert len(stage.runner.runs) == len(SUITES)


def test_a_changed_policy_makes_everything_new(stage: PublicationStage) -> None:
    packed = chart()
    stage.settle(stage.submit(packed))
    policy = {**submissions.POLICY, "spec": {"suites": [{"name": "static", "version": "2", "seconds": 60}]}}
    stage.catalogue.push({POLICY_PATH: write_mapping(policy)})
    number = stage.submit(packed)
    text = stage.settle(number)
    assert stage.merged(number)
    assert "kept result" not in text
    assert stage.runner.runs[-1] == ("relay", "static")
    assert status_of(stage, packed[0])["policy"] != POLICY.digest
    assert stage.runner.requests[-1].rule.version == "2"


def forged_statement(stage: PublicationStage, packed: PackedChart, signer: KeyFile) -> str:
    artefact = Artefact(packed.name, packed.version, packed.digest, "linux/amd64")
    result = SuiteResult("install", "1", "passed", (Check("installs", True),), 1.0)
    return signer.sign(suite_statement(artefact, POLICY.digest, result)).decode()


def test_evidence_that_a_publisher_forged_is_not_used(stage: PublicationStage, tmp_path: Path) -> None:
    packed, spec = chart()
    forged = forged_statement(stage, packed, key(tmp_path / "forger", "forger"))
    path = f"evidence/relay/0.1.0_{packed.digest[7:19]}/install.json"
    stage.runner.checks["install"] = (Check("installs", False, "never ready", "fix the probe"),)
    number = stage.submit((packed, spec), **{path: forged})
    assert "install of relay failed" in stage.settle(number)
    assert not stage.merged(number)


def test_evidence_that_was_edited_or_is_of_another_digest_is_not_used(stage: PublicationStage, tmp_path: Path) -> None:
    first, second = chart(), chart("relay", "0.2.0", replaces="0.1.0")
    stage.settle(stage.submit(first))
    folder = f"evidence/relay/0.2.0_{second[0].digest[7:19]}"
    other = {f"{folder}/{path.rpartition('/')[2]}": text for path, text in kept_files(stage).items()}
    other[f"{folder}/static.json"] = other[f"{folder}/static.json"].replace("relay", "relax")
    number = stage.submit(second, **other)
    stage.settle(number)
    assert stage.merged(number)
    assert len(stage.runner.runs) == 2 * len(SUITES)


def test_a_second_key_keeps_what_the_first_signed(stage: PublicationStage, tmp_path: Path) -> None:
    first, second = chart(), chart("other")
    stage.settle(stage.submit(first))
    new = key(tmp_path / "second", "second")
    both = trusted(stage.keys, new)
    stage.start(new, both)
    again = stage.submit(first)
    stage.settle(again)
    number = stage.submit(second)
    stage.settle(number)
    assert stage.merged(number)
    assert len(stage.runner.runs) == 2 * len(SUITES)
    assert {f"keys/{one.key_id}.pem" for one in (new, stage.signer)} <= set(stage.main())


def test_after_a_key_lost_trust_what_it_signed_is_verified_again(stage: PublicationStage, tmp_path: Path) -> None:
    packed = chart()
    stage.settle(stage.submit(packed))
    new = key(tmp_path / "second", "second")
    stage.start(new, trusted(tmp_path / "only-the-new", new))
    number = stage.submit(packed)
    assert "kept result" not in stage.settle(number)
    assert stage.merged(number)
    stage.verifier = trusted(tmp_path / "only-the-new")
    assert assured(stage, packed[0])


def test_a_gate_whose_own_key_is_not_trusted_publishes_nothing(stage: PublicationStage, tmp_path: Path) -> None:
    stage.start(key(tmp_path / "stranger", "stranger"))
    number = stage.submit(chart())
    for _ in range(3):
        stage.gate.round()
    assert not stage.merged(number)
    assert "not trusted here" in stage.text(number)
    assert stage.gate.statistics.verdicts["failed"] == 1


def test_the_runner_may_answer_late_for_each_of_two_charts(stage: PublicationStage) -> None:
    stage.runner.progress["static"] = SuiteProgress("running")
    number = stage.submit(chart(), chart("other"))
    stage.gate.round()
    assert "2 of 8 suites passed so far." in stage.text(number)  # images; the others wait for what is seen sooner
    del stage.runner.progress["static"]
    text = stage.settle(number)
    assert "### relay 0.1.0" in text
    assert "### other 0.1.0" in text
    message = stage.catalogue.commits[stage.catalogue.tip].message
    assert message.startswith("publish: other 0.1.0, relay 0.1.0\n\nRobotKube-Chart: other@0.1.0@sha256:")
    assert message.count("RobotKube-Evidence: sha256:") == 2
    assert message.endswith(f"RobotKube-Policy: {POLICY.digest}\nRobotKube-Pull-Request: {number}\n")


def test_a_broken_policy_waits_for_a_person(stage: PublicationStage) -> None:
    stage.catalogue.push({POLICY_PATH: "kind: Nothing\n"})
    number = stage.submit(chart())
    stage.gate.round()
    assert "It waits: policies/verification.yaml on main" in stage.text(number)
    stage.catalogue.push({POLICY_PATH: CATALOGUE[POLICY_PATH]})
    stage.settle(number)
    assert stage.merged(number)


def test_metrics_count_verdicts_and_suites(stage: PublicationStage) -> None:
    stage.settle(stage.submit(chart()))
    text = series_text(publication_metrics(stage.gate.statistics))
    assert 'robotkube_gate_publications_total{verdict="published"} 1' in text
    assert 'robotkube_gate_suite_seconds_total{suite="install"} 1.5\n' in text


def test_a_submission_that_breaks_its_checks_holds_up_no_other(stage: PublicationStage) -> None:
    bad, good = stage.submit(chart("bad")), stage.submit(chart())
    pull = stage.registry.pull_chart

    def broken(repository: str, digest: str) -> object:
        if repository.endswith("/bad"):
            raise RuntimeError("a mistake in the gate")
        return pull(repository, digest)

    stage.registry.pull_chart = broken  # type: ignore[assignment, method-assign]
    stage.settle(good)
    stage.gate.round()
    assert stage.merged(good)
    assert "It waits: a mistake in the gate; somebody who runs the platform has to examine" in stage.text(bad)
    assert stage.gate.statistics.verdicts["failed"] == 1
    stage.registry.pull_chart = pull  # type: ignore[method-assign]
    stage.settle(bad)
    assert stage.merged(bad)
