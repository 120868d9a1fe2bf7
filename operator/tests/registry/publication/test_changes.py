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
def stage(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def propose(
    stage: PublicationStage, changes: dict[str, str | None], parent: str = "", author: str = "operator-team"
) -> int:
    return stage.forge.open(stage.catalogue.commit(parent or stage.catalogue.tip, changes, "By hand"), author)


def approve(stage: PublicationStage, number: int, account: str = "reviewer", approved: bool = True) -> None:
    review = Review(account, stage.forge.pulls[number].head, approved, True)
    stage.forge.reviewed.setdefault(number, []).append(review)


def rounds(stage: PublicationStage) -> str:
    """What the gate has said after it looked twice."""
    number = max(stage.forge.pulls)
    for _ in range(2):
        stage.now += RESYNC_SECONDS
        stage.gate.round()
    stage.forge.pull_requests("all")
    return "\n".join(comment.text for comment in stage.forge.said[number])


def test_a_policy_waits_for_another_person_and_is_merged_with_who_approved_it(stage: PublicationStage) -> None:
    tip = stage.catalogue.tip
    number = propose(stage, dict(OPEN))
    text = rounds(stage)
    assert text.startswith(f"Checked {stage.forge.pulls[number].head[:12]}: nothing speaks against it.")
    assert "when another person with write rights, who is no publisher, approves it" in text
    for account in ("operator-team", "publisher", "gate"):
        approve(stage, number, account)
    rounds(stage)
    assert (stage.catalogue.tip, stage.merged(number)) == (tip, False)
    approve(stage, number)
    assert rounds(stage) == text
    assert stage.merged(number)
    newest = stage.catalogue.commits[stage.catalogue.tip]
    assert newest.parents == (tip, stage.forge.pulls[number].head)
    assert (newest.author, newest.changes) == ("operator-team", OPEN)
    assert newest.message.endswith(f"RobotKube-Pull-Request: {number}\nRobotKube-Approved-By: reviewer\n")
    assert stage.published == 1


def test_somebody_against_it_and_another_head_hold_it(stage: PublicationStage) -> None:
    tip = stage.catalogue.tip
    number = propose(stage, dict(OPEN))
    approve(stage, number)
    approve(stage, number, "third", approved=False)
    rounds(stage)
    assert stage.catalogue.tip == tip
    approve(stage, number, "third")
    stage.forge.update(number, stage.catalogue.commit(tip, {RELEASE: "assurance: none\n"}, "Another"))
    rounds(stage)
    assert stage.catalogue.tip == tip
    approve(stage, number)
    rounds(stage)
    assert stage.main()[RELEASE] == "assurance: none\n"


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
def test_what_is_refused_stays_refused_whoever_approves_it(stage: PublicationStage, case: str) -> None:
    changes, words = REFUSED[case]
    stage.settle(stage.submit(chart()))
    tip = stage.catalogue.tip
    number = propose(stage, dict(changes))
    approve(stage, number)
    text = rounds(stage)
    assert f"Checked {stage.forge.pulls[number].head[:12]}: it cannot be merged." in text
    assert words in text
    assert "Main moves by the gate alone, so nobody can merge it" in text
    assert text.count("Checked ") == 1
    assert stage.catalogue.tip == tip


def test_a_version_is_withdrawn_and_brought_back_and_nothing_else_of_it_changes(stage: PublicationStage) -> None:
    packed = chart()
    stage.settle(stage.submit(packed))
    path = entry_path(packed[0])
    published = stage.main()[path]
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
        approve(stage, propose(stage, {path: wrong}))
        assert "a person changes status.state of a published version, to withdrawn or back to verified" in rounds(stage)
        assert stage.main()[path] == published
    for text in (with_status(state="withdrawn"), published):
        number = propose(stage, {path: text})
        approve(stage, number)
        rounds(stage)
        assert stage.merged(number)
        assert stage.main()[path] == text


def test_a_version_may_be_taken_away(stage: PublicationStage) -> None:
    packed = chart()
    stage.settle(stage.submit(packed))
    gone = [path for path in stage.main() if path.startswith(("charts/", "evidence/"))]
    approve(stage, propose(stage, dict.fromkeys(gone)))
    rounds(stage)
    assert not [path for path in stage.main() if path.startswith(("charts/", "evidence/"))]


def test_a_branch_behind_main_is_joined_where_main_left_its_files_alone(stage: PublicationStage) -> None:
    base = stage.catalogue.tip
    number = propose(stage, dict(OPEN), base)
    other = propose(stage, {"README.md": "mine\n"}, base)
    stage.catalogue.push({"README.md": "theirs\n"})
    approve(stage, number)
    approve(stage, other)
    text = rounds(stage)
    assert stage.merged(number)
    assert not stage.merged(other)
    assert "it cannot be merged before its branch is updated." in text
    assert "README.md: main has changed this file as well" in text
    assert stage.main() == {**stage.main(), **OPEN, "README.md": "theirs\n"}


def test_when_main_moves_meanwhile_it_is_joined_anew(stage: PublicationStage) -> None:
    number = propose(stage, dict(OPEN))
    approve(stage, number)
    calls = iter([True])

    def move() -> None:
        if next(calls, False):
            stage.catalogue.push({"README.md": "theirs\n"})

    stage.catalogue.before_push = move
    rounds(stage)
    assert stage.merged(number)
    assert stage.main()["README.md"] == "theirs\n"


@pytest.mark.parametrize("error", [UnavailableError("away"), RuntimeError("a mistake in the gate")])
def test_one_that_fails_holds_up_no_other_and_no_submission(stage: PublicationStage, error: Exception) -> None:
    bad, good = propose(stage, dict(OPEN)), propose(stage, {"README.md": "better\n"})
    approve(stage, bad)
    approve(stage, good)
    reviews = stage.forge.reviews

    def failing(number: int) -> object:
        if number == bad:
            raise error
        return reviews(number)

    stage.forge.reviews = failing  # type: ignore[assignment, method-assign]
    submitted = stage.submit(**{"applications/relaying.yaml": application("relaying")})
    rounds(stage)
    assert stage.merged(good)
    assert not stage.merged(bad)
    assert stage.forge.pulls[submitted].state == "closed"


def test_publishers_and_the_gate_itself_go_other_ways(stage: PublicationStage) -> None:
    for author in ("publisher", "gate"):
        number = propose(stage, dict(OPEN), author=author)
        approve(stage, number)
        rounds(stage)
        assert not stage.merged(number)
        assert stage.main()[RELEASE] == CATALOGUE[RELEASE]
        stage.forge.pulls[number] = replace(stage.forge.pulls[number], state="closed")


def test_a_gate_that_starts_again_says_nothing_twice(stage: PublicationStage) -> None:
    propose(stage, dict(OPEN))
    text = rounds(stage)
    stage.start()
    assert rounds(stage) == text


def test_a_webhook_brings_it_forward(stage: PublicationStage) -> None:
    number = propose(stage, dict(OPEN))
    rounds(stage)
    approve(stage, number)
    stage.gate.round()
    assert not stage.merged(number)
    stage.gate.wake("pull_request", {"action": "reviewed", "repository": {"full_name": "robotkube/catalogue"}})
    stage.gate.round()
    stage.forge.pull_requests("all")
    assert stage.merged(number)
