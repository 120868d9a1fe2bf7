"""What the publication loop tries: copied from the publisher's place to staging, where no publisher writes."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.charts.ports import Attachment
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core.image_checks import BILL_TYPE
from robotkube.registry.suites.core.requests import SuiteProgress
from tests.stages.registry.publication_in_memory import PublicationStage
from tests.stages.registry.submissions import chart, entry, entry_path


@pytest.fixture
def stage(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def test_a_chart_that_leaves_staging_while_its_suites_run_is_refused(stage: PublicationStage) -> None:
    packed = chart()
    stage.runner.progress["install"] = SuiteProgress("running")
    number = stage.submit(packed)
    stage.gate.round()
    del stage.registry.charts["staging/relay"][packed[0].digest]
    del stage.runner.progress["install"]
    stage.registry.before = lambda method: stage.registry.pull_chart("staging/relay", packed[0].digest) and None
    assert f"staging/relay has no digest {packed[0].digest} any more; submit it again" in stage.settle(number)
    assert not stage.merged(number)


def test_what_the_publisher_takes_away_once_it_is_tried_is_published(stage: PublicationStage) -> None:
    packed = chart()
    stage.runner.progress["install"] = SuiteProgress("running")
    number = stage.submit(packed)
    stage.gate.round()
    del stage.registry.charts["staging-publisher/relay"]
    stage.start()  # nor does another gate need it
    stage.gate.round()
    stage.runner.progress.clear()
    stage.settle(number)
    assert stage.merged(number)
    assert {request.repository for request in stage.runner.requests} == {"staging/relay"}


def test_a_chart_that_its_publisher_took_away_before_it_was_tried_is_refused(stage: PublicationStage) -> None:
    packed = chart()
    stage.registry.push_chart("staging-somebody", packed[0])  # of another publisher
    number = stage.submit(packed, push=False)
    text = stage.settle(number)
    assert f"staging-publisher/relay has no digest {packed[0].digest}; submit it again" in text
    assert "and write no tag twice" in text
    assert not stage.merged(number)


def test_a_chart_that_is_not_that_of_its_entry_does_not_get_into_staging(stage: PublicationStage) -> None:
    packed, spec = chart()
    number = stage.submit((packed, {**spec, "description": "another entry"}))
    assert "was packed with another entry" in stage.settle(number)
    assert "staging/relay" not in stage.registry.charts


def test_what_was_pushed_to_staging_before_publishers_had_places_is_published(stage: PublicationStage) -> None:
    packed = chart()
    stage.registry.push_chart("staging", packed[0], "0.1.0")
    number = stage.submit(packed, push=False)
    stage.settle(number)
    assert stage.merged(number)


@pytest.mark.parametrize("when", ["before", "while"])
def test_attachments_in_staging_that_cannot_be_read_are_refused(
    stage: PublicationStage, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """Publishers wrote the tag in which attachments are listed before they had places of their own."""
    attachments = stage.registry.attachments

    def broken(repository: str, subject: str) -> Sequence[Attachment]:
        if repository.startswith("staging/"):
            raise InputError("no index of at most 256 artefacts")
        return attachments(repository, subject)

    def attaching(method: str) -> None:
        if method == "attach":
            broken("staging/relay", "")

    if when == "before":
        monkeypatch.setattr(stage.registry, "attachments", broken)
    stage.runner.progress["install"] = SuiteProgress("running")
    packed = chart()
    number = stage.submit(packed)
    stage.gate.round()
    monkeypatch.setattr(stage.registry, "attachments", broken)
    stage.registry.before = attaching
    stage.runner.progress.clear()
    text = stage.settle(number)
    assert "cannot be read: no index of at most 256 artefacts" in text
    assert f"delete the tag sha256-{packed[0].digest[7:]} of staging/relay" in text
    assert not stage.merged(number)


OWN_DIGEST = f"sha256:{'5' * 64}"
OWN_IMAGE = f"forge.invalid/own-images/relay@{OWN_DIGEST}"


def submit_with_own_image(stage: PublicationStage) -> int:
    packed, spec = chart(image=OWN_IMAGE)
    return stage.submit((packed, spec), **{entry_path(packed): entry(packed, spec, images=[OWN_IMAGE])})


def test_an_own_image_is_copied_with_its_bill_to_where_nodes_pull_it(stage: PublicationStage) -> None:
    place = "staging-publisher/images/relay"
    stage.registry.images[place] = {OWN_DIGEST}
    stage.registry.attach(place, OWN_DIGEST, BILL_TYPE, b"a bill", {})
    stage.registry.attach(place, OWN_DIGEST, "text/plain", b"anything else", {})
    number = submit_with_own_image(stage)
    stage.gate.round()
    assert stage.registry.images["own-images/relay"] == {OWN_DIGEST}
    copied = stage.registry.attachments("own-images/relay", OWN_DIGEST)
    assert [one.data for one in copied] == [b"a bill"]
    del stage.registry.images[place]  # what its author deletes from now on changes nothing
    stage.settle(number)
    assert stage.merged(number)


def own_image(stage: PublicationStage) -> set[str]:
    return stage.registry.images["own-images/relay"]


def pushed(stage: PublicationStage) -> None:
    """The image in its author's place, with a bill."""
    stage.registry.images["staging-publisher/images/relay"] = {OWN_DIGEST}
    stage.registry.attach("staging-publisher/images/relay", OWN_DIGEST, BILL_TYPE, b"a bill", {})


def test_the_image_of_a_refused_submission_is_removed_again(stage: PublicationStage) -> None:
    pushed(stage)
    stage.runner.checks["static"] = (Check("a", False, "seen", "do"),)
    number = submit_with_own_image(stage)
    stage.settle(number)
    assert not stage.merged(number)
    assert own_image(stage) == set()
    assert stage.registry.attachments("own-images/relay", OWN_DIGEST) == ()
    assert stage.registry.images["staging-publisher/images/relay"] == {OWN_DIGEST}


def test_so_it_is_when_its_author_closes_it(stage: PublicationStage) -> None:
    pushed(stage)
    stage.runner.progress["static"] = SuiteProgress("running")
    number = submit_with_own_image(stage)
    stage.gate.round()
    assert own_image(stage) == {OWN_DIGEST}
    stage.forge.close(number)
    stage.gate.round()
    assert own_image(stage) == set()


def test_what_a_published_version_has_stays(stage: PublicationStage) -> None:
    pushed(stage)
    stage.settle(submit_with_own_image(stage))
    stage.runner.checks["static"] = (Check("a", False, "seen", "do"),)
    packed, spec = chart(version="0.2.0", image=OWN_IMAGE)
    number = stage.submit((packed, spec), **{entry_path(packed): entry(packed, spec, images=[OWN_IMAGE])})
    stage.settle(number)
    assert not stage.merged(number)
    assert own_image(stage) == {OWN_DIGEST}


def test_what_another_open_submission_has_stays_until_that_is_decided(stage: PublicationStage) -> None:
    pushed(stage)
    stage.runner.progress["static"] = SuiteProgress("running")
    first = submit_with_own_image(stage)
    packed, spec = chart(version="0.2.0", image=OWN_IMAGE)
    second = stage.submit((packed, spec), **{entry_path(packed): entry(packed, spec, images=[OWN_IMAGE])})
    stage.gate.round()
    stage.forge.close(first)
    stage.gate.round()
    assert own_image(stage) == {OWN_DIGEST}
    stage.forge.close(second)
    stage.gate.round()
    assert own_image(stage) == set()


def test_a_registry_that_is_away_is_asked_again(stage: PublicationStage) -> None:
    pushed(stage)
    stage.runner.progress["static"] = SuiteProgress("running")
    number = submit_with_own_image(stage)
    stage.gate.round()

    def away(method: str) -> None:
        if method == "remove_image":
            raise UnavailableError("no answer")

    stage.registry.before = away
    stage.forge.close(number)
    stage.gate.round()
    assert own_image(stage) == {OWN_DIGEST}
    stage.registry.before = lambda method: None
    stage.gate.round()
    assert own_image(stage) == set()


def test_an_own_image_that_is_nowhere_is_refused_in_words(stage: PublicationStage) -> None:
    text = stage.settle(submit_with_own_image(stage))
    assert f"image relay: staging-publisher/images/relay has no digest {OWN_DIGEST}; push it" in text
    assert stage.runner.requests == []
