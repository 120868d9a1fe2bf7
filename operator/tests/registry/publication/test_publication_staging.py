"""What the publication loop tries: copied from the publisher's place to staging, where no publisher writes."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from robotkube.errors import InputError
from robotkube.registry.charts.ports import Attachment
from robotkube.registry.suites.core.requests import SuiteProgress
from tests.stages.registry.publication_in_memory import PublicationStage
from tests.stages.registry.submissions import chart


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
