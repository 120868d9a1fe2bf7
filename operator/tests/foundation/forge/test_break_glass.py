"""Break-glass on a real forge whose gate is away: main takes what two registered people have signed just now, nothing
else."""

import json
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pygit2
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from robotkube.cli import main as cli
from robotkube.cli import status
from robotkube.delivery.deployment.adapters.ssh_keys import sign
from robotkube.delivery.deployment.core.break_glass import (
    ACCEPTED_PATH,
    PUSH_OPTION,
    SIGNERS_PATH,
    TIME_FORMAT,
    EmergencyChange,
)
from robotkube.delivery.deployment.core.merge_records import REFERENCE
from robotkube.delivery.gate.adapters.merge_journal import FileJournal
from robotkube.delivery.gate.loops.merge_records import MergeRecorder
from robotkube.delivery.gate.loops.unchecked_report import UncheckedCounts
from robotkube.foundation.forge.adapters.git import GitClone, GitNotes
from tests.stages.attacks import shown
from tests.stages.forge.catalogue_evidence import gate_key, key_folder
from tests.stages.forge.installation import (
    ApplicationSetController,
    Clone,
    Installation,
    message,
    release_files,
    start_gate,
)
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

MAIN = "refs/heads/main"
REPOSITORY = "robotkube/deployment"
PEOPLE = ("operator-team", "reviewer")
EDITS = {"policies/edits.yaml": "edits: respect\n"}


@dataclass(frozen=True)
class People:
    """Keys of people, by name, in OpenSSH's files; `signers` is what main has."""

    folder: Path
    signers: str

    def sign(self, name: str, change: EmergencyChange) -> str:
        return sign(self.folder / name, change.statement, str)[1]


def make_people(folder: Path, registered: tuple[str, ...], *others: str) -> People:
    """A key for each; only the first ones are registered."""
    lines = ["# who may break the glass"]
    for name in (*registered, *others):
        key = Ed25519PrivateKey.generate()
        text = key.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, NoEncryption())
        (folder / name).write_bytes(text)
        public = key.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH).decode()
        lines += [f"{name.removesuffix('-2')} {public} of {name}"] if name in registered else []
    return People(folder, "\n".join([*lines, ""]))


@pytest.fixture(scope="module")
def people(own_installation: Installation, tmp_path_factory: pytest.TempPathFactory) -> People:
    made = make_people(tmp_path_factory.mktemp("keys"), (*PEOPLE, "operator-team-2"), "stranger", "manager")
    for repository in (REPOSITORY, "robotkube/catalogue"):
        gate = own_installation.clone("gate", repository)
        commit = gate.commit({SIGNERS_PATH: made.signers}, "signers\n", [gate.tip()])
        assert gate.push(commit, MAIN) == ""
    return made


@pytest.fixture
def person(own_installation: Installation) -> Clone:
    return own_installation.clone("operator-team")


def now(**away: float) -> str:
    return (datetime.now(UTC) + timedelta(**away)).strftime(TIME_FORMAT)


def change_of(clone: Clone, commit: str, **other: Any) -> EmergencyChange:
    """The change that `commit` is, not signed yet."""
    changed = clone.repository[commit].peel(pygit2.Commit)
    parent = str(changed.parent_ids[0])
    return replace(EmergencyChange(REPOSITORY, parent, str(changed.tree_id), now(), "the gate is away", {}), **other)


def commit_of(clone: Clone, change: EmergencyChange, text: str = "", parents: tuple[str, ...] = ()) -> str:
    """The commit of a change as the command makes it; `text` in place of its message."""
    who = pygit2.Signature("anybody", "anybody@forge.invalid")
    ids = [pygit2.Oid(hex=parent) for parent in parents or (change.parent,)]
    return str(clone.repository.create_commit(None, who, who, text or change.message, pygit2.Oid(hex=change.tree), ids))


def signed(people: People, change: EmergencyChange, *names: str) -> EmergencyChange:
    for name in names or PEOPLE:
        change = change.signed_by(name, people.sign(name, change))
    return change


def glass(clone: Clone, people: People, files: dict[str, str | None] | None = None) -> str:
    """A commit that changes `files`, signed by both."""
    made = clone.commit(
        files or {"policies/edits.yaml": f"# {secrets.token_hex(4)}\nedits: respect\n"}, "x\n", [clone.tip()]
    )
    return commit_of(clone, signed(people, change_of(clone, made)))


def push(clone: Clone, commit: str, **more: Any) -> str:
    """Push to main with the option; what refused it, or empty."""
    return clone.push(commit, MAIN, [PUSH_OPTION], **more)


def test_main_takes_what_two_people_signed_and_not_twice(people: People, person: Clone) -> None:
    before = person.tip()
    commit = glass(person, people)
    assert push(person, commit) == ""
    assert person.tip() == commit
    replayed = commit_of(person, signed(people, change_of(person, commit)))
    assert "the commit's only parent must be main's tip" in push(person, replayed, force=True)
    again = person.commit({"policies/edits.yaml": "edits: revert\n"}, "x\n", [before])
    moved = commit_of(person, signed(people, change_of(person, again)), parents=(commit,))
    assert "is not over this commit, this tip" in push(person, moved)
    assert person.tip() == commit


Wrong = Callable[[People, Clone, EmergencyChange], str]


def of(**changes: Any) -> Wrong:
    return lambda people, clone, change: commit_of(clone, signed(people, replace(change, **changes)))


def of_time(**away: float) -> Wrong:
    """The change says a time so far from when the test runs, which may be long after the cases were collected."""
    return lambda people, clone, change: of(time=now(**away))(people, clone, change)


def by(*names: str) -> Wrong:
    return lambda people, clone, change: commit_of(clone, signed(people, change, *names))


def signed_then(**changes: Any) -> Wrong:
    """What stands in the commit is something else than what was signed."""
    return lambda people, clone, change: commit_of(clone, replace(signed(people, change), **changes))


def called(signer: str, name: str) -> Wrong:
    """The second signature is one of `signer` under another's name."""

    def make(people: People, clone: Clone, change: EmergencyChange) -> str:
        return commit_of(clone, signed(people, change, PEOPLE[0]).signed_by(name, people.sign(signer, change)))

    return make


def with_text(edit: Callable[[str], str]) -> Wrong:
    return lambda people, clone, change: commit_of(clone, change, edit(signed(people, change).message))


REFUSED: dict[str, tuple[Wrong, str]] = {
    "nobody": (lambda people, clone, change: commit_of(clone, change), "signed by 0 of the people"),
    "no statement": (with_text(lambda text: "just words\n"), "the message must be a reason, a blank line"),
    "one person": (by(PEOPLE[0]), "signed by 1 of the people in policies/signers; 2 different ones are needed"),
    "a stranger": (by(PEOPLE[0], "stranger"), '"stranger" is none of the people in policies/signers on main'),
    "a program": (by(PEOPLE[0], "manager"), '"manager" is none of the people'),
    "another's key": (called("stranger", PEOPLE[1]), "signature of reviewer: is not over this commit"),
    "the same key twice": (called(PEOPLE[0], PEOPLE[1]), "signature of reviewer: is not over this commit"),
    "both keys of one person": (
        lambda people, clone, change: commit_of(
            clone,
            change,
            "\n".join(
                [
                    *signed(people, change, PEOPLE[0]).message.rstrip("\n").split("\n"),
                    f"RobotKube-Signed-By: operator-team {people.sign('operator-team-2', change)}",
                    "",
                ]
            ),
        ),
        "signed by 1 of the people",
    ),
    "too old": (of_time(minutes=-16), "that is not within 15m0s; sign again"),
    "from the future": (of_time(minutes=5), "that is not within 15m0s; sign again"),
    "made fresh": (
        lambda people, clone, change: signed_then(time=now(minutes=-1))(people, clone, change),
        "is not over this commit",
    ),
    "another reason": (signed_then(reason="another"), "is not over this commit"),
    "another repository": (of(repository="robotkube/catalogue"), "is not over this commit"),
    "another tip": (of(parent="1" * 40), "is not over this commit"),
    "no time": (with_text(lambda text: text.replace("T", " ", 1)), "the message's first trailer must be"),
    "words after it": (
        with_text(lambda text: f"{text}more\n"),
        '"more" is no `RobotKube-Signed-By: <name> <signature>`',
    ),
    "words before it": (with_text(lambda text: f"more\n{text}"), "the message must be"),
    "a broken signature": (with_text(lambda text: text[:-10] + "\n"), "signature of reviewer: "),
}


@pytest.mark.parametrize("case", REFUSED)
def test_main_takes_nothing_else(people: People, person: Clone, case: str) -> None:
    make, words = REFUSED[case]
    tip = person.tip()
    change = change_of(person, person.commit(EDITS | {"policies/x.yaml": "a: 1\n"}, "x\n", [tip]))
    if case == "another tip":
        commit = commit_of(person, signed(people, replace(change, parent="1" * 40)), parents=(tip,))
    else:
        commit = make(people, person, change)
    refused = push(person, commit)
    assert words in refused
    assert "break-glass: " in refused
    assert person.tip() == tip


def test_other_files_than_those_that_were_signed(people: People, person: Clone) -> None:
    tip = person.tip()
    mine = change_of(person, person.commit(EDITS, "x\n", [tip]))
    theirs = change_of(person, person.commit({"policies/x.yaml": "a: 1\n"}, "x\n", [tip]))
    refused = push(person, commit_of(person, replace(signed(people, mine), tree=theirs.tree)))
    assert "is not over this commit" in refused
    assert person.tip() == tip


@pytest.mark.parametrize("path", [SIGNERS_PATH, ACCEPTED_PATH])
def test_what_decides_about_it_is_the_gates(people: People, person: Clone, path: str) -> None:
    tip = person.tip()
    commit = glass(person, people, {path: "# mine\n", **EDITS})
    assert f"{path} is changed by the gate alone; leave it out" in push(person, commit)
    if path == SIGNERS_PATH:
        assert "is changed by the gate alone" in push(person, glass(person, people, {path: None}))
    assert person.tip() == tip


def test_two_commits_a_merge_another_branch_and_no_option_are_refused(people: People, person: Clone) -> None:
    tip = person.tip()
    first = person.commit(EDITS, "not signed\n", [tip])
    second = change_of(person, person.commit({"policies/x.yaml": "a: 1\n"}, "x\n", [first]))
    assert "the commit's only parent must be main's tip" in push(person, commit_of(person, signed(people, second)))
    change = signed(people, change_of(person, first))
    merge = commit_of(person, change, parents=(tip, first))
    assert "the commit's only parent must be main's tip" in push(person, merge)
    commit = glass(person, people)
    shown("gate", person.push(commit, MAIN), "verifier-off")  # nobody is there who could merge
    assert "push refs/heads/main and nothing else" in person.push(commit, "refs/heads/mine", [PUSH_OPTION])
    assert "break-glass: main is neither made nor deleted" in delete_with_option(person)
    assert person.tip() == tip


def delete_with_option(clone: Clone) -> str:
    return clone._push(f":{MAIN}", [PUSH_OPTION])


@pytest.mark.parametrize("account", ["manager", "gate"])
def test_only_registered_people_push_it(own_installation: Installation, people: People, account: str) -> None:
    clone = own_installation.clone(account)
    tip = clone.tip()
    assert f'"{account}" is none of the people in policies/signers on main' in push(clone, glass(clone, people))
    assert clone.tip() == tip


def test_a_signed_commit_gets_in_by_no_other_way(own_installation: Installation, people: People, person: Clone) -> None:
    """The pages and the API of the forge do not take it: a branch or a pull request with it is not merged."""
    tip = person.tip()
    commit = glass(person, people)
    number = own_installation.propose(person, commit, own_installation.plan())
    client = own_installation.client("operator-team")
    for style in ("fast-forward-only", "rebase", "merge", "manually-merged"):
        body = {"Do": style, "MergeCommitID": commit}
        assert client.post(f"/pulls/{number}/merge", json=body).status_code == 405
    words = person.repository[commit].peel(pygit2.Commit).message
    content = {"content": "eA==", "message": words, "branch": "main"}
    assert client.post("/contents/x.txt", json=content).status_code in (403, 422)
    assert client.patch(f"/pulls/{number}", json={"state": "closed"}).status_code == 201
    assert person.tip() == tip


@pytest.mark.parametrize("signers", [None, "", "# nobody\n", "operator-team ssh-ed25519 {key}\n", "broken\n"])
def test_it_is_off_while_main_names_fewer_than_two_people(
    installation: Installation, tmp_path: Path, signers: str | None
) -> None:
    others = make_people(tmp_path, PEOPLE)
    gate = installation.clone("gate")
    key = others.signers.split("\n")[1].split()[2]
    if signers is not None:
        commit = gate.commit({SIGNERS_PATH: signers.replace("{key}", key)}, "signers\n", [gate.tip()])
        assert gate.push(commit, MAIN) == ""
    try:
        clone = installation.clone("operator-team")
        refused = push(clone, glass(clone, others))
        off = "policies/signers on main names fewer than 2 people: break-glass is off"
        assert (off if signers != "broken\n" else "policies/signers on main, line 1: must be `<name>") in refused
    finally:
        if signers is not None:
            commit = gate.commit({SIGNERS_PATH: None}, "no signers\n", [gate.tip()])
            assert gate.push(commit, MAIN) == ""


# -- the commands ------------------------------------------------------------------------------------------------------


def run(*words: str) -> int:
    return cli.main(list(words))


def test_two_people_do_it_by_command(
    own_installation: Installation,
    people: People,
    person: Clone,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    commit = person.commit({"policies/edits.yaml": "edits: revert\n"}, "Take the edits back\n", [person.tip()])
    file = str(tmp_path / "change.yaml")
    where = ("--repository", person.repository.path)
    forge = forge_options(own_installation, tmp_path, "operator-team")

    def sign_as(name: str, key: str, *more: str) -> int:
        return run("break-glass", "sign", file, "--as", name, "--key", str(people.folder / key), *where, *more)

    def push_as(name: str) -> int:
        return run("break-glass", "push", file, "--as", name, *where, *forge)

    assert sign_as("operator-team", "operator-team") == 2
    assert "is not there; begin it with --commit REVISION" in capfd.readouterr().err
    assert sign_as("operator-team", "stranger", "--commit", commit) == 1
    assert "is no key of 'operator-team' in policies/signers on main" in capfd.readouterr().err
    assert not Path(file).exists()
    assert sign_as("operator-team", "operator-team", "--commit", commit) == 0
    said = capfd.readouterr()
    assert "+edits: revert" in said.err
    assert "reason: Take the edits back" in said.out
    assert push_as("operator-team") == 1
    assert "signed by operator-team; 2 registered people are needed" in capfd.readouterr().err
    assert sign_as("reviewer", "reviewer") == 0
    assert "+edits: revert" in capfd.readouterr().err
    original = Path(file).read_text()
    Path(file).write_text(original.replace("Take the edits back", "Take the edits away"))
    assert push_as("operator-team") == 1
    assert "what operator-team, reviewer signed is not this change" in capfd.readouterr().err
    Path(file).write_text(original)
    assert push_as("publisher") == 1
    assert "'publisher' may not push it: policies/signers on main names " in capfd.readouterr().err
    assert push_as("operator-team") == 0
    assert (
        person.repository[person.tip()].peel(pygit2.Commit).message.startswith("Take the edits back\n\nRobotKube-Break")
    )
    tip = person.tip()
    assert push_as("operator-team") == 0  # the same commit
    reviewers = forge_options(own_installation, tmp_path, "reviewer")
    assert run("break-glass", "push", file, "--as", "reviewer", *where, *reviewers) == 1
    assert "that stands on it" in capfd.readouterr().err
    assert person.tip() == tip


def forge_options(installation: Installation, folder: Path, account: str) -> tuple[str, ...]:
    (folder / "password").write_text(installation.passwords[account])
    return ("--forge-url", installation.url, "--password-file", str(folder / "password"))


# -- the gate is back --------------------------------------------------------------------------------------------------


@pytest.fixture
def controller() -> Iterator[ApplicationSetController]:
    started = ApplicationSetController()
    yield started
    started.stop()


@pytest.fixture
def recorder(own_installation: Installation, tmp_path: Path) -> MergeRecorder:
    forge = (own_installation.url, REPOSITORY, "gate", own_installation.passwords["gate"], tmp_path / "records")
    return MergeRecorder(
        GitNotes(*forge, REFERENCE),
        GitClone(*forge),
        FileJournal(tmp_path / "merges"),
        gate_key(),
        f"{own_installation.url}/{REPOSITORY}",
        "robotkube-gate",
        now,
    )


def test_it_stands_out_until_a_checked_commit_has_replaced_it_or_accepted_it(
    own_installation: Installation,
    people: People,
    person: Clone,
    controller: ApplicationSetController,
    tmp_path: Path,
    recorder: MergeRecorder,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(status, "RECORD_SECONDS_MAX", 0.0)
    plan = own_installation.plan()
    release = release_files(plan, "by-hand")
    commit = glass(person, people, {**release, "policies/mine.yaml": "a: 1\n", "notes.txt": "x\n"})
    assert push(person, commit) == ""
    options = (*forge_options(own_installation, tmp_path, "argocd"), "--keys", str(key_folder()), "-o", "json")
    assert run("status", *options) == 1
    said = capfd.readouterr()
    assert (commit, "break-glass") in [(row["commit"], row["how"]) for row in json.loads(said.out)["unchecked"]]
    assert "let past the gate with people's signatures" in said.err
    assert "no commit of main has a valid record of the gate" in said.err  # it was away since the beginning
    running = start_gate(own_installation, controller.url, tmp_path / "gate", recorder=recorder)
    try:
        until(lambda: running.gate.statistics.unchecked.break_glass_commits >= 1, "the gate names it")
        assert f"break-glass stands commit={commit}" in caplog.text
        assert "signed_by=operator-team,reviewer" in caplog.text

        def files() -> int:
            return running.gate.statistics.unchecked.break_glass_files

        before = files()
        manager = own_installation.clone("manager")
        gone = own_installation.plan()
        removal = manager.commit(dict.fromkeys(release), message(gone, verb="withdraw"), [manager.tip()])
        number = own_installation.propose(manager, removal, gone)
        until(lambda: own_installation.pull_request(number)["merged"], "the manager's plan is merged")
        until(lambda: files() == before - len(release), "what the plan took away stands out no more")
        assert running.gate._unchecked is not None
        standing = [one.commit for one in running.gate._unchecked.watch.standing]
        accepted = person.commit({ACCEPTED_PATH: "\n".join([*standing, ""])}, "It was right\n", [person.tip()])
        number = own_installation.propose(person, accepted, own_installation.plan())
        review = {"event": "APPROVED", "commit_id": accepted, "body": "seen"}
        own_installation.client("reviewer").post(f"/pulls/{number}/reviews", json=review).raise_for_status()
        until(lambda: files() == 0, "nothing stands out")
        assert running.gate.statistics.unchecked == UncheckedCounts()
        told = running.gate.unchecked()["commits"]
        assert {one["made_good"] for one in told} <= {"accepted", "replaced"}
        assert ["operator-team", "reviewer"] in [one["signed_by"] for one in told]
        recorder.round()
        assert run("status", *options[:-2]) == 0
        assert "everything on it was checked by the gate, or has been replaced or accepted" in capfd.readouterr().out
        past = own_installation.clone("gate")  # as the forge's administrator could
        moved = past.commit({"notes.txt": "y\n"}, "deploy(recording): as a plan is\n", [past.tip()])
        assert past.push(moved, MAIN) == ""
        until(lambda: running.gate.statistics.unchecked.others["no-record"] == 1, "the gate names it, too")
        assert f"unchecked commit stands commit={moved} how=no-record files=notes.txt" in caplog.text
        shown("gate", caplog.text, "main-moved-past-the-gate")
    finally:
        running.stop()
    assert run("status", *options) == 1
    said = capfd.readouterr()
    assert [(row["commit"], row["how"]) for row in json.loads(said.out)["unchecked"]] == [(moved, "no-record")]
    assert "1 commit has no record of the gate: main was moved past it" in said.err
