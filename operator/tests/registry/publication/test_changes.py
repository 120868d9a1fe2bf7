"""People's changes of the catalogue: merged by the gate when another person approved exactly what it checked."""

from dataclasses import replace
from pathlib import Path

import pytest

from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS
from robotkube.foundation.forge.core.reviews import Review
from tests.stages.registry.publication_in_memory import PublicationStage
from tests.stages.registry.submissions import CATALOGUE, application, chart, entry_path

RELEASE = "policies/release.yaml"
OPEN = {RELEASE: "assurance: verified\ninitialFor: automatic\n"}


@pytest.fixture
def world(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def propose(
    world: PublicationStage, changes: dict[str, str | None], parent: str = "", author: str = "operator-team"
) -> int:
    return world.forge.open(world.catalogue.commit(parent or world.catalogue.tip, changes, "By hand"), author)


def approve(world: PublicationStage, number: int, account: str = "reviewer", approved: bool = True) -> None:
    review = Review(account, world.forge.pulls[number].head, approved, True)
    world.forge.reviewed.setdefault(number, []).append(review)


def rounds(world: PublicationStage) -> str:
    """What the gate has said after it looked twice."""
    number = max(world.forge.pulls)
    for _ in range(2):
        world.now += RESYNC_SECONDS
        world.gate.round()
    world.forge.pull_requests("all")
    return "\n".join(comment.text for comment in world.forge.said[number])


def test_a_policy_waits_for_another_person_and_is_merged_with_who_approved_it(world: PublicationStage) -> None:
    tip = world.catalogue.tip
    number = propose(world, dict(OPEN))
    text = rounds(world)
    assert text.startswith(f"Checked {world.forge.pulls[number].head[:12]}: nothing speaks against it.")
    assert "when another person with write rights, who is no publisher, approves it" in text
    for account in ("operator-team", "publisher", "gate"):
        approve(world, number, account)
    rounds(world)
    assert (world.catalogue.tip, world.merged(number)) == (tip, False)
    approve(world, number)
    assert rounds(world) == text
    assert world.merged(number)
    newest = world.catalogue.commits[world.catalogue.tip]
    assert newest.parents == (tip, world.forge.pulls[number].head)
    assert (newest.author, newest.changes) == ("operator-team", OPEN)
    assert newest.message.endswith(f"RobotKube-Pull-Request: {number}\nRobotKube-Approved-By: reviewer\n")
    assert world.published == 1


def test_somebody_against_it_and_another_head_hold_it(world: PublicationStage) -> None:
    tip, number = world.catalogue.tip, propose(world, dict(OPEN))
    approve(world, number)
    approve(world, number, "third", approved=False)
    rounds(world)
    assert world.catalogue.tip == tip
    approve(world, number, "third")
    world.forge.update(number, world.catalogue.commit(tip, {RELEASE: "assurance: none\n"}, "Another"))
    rounds(world)
    assert world.catalogue.tip == tip
    approve(world, number)
    rounds(world)
    assert world.main()[RELEASE] == "assurance: none\n"


REFUSED = {
    "a wrong policy": ({RELEASE: "assurance: perhaps\n"}, f"{RELEASE}: "),
    "no policy": ({RELEASE: None}, f"{RELEASE}: file: missing; write it"),
    "a wrong application": ({"applications/relaying.yaml": "a: ["}, "applications/relaying.yaml: "),
    "a chart that nobody verified": (
        {"charts/relay/9.0.0.yaml": "status: {state: verified}\n"},
        "charts/relay/9.0.0.yaml: the gate alone adds chart versions; submit it (robotkube registry submit)",
    ),
    "evidence": (
        {"evidence/relay/x/static.json": "{}"},
        "evidence/relay/x/static.json: the gate alone writes this file",
    ),
    "a key": ({"keys/mine.pem": "x"}, "keys/mine.pem: the gate alone writes this file"),
    "a schema": ({"charts/relay/0.1.0.schema.json": "{}"}, "0.1.0.schema.json: the gate alone writes this file"),
    "who may break the glass": (
        {"policies/signers": "anna ssh-ed25519 AAAA\n"},
        "policies/signers: break-glass is for the deployment repository, where it stands out afterwards; leave it out",
    ),
    "nothing": ({}, "the pull request changes nothing"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused_stays_refused_whoever_approves_it(world: PublicationStage, case: str) -> None:
    changes, words = REFUSED[case]
    world.settle(world.submit(chart()))
    tip, number = world.catalogue.tip, propose(world, dict(changes))
    approve(world, number)
    text = rounds(world)
    assert f"Checked {world.forge.pulls[number].head[:12]}: it cannot be merged." in text
    assert words in text
    assert "Main moves by the gate alone, so nobody can merge it" in text
    assert text.count("Checked ") == 1
    assert world.catalogue.tip == tip


def test_a_version_is_withdrawn_and_brought_back_and_nothing_else_of_it_changes(world: PublicationStage) -> None:
    packed = chart()
    world.settle(world.submit(packed))
    path = entry_path(packed[0])
    published = world.main()[path]
    document = read_mapping(published, path)

    def with_status(**changes: object) -> str:
        return write_mapping({**document, "status": {**document["status"], **changes}})

    for wrong in (
        with_status(state="staged"),
        with_status(digest="sha256:" + "0" * 64),
        with_status(images=[]),
        write_mapping({**document, "spec": {**document["spec"], "images": []}}),
        "a: [",
    ):
        approve(world, propose(world, {path: wrong}))
        assert "a person changes status.state of a published version, to withdrawn or back to verified" in rounds(world)
        assert world.main()[path] == published
    for text in (with_status(state="withdrawn"), published):
        number = propose(world, {path: text})
        approve(world, number)
        rounds(world)
        assert world.merged(number)
        assert world.main()[path] == text


def test_a_version_may_be_taken_away(world: PublicationStage) -> None:
    packed = chart()
    world.settle(world.submit(packed))
    gone = [path for path in world.main() if path.startswith(("charts/", "evidence/"))]
    approve(world, propose(world, dict.fromkeys(gone)))
    rounds(world)
    assert not [path for path in world.main() if path.startswith(("charts/", "evidence/"))]


def test_a_branch_behind_main_is_joined_where_main_left_its_files_alone(world: PublicationStage) -> None:
    base = world.catalogue.tip
    number = propose(world, dict(OPEN), base)
    other = propose(world, {"README.md": "mine\n"}, base)
    world.catalogue.push({"README.md": "theirs\n"})
    approve(world, number)
    approve(world, other)
    text = rounds(world)
    assert world.merged(number)
    assert not world.merged(other)
    assert "it cannot be merged before its branch is updated." in text
    assert "README.md: main has changed this file as well" in text
    assert world.main() == {**world.main(), **OPEN, "README.md": "theirs\n"}


def test_when_main_moves_meanwhile_it_is_joined_anew(world: PublicationStage) -> None:
    number = propose(world, dict(OPEN))
    approve(world, number)
    calls = iter([True])

    def move() -> None:
        if next(calls, False):
            world.catalogue.push({"README.md": "theirs\n"})

    world.catalogue.before_push = move
    rounds(world)
    assert world.merged(number)
    assert world.main()["README.md"] == "theirs\n"


@pytest.mark.parametrize("error", [UnavailableError("away"), RuntimeError("a mistake in the gate")])
def test_one_that_fails_holds_up_no_other_and_no_submission(world: PublicationStage, error: Exception) -> None:
    bad, good = propose(world, dict(OPEN)), propose(world, {"README.md": "better\n"})
    approve(world, bad)
    approve(world, good)
    reviews = world.forge.reviews

    def failing(number: int) -> object:
        if number == bad:
            raise error
        return reviews(number)

    world.forge.reviews = failing  # type: ignore[assignment, method-assign]
    submitted = world.submit(**{"applications/relaying.yaml": application("relaying")})
    rounds(world)
    assert world.merged(good)
    assert not world.merged(bad)
    assert world.forge.pulls[submitted].state == "closed"


def test_publishers_and_the_gate_itself_go_other_ways(world: PublicationStage) -> None:
    for author in ("publisher", "gate"):
        number = propose(world, dict(OPEN), author=author)
        approve(world, number)
        rounds(world)
        assert not world.merged(number)
        assert world.main()[RELEASE] == CATALOGUE[RELEASE]
        world.forge.pulls[number] = replace(world.forge.pulls[number], state="closed")


def test_a_gate_that_starts_again_says_nothing_twice(world: PublicationStage) -> None:
    propose(world, dict(OPEN))
    text = rounds(world)
    world.start()
    assert rounds(world) == text


def test_a_webhook_brings_it_forward(world: PublicationStage) -> None:
    number = propose(world, dict(OPEN))
    rounds(world)
    approve(world, number)
    world.gate.round()
    assert not world.merged(number)
    world.gate.wake("pull_request", {"action": "reviewed", "repository": {"full_name": "robotkube/catalogue"}})
    world.gate.round()
    world.forge.pull_requests("all")
    assert world.merged(number)
