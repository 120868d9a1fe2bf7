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
def world(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


# -- published -------------------------------------------------------------------------------------------------------


def test_a_submission_that_passes_is_published_with_its_evidence(world: PublicationStage) -> None:
    packed, spec = chart()
    head = world.submit((packed, spec), **{"applications/relaying.yaml": application()})
    text = world.settle(head)
    assert world.merged(head)
    assert "## Verified: relay 0.1.0, application relaying" in text
    assert status_of(world, packed)["state"] == "verified"
    assert status_of(world, packed)["policy"] == POLICY.digest
    assert assured(world, packed)
    assert read_catalogue(world.main()).problems == ()
    schema = json.loads(world.main()["charts/relay/0.1.0.schema.json"])
    assert schema["default"] == {"rate": 10}
    assert schema["required"] == ["rate"]
    assert world.main()[f"keys/{world.signer.key_id}.pem"] == world.signer.public_key
    assert world.registry.manifest_digest("verified/relay", f"0.1.0_{packed.digest[7:19]}") == packed.digest
    attached = world.registry.attachments("verified/relay", packed.digest)
    assert {one.annotations["robotkube.io/suite"] for one in attached} == {*SUITES, "summary"}
    folder = f"evidence/relay/0.1.0_{packed.digest[7:19]}"
    assert {sha256(one.data) for one in attached} == {
        sha256(text.encode()) for path, text in world.main().items() if path.startswith(folder)
    }
    assert world.published == 1


def test_a_chart_that_replaces_one_is_tested_against_it(world: PublicationStage) -> None:
    first, second = chart(), chart(version="0.2.0", replaces="0.1.0")
    world.settle(world.submit(first))
    world.settle(world.submit(second))
    assert status_of(world, second[0])["state"] == "verified"
    replaced = world.runner.requests[-1].replaced
    assert replaced is not None
    assert (replaced.artefact.digest, replaced.repository) == (first[0].digest, "verified/relay")


def test_applications_alone_are_published(world: PublicationStage) -> None:
    world.settle(world.submit(chart()))
    runs = list(world.runner.runs)
    number = world.submit(**{"applications/relaying.yaml": application()})
    assert "## Verified: application relaying" in world.settle(number)
    assert world.merged(number)
    assert world.main()["applications/relaying.yaml"] == application()
    assert world.runner.runs == runs


def test_the_same_submission_twice_is_published_once(world: PublicationStage) -> None:
    first, second = world.submit(chart()), world.submit(chart())
    world.settle(first)
    tip = world.catalogue.tip
    assert "## Already published: relay 0.1.0" in world.settle(second)
    assert not world.merged(second)
    assert world.catalogue.tip == tip
    assert len(world.runner.runs) == len(SUITES)
    assert world.gate.statistics.verdicts == {"published": 1, "refused": 0, "unchanged": 1, "failed": 0}


def test_two_submissions_at_once_are_both_published(world: PublicationStage) -> None:
    one, other = chart(), chart("other")
    numbers = [world.submit(one), world.submit(other)]
    for number in numbers:
        world.settle(number)
    assert all(map(world.merged, numbers))
    assert assured(world, one[0])
    assert assured(world, other[0])


# -- refused ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suite", SUITES)
def test_a_failed_suite_refuses_with_check_finding_and_fix(world: PublicationStage, suite: str) -> None:
    packed, spec = chart()
    world.runner.checks[suite] = (
        Check("it is there", True),
        Check("container relay is not privileged", False, "privileged: true | `x` <b>@all</b>", "remove `privileged`"),
    )
    number = world.submit((packed, spec))
    text = world.settle(number)
    assert not world.merged(number)
    assert "## Refused: relay 0.1.0" in text
    assert f"Nothing was published. {suite} of relay failed." in text
    assert "- container relay is not privileged\n  - found: `privileged: true | 'x' <b>@all</b>`" in text
    assert "do: remove \\`privileged\\`" in text
    assert entry_path(packed) not in world.main()
    assert "verified/relay" not in world.registry.charts
    attached = {
        one.annotations["robotkube.io/suite"]: one for one in world.registry.attachments("staging/relay", packed.digest)
    }
    plain = {"static", "images"}
    assert set(attached) == (plain if suite in plain else set(SUITES))
    predicate = world.verifier.verify(attached[suite].data).statement["predicate"]
    assert (predicate["result"], predicate["failedTests"]) == ("FAILED", ["container relay is not privileged"])


def test_a_failed_suite_runs_again_in_the_next_submission_and_only_that(world: PublicationStage) -> None:
    packed = chart()
    world.runner.checks["interface"] = (Check("topics", False, "none", "declare them"),)
    world.settle(world.submit(packed))
    del world.runner.checks["interface"]
    world.start()
    number = world.submit(packed)
    text = world.settle(number)
    assert world.merged(number)
    assert world.runner.runs.count(("relay", "interface")) == 2
    assert world.runner.runs.count(("relay", "static")) == 1
    assert "| static 1 | passed | 1.5 s | kept result |" in text
    assert "| interface 1 | passed | 1.5 s | ended " in text
    assert assured(world, packed[0])


@pytest.mark.parametrize("suite", ["static", "images"])
def test_what_is_wrong_without_a_test_namespace_takes_none(world: PublicationStage, suite: str) -> None:
    """Not for the other chart of the submission either; every suite that needs none is told, so that all of it can be
    mended at once."""
    world.runner.checks[suite] = (Check("probes", False, "none", "add them"),)
    number = world.submit(chart(), chart("other"))
    text = world.settle(number)
    assert not world.merged(number)
    assert {name for _, name in world.runner.runs} == {"static", "images"}
    assert text.count("| interface 1 | not run |") == 2
    assert f"{suite} of other failed, {suite} of relay failed" in text


def test_an_unfinished_suite_is_not_a_passed_one(world: PublicationStage) -> None:
    result = SuiteResult("install", "1", "unfinished", (Check("became ready", True),), 60.0)
    world.runner.progress["install"] = SuiteProgress("finished", result)
    number = world.submit(chart())
    text = world.settle(number)
    assert not world.merged(number)
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
def test_a_result_that_proves_nothing_refuses(world: PublicationStage, result: SuiteResult) -> None:
    world.runner.progress["install"] = SuiteProgress("finished", result)
    number = world.submit(chart())
    assert "## Refused" in world.settle(number)
    assert not world.merged(number)


def test_a_suite_that_does_not_end_is_unfinished_after_its_time(world: PublicationStage) -> None:
    world.runner.progress["install"] = SuiteProgress("running")
    number = world.submit(chart())
    world.gate.round()
    world.now += 60 + MARGIN_SECONDS
    world.gate.round()
    assert "| install 1 | running |" in world.text(number)
    world.now += 1
    assert "still running after 120 s" in world.settle(number)


def test_while_suites_run_the_comment_says_so(world: PublicationStage) -> None:
    world.runner.progress["install"] = SuiteProgress("queued", reason="all test namespaces are in use")
    number = world.submit(chart())
    world.gate.round()
    text = world.text(number)
    assert "## Checking: relay 0.1.0" in text
    assert "3 of 4 suites passed so far." in text
    assert "| install 1 | queued |  | all test namespaces are in use |" in text
    del world.runner.progress["install"]
    world.settle(number)
    assert world.merged(number)


def test_a_runner_that_is_away_decides_nothing(world: PublicationStage) -> None:
    world.runner.fail = UnavailableError("suite-runner http://runner: refused")
    number = world.submit(chart())
    for _ in range(5):
        world.now += 10_000
        world.gate.round()
    assert "## Waiting: relay 0.1.0" in world.text(number)
    assert "It waits: suite-runner http://runner: refused" in world.text(number)
    world.runner.fail = None
    world.settle(number)
    assert world.merged(number)


def test_rounds_that_failed_are_repeated_after_a_back_off(
    world: PublicationStage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopping = threading.Event()
    pauses = Pauses(4, stopping)
    world.catalogue.away = True
    monkeypatch.setattr(world.gate, "_woken", pauses)
    monkeypatch.setattr(world.gate, "_jitter", lambda: 0.5)
    world.gate.run(stopping)
    longest = FAILURE_SECONDS_MAX / 2
    assert pauses.seconds == [POLL_SECONDS / 2, longest, longest, longest]


def test_a_request_that_the_runner_refuses_is_told(world: PublicationStage) -> None:
    world.runner.fail = InputError("suite-runner: 400 entry: must be a mapping")
    assert "found: `suite-runner: 400 entry: must be a mapping`" in world.settle(world.submit(chart()))


# -- kept results ----------------------------------------------------------------------------------------------------


def kept_files(world: PublicationStage) -> dict[str, str]:
    """The evidence as `registry submit --kept` puts it into a submission."""
    return {path: text for path, text in world.main().items() if path.startswith("evidence/")}


def other_world(world: PublicationStage, folder: Path) -> PublicationStage:
    """A new cluster with the same key."""
    fresh = PublicationStage(folder)
    fresh.signer, fresh.verifier = world.signer, world.verifier
    fresh.start()
    return fresh


def test_kept_evidence_is_used_in_another_cluster_with_the_same_key(world: PublicationStage, tmp_path: Path) -> None:
    packed = chart()
    world.settle(world.submit(packed))
    fresh = other_world(world, tmp_path / "fresh")
    number = fresh.submit(packed, **kept_files(world))
    text = fresh.settle(number)
    assert fresh.merged(number)
    assert fresh.runner.runs == []
    assert text.count("kept result") == len(SUITES)
    assert kept_files(fresh) == kept_files(world)
    assert status_of(fresh, packed[0]) == status_of(world, packed[0])
    assert assured(fresh, packed[0])


def test_a_commit_that_cannot_be_read_is_refused(world: PublicationStage, monkeypatch: pytest.MonkeyPatch) -> None:
    def unreadable(number: int) -> Commit:
        raise DocumentError(f"commit {number}", ["changes more than 1000 files; split it"])

    number = world.submit(chart())
    monkeypatch.setattr(world.catalogue, "proposal", unreadable)
    assert "changes more than 1000 files; split it" in world.settle(number)
    assert not world.merged(number)


def test_one_changed_byte_is_verified_again(world: PublicationStage) -> None:
    packed, changed = chart(), chart(text="kind: ConfigMap \n")
    world.settle(world.submit(packed))
    world.local_builds = True
    world.start()
    number = world.submit(changed)
    world.settle(number)
    assert world.merged(number)
    assert len(world.runner.runs) == 2 * len(SUITES)
    assert assured(world, changed[0])


def test_a_changed_entry_is_verified_again(world: PublicationStage) -> None:
    """The digest covers the entry: what it claims cannot be changed under results that were found for another."""
    first, second = chart(), chart(description="Claims something else")
    assert first[0].digest != second[0].digest
    world.settle(world.submit(first))
    world.local_builds = True
    world.start()
    number = world.submit((first[0], second[1]))
    assert "was packed with another entry" in world.settle(number)
    assert not world.merged(number)


def test_what_somebody_changed_on_main_is_restored_by_submitting_again(world: PublicationStage) -> None:
    packed = chart()
    world.settle(world.submit(packed))
    before, path = world.main(), entry_path(packed[0])
    schema = path.removesuffix(".yaml") + ".schema.json"
    for changed, old, new in ((path, "description: ", "description: Not "), (schema, '"type"', '"kind"')):
        world.catalogue.push({changed: before[changed].replace(old, new, 1)}, "by hand")
        assert world.main() != before
        assert not assured(world, packed[0])
        world.start()
        number = world.submit(packed)
        world.settle(number)
        assert world.merged(number)
        assert world.main() == before
    assert len(world.runner.runs) == len(SUITES)


def test_a_changed_policy_makes_everything_new(world: PublicationStage) -> None:
    packed = chart()
    world.settle(world.submit(packed))
    policy = {**submissions.POLICY, "spec": {"suites": [{"name": "static", "version": "2", "seconds": 60}]}}
    world.catalogue.push({POLICY_PATH: write_mapping(policy)})
    number = world.submit(packed)
    text = world.settle(number)
    assert world.merged(number)
    assert "kept result" not in text
    assert world.runner.runs[-1] == ("relay", "static")
    assert status_of(world, packed[0])["policy"] != POLICY.digest
    assert world.runner.requests[-1].rule.version == "2"


def forged_statement(world: PublicationStage, packed: PackedChart, signer: KeyFile) -> str:
    artefact = Artefact(packed.name, packed.version, packed.digest, "linux/amd64")
    result = SuiteResult("install", "1", "passed", (Check("installs", True),), 1.0)
    return signer.sign(suite_statement(artefact, POLICY.digest, result)).decode()


def test_evidence_that_a_publisher_forged_is_not_used(world: PublicationStage, tmp_path: Path) -> None:
    packed, spec = chart()
    forged = forged_statement(world, packed, key(tmp_path / "forger", "forger"))
    path = f"evidence/relay/0.1.0_{packed.digest[7:19]}/install.json"
    world.runner.checks["install"] = (Check("installs", False, "never ready", "fix the probe"),)
    number = world.submit((packed, spec), **{path: forged})
    assert "install of relay failed" in world.settle(number)
    assert not world.merged(number)


def test_evidence_that_was_edited_or_is_of_another_digest_is_not_used(world: PublicationStage, tmp_path: Path) -> None:
    first, second = chart(), chart("relay", "0.2.0", replaces="0.1.0")
    world.settle(world.submit(first))
    folder = f"evidence/relay/0.2.0_{second[0].digest[7:19]}"
    other = {f"{folder}/{path.rpartition('/')[2]}": text for path, text in kept_files(world).items()}
    other[f"{folder}/static.json"] = other[f"{folder}/static.json"].replace("relay", "relax")
    number = world.submit(second, **other)
    world.settle(number)
    assert world.merged(number)
    assert len(world.runner.runs) == 2 * len(SUITES)


def test_a_second_key_keeps_what_the_first_signed(world: PublicationStage, tmp_path: Path) -> None:
    first, second = chart(), chart("other")
    world.settle(world.submit(first))
    new = key(tmp_path / "second", "second")
    both = trusted(world.keys, new)
    world.start(new, both)
    again = world.submit(first)
    world.settle(again)
    number = world.submit(second)
    world.settle(number)
    assert world.merged(number)
    assert len(world.runner.runs) == 2 * len(SUITES)
    assert {f"keys/{one.key_id}.pem" for one in (new, world.signer)} <= set(world.main())


def test_after_a_key_lost_trust_what_it_signed_is_verified_again(world: PublicationStage, tmp_path: Path) -> None:
    packed = chart()
    world.settle(world.submit(packed))
    new = key(tmp_path / "second", "second")
    world.start(new, trusted(tmp_path / "only-the-new", new))
    number = world.submit(packed)
    assert "kept result" not in world.settle(number)
    assert world.merged(number)
    world.verifier = trusted(tmp_path / "only-the-new")
    assert assured(world, packed[0])


def test_a_gate_whose_own_key_is_not_trusted_publishes_nothing(world: PublicationStage, tmp_path: Path) -> None:
    world.start(key(tmp_path / "stranger", "stranger"))
    number = world.submit(chart())
    for _ in range(3):
        world.gate.round()
    assert not world.merged(number)
    assert "not trusted here" in world.text(number)
    assert world.gate.statistics.verdicts["failed"] == 1


def test_the_runner_may_answer_late_for_each_of_two_charts(world: PublicationStage) -> None:
    world.runner.progress["static"] = SuiteProgress("running")
    number = world.submit(chart(), chart("other"))
    world.gate.round()
    assert "2 of 8 suites passed so far." in world.text(number)  # images; the others wait for what is seen sooner
    del world.runner.progress["static"]
    text = world.settle(number)
    assert "### relay 0.1.0" in text
    assert "### other 0.1.0" in text
    message = world.catalogue.commits[world.catalogue.tip].message
    assert message.startswith("publish: other 0.1.0, relay 0.1.0\n\nRobotKube-Chart: other@0.1.0@sha256:")
    assert message.count("RobotKube-Evidence: sha256:") == 2
    assert message.endswith(f"RobotKube-Policy: {POLICY.digest}\nRobotKube-Pull-Request: {number}\n")


def test_a_broken_policy_waits_for_a_person(world: PublicationStage) -> None:
    world.catalogue.push({POLICY_PATH: "kind: Nothing\n"})
    number = world.submit(chart())
    world.gate.round()
    assert "It waits: policies/verification.yaml on main" in world.text(number)
    world.catalogue.push({POLICY_PATH: CATALOGUE[POLICY_PATH]})
    world.settle(number)
    assert world.merged(number)


def test_metrics_count_verdicts_and_suites(world: PublicationStage) -> None:
    world.settle(world.submit(chart()))
    text = series_text(publication_metrics(world.gate.statistics))
    assert 'robotkube_gate_publications_total{verdict="published"} 1' in text
    assert 'robotkube_gate_suite_seconds_total{suite="install"} 1.5\n' in text


def test_a_submission_that_breaks_its_checks_holds_up_no_other(world: PublicationStage) -> None:
    bad, good = world.submit(chart("bad")), world.submit(chart())
    pull = world.registry.pull_chart

    def broken(repository: str, digest: str) -> object:
        if repository.endswith("/bad"):
            raise RuntimeError("a mistake in the gate")
        return pull(repository, digest)

    world.registry.pull_chart = broken  # type: ignore[assignment, method-assign]
    world.settle(good)
    world.gate.round()
    assert world.merged(good)
    assert "It waits: a mistake in the gate; somebody who runs the platform has to examine" in world.text(bad)
    assert world.gate.statistics.verdicts["failed"] == 1
    world.registry.pull_chart = pull  # type: ignore[method-assign]
    world.settle(bad)
    assert world.merged(bad)
