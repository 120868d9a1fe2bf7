"""Commits of main that the gate did not check: told apart, found again, and standing until they are made good. On real
repositories."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pygit2
import pytest

from robotkube.delivery.deployment.adapters.ssh_keys import holds
from robotkube.delivery.deployment.core.break_glass import ACCEPTED_PATH, SIGNERS_PATH
from robotkube.delivery.deployment.core.merge_records import REFERENCE, MergeRecord, record_statement
from robotkube.delivery.deployment.core.unchecked_commits import (
    ACCEPTED,
    BREAK_GLASS,
    NO_RECORD,
    NOT_SIGNED,
    NOTHING_SIGNED,
    OTHERS_BEFORE,
    REPLACED,
)
from robotkube.delivery.deployment.loops import unchecked_commits
from robotkube.delivery.deployment.loops.unchecked_commits import RECHECK_SECONDS, Trust, UncheckedWatch
from robotkube.errors import UnavailableError
from robotkube.foundation.forge.adapters.git import GitClone
from tests.stages.delivery.audit.audited_platform import BEGAN, Repository
from tests.stages.delivery.gate.people import REPOSITORY, People
from tests.stages.registry.signed_evidence import signing_key, trusting

BOTH = ("ada", "grace")
X = "releases/a/x.yaml"


class Notes:
    """Port NoteTexts: the notes of the repository itself; `asked` counts, and `away` refuses."""

    def __init__(self, repository: Repository) -> None:
        self._repository = repository
        self.asked = 0
        self.away = False

    def texts(self, commits: Sequence[str]) -> Mapping[str, str]:
        self.asked += 1
        if self.away:
            raise UnavailableError("the forge is away")
        notes = {}
        for commit in commits:
            try:
                notes[commit] = self._repository.note(REFERENCE, commit).removesuffix("\n")
            except KeyError:
                continue
        return notes


class Main:
    """Main of a deployment repository that people and a gate write, and the watch on it."""

    def __init__(self, folder: Path, people: People) -> None:
        self.repository = Repository(folder / "deployment.git")
        self.people = people
        self.key = signing_key(folder / "key", 11)
        self.trusted = trusting(folder / "keys", self.key)
        self.clone = GitClone("", "", "", "", self.repository.folder, remote=False)
        self.notes = Notes(self.repository)
        self.now = 0.0
        self.recorded = ""
        self.repository.commit({SIGNERS_PATH: people.signers(*BOTH), X: "1", "README.md": "1"}, "seed\n", BEGAN)
        self.watch = self.watching()

    @property
    def tip(self) -> str:
        return self.repository.tip

    def watching(self) -> UncheckedWatch:
        return UncheckedWatch(self.clone, self.notes, Trust(REPOSITORY, self.trusted, holds), lambda: self.now)

    def add(self, changes: Mapping[str, str | None], message: str = "no words\n") -> str:
        """A commit that nobody checked."""
        return self.repository.commit(changes, message, BEGAN)

    def record(self, commit: str, previous: str = "", seed: int = 11) -> None:
        """The gate's record of a commit."""
        before = previous or str(self.repository.git[commit].parent_ids[0])
        time = "2026-11-18T12:00:00Z"
        record = MergeRecord(commit, before, "manager", "automatic", "7", (), time, "", "", self.recorded)
        key = signing_key(self.repository.folder.parent / f"key-{seed}", seed)
        self.repository.write_note(REFERENCE, commit, key.sign(record_statement(record, "http://f/d", "gate")).decode())
        self.recorded = str(self.repository.git.references[REFERENCE].target)

    def merge(self, changes: Mapping[str, str | None]) -> str:
        """A commit that the gate merged and signed for."""
        commit = self.add(changes, "checked\n")
        self.record(commit)
        return commit

    def glass(self, changes: Mapping[str, str | None], *names: str, **edits: Callable[[str], str]) -> str:
        """A commit that these people signed; `edits` change its message afterwards."""
        parent = self.tip
        made = self.repository.commit(changes, "x\n", BEGAN, move=False)
        tree = str(self.repository.git[made].tree_id)
        message = self.people.message(parent, tree, "the gate is away", *(names or BOTH))
        for edit in edits.values():
            message = edit(message)
        return self.repository.commit(changes, message, BEGAN)

    def standing(self) -> dict[str, tuple[str, tuple[str, ...]]]:
        """How and with which files commits stand, for the watch and for one that begins now."""
        self.now += RECHECK_SECONDS
        self.watch.read()
        again = self.watching()
        again.read()
        assert (again.standing, again.made_good) == (self.watch.standing, self.watch.made_good)
        return {one.commit: (one.how, one.files) for one in self.watch.standing}

    def made_good(self) -> dict[str, str]:
        """How commits that stand no more were made good, as of the last reading."""
        assert not [one.files for one in self.watch.made_good if one.files]
        return {one.commit: one.made_good for one in self.watch.made_good}

    def problem(self) -> str:
        """Why the one commit that stands is not what it says, or has no record."""
        self.standing()
        [one] = self.watch.standing
        return one.problem


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> People:
    return People(tmp_path_factory.mktemp("keys")).add(*BOTH, "mallory")


@pytest.fixture
def main(tmp_path: Path, people: People) -> Main:
    return Main(tmp_path, people)


def test_what_the_gate_signed_for_does_not_stand(main: Main) -> None:
    main.merge({X: "2"})
    main.merge({"README.md": "2"})
    assert main.standing() == {}
    assert (main.watch.before_records, main.watch.problem, main.watch.unrecorded) == (0, "", False)


def test_the_three_kinds_are_told_apart(main: Main) -> None:
    main.merge({X: "2"})
    first = main.glass({"a": "1"})
    second = main.add({"b": "1"}, "deploy(recording): looks like a plan\n\nRobotKube-Plan: 20261118-120000-000001\n")
    third = main.glass({"c": "1"}, edit=lambda text: text.replace("the gate is away", "another reason"))
    assert main.standing() == {
        third: (NOT_SIGNED, ("c",)),
        second: (NO_RECORD, ("b",)),
        first: (BREAK_GLASS, ("a",)),
    }
    glass = main.watch.standing[2]
    assert (glass.names, glass.time, glass.reason) == (BOTH, "2026-11-24T12:00:00Z", "the gate is away")
    assert main.watch.standing[1].reason == "deploy(recording): looks like a plan"
    assert main.watch.unrecorded


def of(words: str, *names: str, **edits: Callable[[str], str]) -> tuple[str, tuple[str, ...], dict[str, object]]:
    return words, names, dict(edits)


def swapped(text: str) -> str:
    """Each with the other one's signature."""
    head, first, second, _ = text.rsplit("\n", 3)
    names = [line.split(" ")[1] for line in (first, second)]
    others = [line.split(" ")[2] for line in (second, first)]
    return "\n".join([head, *(f"RobotKube-Signed-By: {n} {s}" for n, s in zip(names, others, strict=True)), ""])


NOT_OVER = "is not over this commit, its parent, time and reason"
CLAIMS = {
    "nobody": of("signed by 0 of the people in policies/signers; 2 different ones are needed",
                 none=lambda text: text.split("RobotKube-Signed-By")[0]),
    "one person": of("signed by 1 of the people in policies/signers; 2 different ones are needed", "ada"),
    "one person twice": of("signed by 1 of the people", "ada",
                           twice=lambda text: text + text.split("\n")[3] + "\n"),
    "a stranger": of("mallory is none of the people in policies/signers of the last checked commit before it",
                     "ada", "mallory"),
    "words": of(f"what stands there as the signature of ada {NOT_OVER}",
                texts=lambda text: "\n".join([*text.split("\n")[:3], "RobotKube-Signed-By: ada AAAA", ""])),
    "exchanged": of(f"what stands there as the signature of ada {NOT_OVER}", exchanged=swapped),
    "another time": of(NOT_OVER, time=lambda text: text.replace("12:00:00Z", "12:00:01Z")),
    "the trailer alone": of("its message is not as `robotkube break-glass sign` writes it",
                            alone=lambda _: "Words\n\nMore words\nRobotKube-Break-Glass: now\n"),
    "more trailers": of("its message is not as", more=lambda text: f"{text}RobotKube-Plan: 20261118-120000-000001\n"),
}  # fmt: skip


@pytest.mark.parametrize("claim", CLAIMS)
def test_who_only_says_that_it_is_break_glass_is_told_why_not(main: Main, claim: str) -> None:
    words, names, edits = CLAIMS[claim]
    main.merge({X: "2"})
    main.glass({"a": "1"}, *names, **edits)  # type: ignore[arg-type]
    assert words in main.problem()
    assert main.watch.standing[0].how == NOT_SIGNED


def test_signatures_of_another_commit_are_none(main: Main) -> None:
    """Of other files, and of another tip: a signature that was given once is not used again."""
    main.merge({X: "2"})
    message = main.repository.git[main.glass({"a": "1"})].message
    main.add({"a": "2"}, message)
    assert NOT_OVER in main.problem()


def test_a_merge_and_a_change_of_who_signs_are_not_let_through(main: Main) -> None:
    first = main.merge({X: "2"})
    main.glass({SIGNERS_PATH: main.people.signers("ada", "mallory")})
    assert main.problem() == "it changes policies/signers, which no such commit may"
    side = main.repository.commit({"a": "1"}, "side\n", BEGAN, move=False)
    message = main.people.message(first, str(main.repository.git[side].tree_id), "why", *BOTH)
    main.repository.commit({"a": "1"}, message, BEGAN, parents=[first, side])
    assert main.problem() == "it has 2 parents, and signatures are for one commit on main's tip"


def test_who_signs_is_whom_a_checked_commit_registered(main: Main) -> None:
    """Not whom somebody brought to main past the gate, also when it is taken back afterwards."""
    main.merge({X: "2"})
    forged = main.add({SIGNERS_PATH: main.people.signers("ada", "mallory")})
    signed = main.glass({"a": "1"}, "ada", "mallory")
    restored = main.add({SIGNERS_PATH: main.people.signers(*BOTH)})
    assert main.standing() == {restored: (NO_RECORD, (SIGNERS_PATH,)), signed: (NOT_SIGNED, ("a",))}
    assert forged not in main.standing()
    main.merge({SIGNERS_PATH: main.people.signers("ada", "mallory")})
    good = main.glass({"b": "1"}, "ada", "mallory")
    assert main.standing()[good] == (BREAK_GLASS, ("b",))


def test_a_record_that_does_not_hold_is_none_and_says_why(main: Main) -> None:
    first = main.merge({X: "2"})
    second = main.add({"a": "1"})
    main.record(second, seed=12)
    assert "which is not trusted here" in main.problem()
    main.repository.write_note(REFERENCE, second, main.repository.note(REFERENCE, first))
    assert main.problem() == f"it is the record of {first}"
    main.repository.write_note(REFERENCE, second, "all was well")
    assert "no evidence" in main.problem() or "JSON" in main.problem()
    main.record(second)
    assert main.standing() == {}


def test_a_record_covers_what_came_with_its_commit(main: Main) -> None:
    first = main.merge({X: "2"})
    main.add({"a": "1"})
    last = main.add({"b": "1"})
    main.record(last, first)
    assert main.standing() == {}


def test_a_record_that_comes_later_is_seen_and_asked_for_now_and_then(main: Main) -> None:
    main.merge({X: "2"})
    commit = main.add({"a": "1"})
    assert main.standing() == {commit: (NO_RECORD, ("a",))}
    main.record(commit)
    asked = main.notes.asked
    assert not main.watch.read()
    assert main.notes.asked == asked  # not before its time
    assert main.standing() == {}


def test_what_the_gate_itself_merges_costs_no_question(main: Main) -> None:
    main.merge({X: "2"})
    main.watch.read()
    asked = main.notes.asked
    for number in range(3):
        main.watch.expect(main.add({"a": str(number)}))
        main.watch.read()
    assert (main.watch.standing, main.notes.asked) == ((), asked)
    other = main.add({"a": "other"})
    main.watch.expect(other)
    main.watch.drop(other)  # the gate has not moved main to it
    main.watch.read()
    assert [one.commit for one in main.watch.standing] == [other]


def test_a_forge_that_is_away_is_asked_again(main: Main) -> None:
    main.merge({X: "2"})
    main.watch.read()
    commit = main.add({"a": "1"})
    main.notes.away = True
    with pytest.raises(UnavailableError):
        main.watch.read()
    main.notes.away = False
    assert main.standing() == {commit: (NO_RECORD, ("a",))}


def test_commits_before_the_first_record_are_counted_and_all_records_gone_is_said(main: Main) -> None:
    main.add({X: "2"})
    main.add({X: "3"})
    assert main.standing() == {}
    assert (main.watch.before_records, main.watch.problem, main.watch.unrecorded) == (2, NOTHING_SIGNED, True)
    main.merge({X: "4"})
    assert main.standing() == {}
    assert (main.watch.before_records, main.watch.problem, main.watch.unrecorded) == (2, "", False)
    main.merge({X: "5"})
    main.repository.remove_note(REFERENCE, main.repository.main()[-2])
    again = main.watching()
    again.read()
    assert (again.before_records, again.problem) == (3, OTHERS_BEFORE)


def test_a_main_that_was_rewritten_is_read_from_the_beginning(main: Main) -> None:
    """Also when its former tip stays, as another parent of a merge."""
    first = main.merge({X: "2"})
    former = main.glass({"a": "1"})
    main.standing()
    main.record(main.repository.commit({"b": "1"}, "merge\n", BEGAN, parents=[first, former]), first)
    assert main.standing() == {}
    main.repository.move(main.repository.main()[0])
    main.merge({"b": "1"})
    assert main.standing() == {}


# -- what stands -------------------------------------------------------------------------------------------------------


def test_it_stands_until_main_has_something_else_in_its_place(main: Main) -> None:
    main.merge({X: "1", "policies/p.yaml": "1", "README.md": "1"})
    assert main.standing() == {}
    first = main.glass({X: "2", "policies/p.yaml": None, "README.md": "2"})
    assert main.standing() == {first: (BREAK_GLASS, ("README.md", "policies/p.yaml", X))}
    main.merge({"other": "1"})
    main.merge({X: "1"})
    assert main.standing() == {first: (BREAK_GLASS, ("README.md", "policies/p.yaml"))}
    second = main.add({"README.md": "3", "new": "1"})
    assert main.standing() == {
        second: (NO_RECORD, ("README.md", "new")),
        first: (BREAK_GLASS, ("policies/p.yaml",)),
    }
    main.merge({"policies/p.yaml": "1", "README.md": "4"})
    assert main.standing() == {second: (NO_RECORD, ("new",))}
    assert main.made_good() == {first: REPLACED}
    [gone] = main.watch.made_good
    assert (gone.how, gone.names, gone.reason) == (BREAK_GLASS, tuple(sorted(BOTH)), "the gate is away")
    main.merge({"new": None})
    assert main.standing() == {}
    assert main.made_good() == {second: REPLACED, first: REPLACED}


def test_what_is_right_as_it_is_is_accepted_by_its_id(main: Main) -> None:
    main.merge({"p": "1"})
    first = main.glass({X: None, "kept": "1"})
    second = main.add({"kept": "2"})
    main.merge({ACCEPTED_PATH: "not an id\n"})
    assert main.standing() == {second: (NO_RECORD, ("kept",)), first: (BREAK_GLASS, (X,))}
    main.merge({ACCEPTED_PATH: f"{first}\n{second}\n"})
    assert main.standing() == {}
    assert main.made_good() == {second: ACCEPTED, first: ACCEPTED}
    main.merge({ACCEPTED_PATH: f"{first}\n"})
    assert main.standing() == {second: (NO_RECORD, ("kept",))}
    assert main.made_good() == {first: ACCEPTED}, "who is taken off the list stands again"


def test_of_many_that_stand_no_more_the_newest_are_remembered(main: Main, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unchecked_commits, "MADE_GOOD_MAX", 2)
    main.merge({"p": "1"})
    commits = [main.add({"p": str(number)}) for number in range(2, 6)]
    assert set(main.standing()) == {commits[-1]}
    assert main.made_good() == dict.fromkeys(commits[1:3], REPLACED)


def test_one_that_is_too_large_to_compare_stands_until_it_is_accepted(main: Main) -> None:
    main.merge({X: "2"})
    many: dict[str, str | None] = {f"releases/a/{number}.yaml": "1" for number in range(1001)}
    first = main.glass({**many, "kept": "1"})
    second = main.glass({"kept": "2"})
    everything = (BREAK_GLASS, (f"everything of {first[:12]}",))
    assert main.standing() == {second: (BREAK_GLASS, ("kept",)), first: everything}
    main.merge({**dict.fromkeys(many), "kept": "3"})
    assert main.standing() == {first: everything}
    main.merge({ACCEPTED_PATH: f"{first}\n"})
    assert main.standing() == {}


def test_the_shape_of_a_commit_is_what_signatures_are_about(main: Main) -> None:
    commit = main.glass({"a": "1"})
    shape = main.clone.shape(commit)
    git_commit = main.repository.git[commit].peel(pygit2.Commit)
    assert shape.parents == tuple(map(str, git_commit.parent_ids))
    assert shape.tree == str(git_commit.tree_id)
