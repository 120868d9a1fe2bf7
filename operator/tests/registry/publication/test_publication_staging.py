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
def world(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def test_a_chart_that_leaves_staging_while_its_suites_run_is_refused(world: PublicationStage) -> None:
    packed = chart()
    world.runner.progress["install"] = SuiteProgress("running")
    number = world.submit(packed)
    world.gate.round()
    del world.registry.charts["staging/relay"][packed[0].digest]
    del world.runner.progress["install"]
    world.registry.before = lambda method: world.registry.pull_chart("staging/relay", packed[0].digest) and None
    assert f"staging/relay has no digest {packed[0].digest} any more; submit it again" in world.settle(number)
    assert not world.merged(number)


def test_what_the_publisher_takes_away_once_it_is_tried_is_published(world: PublicationStage) -> None:
    packed = chart()
    world.runner.progress["install"] = SuiteProgress("running")
    number = world.submit(packed)
    world.gate.round()
    del world.registry.charts["staging-publisher/relay"]
    world.start()  # nor does another gate need it
    world.gate.round()
    world.runner.progress.clear()
    world.settle(number)
    assert world.merged(number)
    assert {request.repository for request in world.runner.requests} == {"staging/relay"}


def test_a_chart_that_its_publisher_took_away_before_it_was_tried_is_refused(world: PublicationStage) -> None:
    packed = chart()
    world.registry.push_chart("staging-somebody", packed[0])  # of another publisher
    number = world.submit(packed, push=False)
    text = world.settle(number)
    assert f"staging-publisher/relay has no digest {packed[0].digest}; submit it again" in text
    assert "and write no tag twice" in text
    assert not world.merged(number)


def test_a_chart_that_is_not_that_of_its_entry_does_not_get_into_staging(world: PublicationStage) -> None:
    packed, spec = chart()
    number = world.submit((packed, {**spec, "description": "another entry"}))
    assert "was packed with another entry" in world.settle(number)
    assert "staging/relay" not in world.registry.charts


def test_what_was_pushed_to_staging_before_publishers_had_places_is_published(world: PublicationStage) -> None:
    packed = chart()
    world.registry.push_chart("staging", packed[0], "0.1.0")
    number = world.submit(packed, push=False)
    world.settle(number)
    assert world.merged(number)


@pytest.mark.parametrize("when", ["before", "while"])
def test_attachments_in_staging_that_cannot_be_read_are_refused(
    world: PublicationStage, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """Publishers wrote the tag in which attachments are listed before they had places of their own."""
    attachments = world.registry.attachments

    def broken(repository: str, subject: str) -> Sequence[Attachment]:
        if repository.startswith("staging/"):
            raise InputError("no index of at most 256 artefacts")
        return attachments(repository, subject)

    def attaching(method: str) -> None:
        if method == "attach":
            broken("staging/relay", "")

    if when == "before":
        monkeypatch.setattr(world.registry, "attachments", broken)
    world.runner.progress["install"] = SuiteProgress("running")
    packed = chart()
    number = world.submit(packed)
    world.gate.round()
    monkeypatch.setattr(world.registry, "attachments", broken)
    world.registry.before = attaching
    world.runner.progress.clear()
    text = world.settle(number)
    assert "cannot be read: no index of at most 256 artefacts" in text
    assert f"delete the tag sha256-{packed[0].digest[7:]} of staging/relay" in text
    assert not world.merged(number)


OWN_DIGEST = f"sha256:{'5' * 64}"
OWN_IMAGE = f"forge.invalid/own-images/relay@{OWN_DIGEST}"


def submit_with_own_image(world: PublicationStage) -> int:
    packed, spec = chart(image=OWN_IMAGE)
    return world.submit((packed, spec), **{entry_path(packed): entry(packed, spec, images=[OWN_IMAGE])})


def test_an_own_image_is_copied_with_its_bill_to_where_nodes_pull_it(world: PublicationStage) -> None:
    place = "staging-publisher/images/relay"
    world.registry.images[place] = {OWN_DIGEST}
    world.registry.attach(place, OWN_DIGEST, BILL_TYPE, b"a bill", {})
    world.registry.attach(place, OWN_DIGEST, "text/plain", b"anything else", {})
    number = submit_with_own_image(world)
    world.gate.round()
    assert world.registry.images["own-images/relay"] == {OWN_DIGEST}
    copied = world.registry.attachments("own-images/relay", OWN_DIGEST)
    assert [one.data for one in copied] == [b"a bill"]
    del world.registry.images[place]  # what its author deletes from now on changes nothing
    world.settle(number)
    assert world.merged(number)


def own_image(world: PublicationStage) -> set[str]:
    return world.registry.images["own-images/relay"]


def pushed(world: PublicationStage) -> None:
    """The image in its author's place, with a bill."""
    world.registry.images["staging-publisher/images/relay"] = {OWN_DIGEST}
    world.registry.attach("staging-publisher/images/relay", OWN_DIGEST, BILL_TYPE, b"a bill", {})


def test_the_image_of_a_refused_submission_is_removed_again(world: PublicationStage) -> None:
    pushed(world)
    world.runner.checks["static"] = (Check("a", False, "seen", "do"),)
    number = submit_with_own_image(world)
    world.settle(number)
    assert not world.merged(number)
    assert own_image(world) == set()
    assert world.registry.attachments("own-images/relay", OWN_DIGEST) == ()
    assert world.registry.images["staging-publisher/images/relay"] == {OWN_DIGEST}


def test_so_it_is_when_its_author_closes_it(world: PublicationStage) -> None:
    pushed(world)
    world.runner.progress["static"] = SuiteProgress("running")
    number = submit_with_own_image(world)
    world.gate.round()
    assert own_image(world) == {OWN_DIGEST}
    world.forge.close(number)
    world.gate.round()
    assert own_image(world) == set()


def test_what_a_published_version_has_stays(world: PublicationStage) -> None:
    pushed(world)
    world.settle(submit_with_own_image(world))
    world.runner.checks["static"] = (Check("a", False, "seen", "do"),)
    packed, spec = chart(version="0.2.0", image=OWN_IMAGE)
    number = world.submit((packed, spec), **{entry_path(packed): entry(packed, spec, images=[OWN_IMAGE])})
    world.settle(number)
    assert not world.merged(number)
    assert own_image(world) == {OWN_DIGEST}


def test_what_another_open_submission_has_stays_until_that_is_decided(world: PublicationStage) -> None:
    pushed(world)
    world.runner.progress["static"] = SuiteProgress("running")
    first = submit_with_own_image(world)
    packed, spec = chart(version="0.2.0", image=OWN_IMAGE)
    second = world.submit((packed, spec), **{entry_path(packed): entry(packed, spec, images=[OWN_IMAGE])})
    world.gate.round()
    world.forge.close(first)
    world.gate.round()
    assert own_image(world) == {OWN_DIGEST}
    world.forge.close(second)
    world.gate.round()
    assert own_image(world) == set()


def test_a_registry_that_is_away_is_asked_again(world: PublicationStage) -> None:
    pushed(world)
    world.runner.progress["static"] = SuiteProgress("running")
    number = submit_with_own_image(world)
    world.gate.round()

    def away(method: str) -> None:
        if method == "remove_image":
            raise UnavailableError("no answer")

    world.registry.before = away
    world.forge.close(number)
    world.gate.round()
    assert own_image(world) == {OWN_DIGEST}
    world.registry.before = lambda method: None
    world.gate.round()
    assert own_image(world) == set()


def test_an_own_image_that_is_nowhere_is_refused_in_words(world: PublicationStage) -> None:
    text = world.settle(submit_with_own_image(world))
    assert f"image relay: staging-publisher/images/relay has no digest {OWN_DIGEST}; push it" in text
    assert world.runner.requests == []
