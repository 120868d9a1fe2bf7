"""The publication loop while other things move: main, the pull request, the gate's own end at every point."""

from pathlib import Path

import pytest

from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core.requests import SuiteProgress
from tests.stages.registry.publication_in_memory import PublicationStage, assured, status_of
from tests.stages.registry.submissions import SUITES, chart, entry, entry_path


class KilledError(BaseException):
    """The process ends here; nothing catches it."""


@pytest.fixture
def stage(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def test_a_pull_request_that_changes_while_suites_run_is_decided_anew(stage: PublicationStage) -> None:
    first, second = chart(), chart(text="kind: Secret\n")
    stage.runner.progress["install"] = SuiteProgress("running")
    number = stage.submit(first)
    stage.gate.round()
    commit = stage.catalogue.commit(stage.catalogue.tip, {entry_path(second[0]): entry(*second)}, "other")
    stage.registry.push_chart("staging-publisher", second[0], "other")
    stage.forge.update(number, commit)
    del stage.runner.progress["install"]
    stage.runner.checks["install"] = (Check("installs", False, "no", "yes"),)
    stage.settle(number)
    assert not stage.merged(number)
    assert entry_path(second[0]) not in stage.main()


def test_a_head_that_changes_at_the_last_moment_is_not_on_main_unchecked(stage: PublicationStage) -> None:
    first = chart()
    number = stage.submit(first)
    evil = stage.catalogue.commit(stage.catalogue.tip, {"charts/evil/0.1.0.yaml": "x"}, "evil")

    def swap() -> None:
        stage.catalogue.before_push = lambda: None
        stage.forge.update(number, evil)

    stage.catalogue.before_push = swap
    text = stage.settle(number)
    assert status_of(stage, first[0])["state"] == "verified"
    assert "charts/evil/0.1.0.yaml" not in stage.main()
    assert not stage.merged(number)
    assert "## Refused" in text


def test_main_that_moves_before_the_push_is_looked_at_again(stage: PublicationStage) -> None:
    number = stage.submit(chart())

    def move() -> None:
        stage.catalogue.before_push = lambda: None
        stage.catalogue.push({"README.md": "a person was here\n"})

    stage.catalogue.before_push = move
    stage.settle(number)
    assert stage.merged(number)
    assert stage.main()["README.md"] == "a person was here\n"
    assert len(stage.runner.runs) == len(SUITES)


def test_a_version_published_meanwhile_with_another_digest_is_not_replaced(stage: PublicationStage) -> None:
    first, second = chart(), chart(text="kind: Secret\n")
    one, two = stage.submit(first), stage.submit(second)
    stage.settle(one)
    assert "a version is never replaced: raise" in stage.settle(two)
    assert status_of(stage, first[0])["digest"] == first[0].digest


@pytest.mark.parametrize(("method", "call"), [("attach", 1), ("attach", 2), ("attach", 5), ("copy_chart", 1)])
def test_a_gate_killed_between_sign_attach_and_copy_is_finished_by_the_next(
    stage: PublicationStage, method: str, call: int
) -> None:
    packed = chart()
    number = stage.submit(packed)
    calls = {"attach": 0, "copy_chart": 0}

    def kill(name: str) -> None:
        calls[name] += 1
        if name == method and calls[name] == call:
            raise KilledError

    stage.registry.before = kill
    with pytest.raises(KilledError):
        stage.settle(number)
    assert entry_path(packed[0]) not in stage.main()
    stage.registry.before = lambda name: None
    stage.start()
    stage.settle(number)
    assert stage.merged(number)
    assert assured(stage, packed[0])


def test_a_gate_killed_before_the_merge_is_finished_by_the_next(stage: PublicationStage) -> None:
    packed = chart()
    number = stage.submit(packed)

    def kill() -> None:
        raise KilledError

    stage.catalogue.before_push = kill
    with pytest.raises(KilledError):
        stage.settle(number)
    assert entry_path(packed[0]) not in stage.main()
    copied = list(stage.registry.attachments("verified/relay", packed[0].digest))
    assert len(copied) == len(SUITES) + 1
    stage.catalogue.before_push = lambda: None
    stage.start()
    stage.settle(number)
    assert stage.merged(number)
    assert list(stage.registry.attachments("verified/relay", packed[0].digest)) == copied
    assert len(stage.forge.said[number]) == 1


def test_a_gate_killed_after_the_merge_leaves_it(stage: PublicationStage) -> None:
    number = stage.submit(chart())
    stage.settle(number)
    tip = stage.catalogue.tip
    stage.forge.pulls[number] = stage.forge.pulls[number].__class__(
        **{**vars(stage.forge.pulls[number]), "state": "open", "merged": False}
    )
    stage.start().round()
    assert stage.catalogue.tip == tip
    assert len(stage.forge.said[number]) == 1
