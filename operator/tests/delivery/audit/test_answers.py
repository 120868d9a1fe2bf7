"""What the audit answers about a release, a task, a trace, a pod and a digest; and what it says of strange input."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pygit2
import pytest

from robotkube.delivery.audit.core.questions import release_of_pod
from robotkube.delivery.audit.core.report import seconds_text
from robotkube.delivery.deployment.core.merge_records import (
    OUTCOMES_REFERENCE,
    REFERENCE,
    MergeRecord,
    record_statement,
)
from robotkube.delivery.deployment.core.plan_notes import PlanOutcome, ReleaseOutcome, note_text
from robotkube.delivery.deployment.core.releases import Release
from robotkube.errors import InputError
from robotkube.foundation.forge.adapters.git import GitHistory, fetch_history
from tests.stages.delivery.audit.audited_platform import (
    BEGAN,
    MEETING,
    MINUTE,
    RECORDER,
    RECORDER_IMAGE,
    SEED_OF_GATE,
    Platform,
    Repository,
    files_of,
    found,
    message_of,
    plan_id,
    release,
)
from tests.stages.registry.signed_evidence import signing_key

COMMITS = 10_000
SECONDS_MAX = 120.0  # of the processor, for 10,000 commits, outcomes and records; 28 were measured


def releases(document: dict[str, Any]) -> list[str]:
    return [run["release"] for run in document["ran"]]


def commits(platform: Platform, document: dict[str, Any]) -> list[str]:
    """The commits of an answer by their names in the story."""
    names = {commit: name for name, commit in platform.names.items()}
    return [names[change["commit"]] for change in document["changes"]]


@pytest.mark.parametrize(
    ("word", "understood", "ran", "changed"),
    [
        ("cloud-0/recorder-a", ["release"], ["cloud-0/recorder-a"], ["recorder", "withdrawal"]),
        ("cloud-0/meeting", ["task"], ["cloud-0/recorder-a"], ["recorder", "withdrawal"]),
        ("a" * 32, ["trace"], ["cloud-0/recorder-a"], ["recorder", "withdrawal"]),
        ("event-2", ["event"], ["cloud-0/recorder-b"], ["second"]),
        (plan_id(4), ["plan"], [], ["withdrawal"]),
        ("cloud-0/recorder-b-758c5bc65c-bglft", ["pod"], ["cloud-0/recorder-b"], ["second"]),
        ("recorder-b-758c5bc65c-bglft", ["pod"], ["cloud-0/recorder-b"], ["second"]),
        (
            RECORDER.digest,
            ["chart digest"],
            ["cloud-0/recorder-a", "cloud-0/recorder-b"],
            ["recorder", "withdrawal", "second"],
        ),
        (
            RECORDER_IMAGE.partition("@")[2],
            ["image digest"],
            ["cloud-0/recorder-a", "cloud-0/recorder-b"],
            ["recorder", "withdrawal", "second"],
        ),
    ],
)
def test_a_question_is_answered(
    clean: Platform, word: str, understood: list[str], ran: list[str], changed: list[str]
) -> None:
    document = clean.audit(word)
    assert document["understood_as"] == understood
    assert (releases(document), commits(clean, document)) == (ran, changed)


def test_evidence_and_commits_can_be_asked_for(clean: Platform) -> None:
    evidence = clean.audit(clean.names["evidence of bridge"])
    assert (evidence["understood_as"], releases(evidence)) == (["evidence digest"], ["vehicle-00/mqtt-bridge"])
    for word in (RECORDER.digest[:19], RECORDER.digest.partition(":")[2][:12]):  # as tables shorten it
        document = clean.audit(word)
        assert (document["understood_as"], releases(document)) == (
            ["chart digest"],
            ["cloud-0/recorder-a", "cloud-0/recorder-b"],
        )
    image = RECORDER_IMAGE.partition("@sha256:")[2][:12]
    assert clean.audit(image)["understood_as"] == ["image digest"]
    commit = clean.names["recorder"]
    for word in (commit, commit[:9]):
        document = clean.audit(word)
        assert (document["understood_as"], releases(document)) == (["commit"], ["cloud-0/recorder-a"])


def test_what_ran_where_and_when(clean: Platform) -> None:
    (run,) = clean.audit("cloud-0/recorder-a")["ran"]
    names = clean.names
    assert (run["agent"], run["from"], run["until"]) == ("cloud-0", "2026-11-18T11:19:41Z", "2026-11-18T11:22:41Z")
    assert (run["commit"], run["ended_by"]) == (names["recorder"], names["withdrawal"])
    assert (run["chart"], run["version"], run["digest"]) == ("recorder", "0.1.0", RECORDER.digest)
    assert (run["evidence"], run["images"]) == (names["evidence of recorder"], [RECORDER_IMAGE])
    seen = {"nodes": ["cloud-0-node"], "images": [RECORDER_IMAGE], "at": "2026-11-18T11:20:40.000000Z"}
    assert run["observed"] == seen


def test_who_asked_and_why_and_who_checked(clean: Platform) -> None:
    change = clean.audit("cloud-0/recorder-a")["changes"][0]
    asked = {"task": MEETING.task, "event": MEETING.event, "rule": MEETING.rule, "trace": MEETING.trace}
    assert (change["tasks"], change["reason"]) == ([asked], "vehicle-00 and vehicle-01 are near")
    assert (change["plan"], change["manager"], change["term"]) == (plan_id(2), "manager", 1)
    checked = change["checked"]
    assert (checked["way"], checked["author"], checked["approved_by"]) == ("automatic", "manager", [])
    assert checked["catalogue"] == clean.names["publish recorder"]


def test_who_approved(clean: Platform) -> None:
    (change,) = clean.audit(clean.names["policy"])["changes"]
    assert (change["by"], change["checked"]["way"], change["checked"]["approved_by"]) == ("ada", "approval", ["grace"])


def test_what_had_been_verified(clean: Platform) -> None:
    (verified,) = clean.audit("cloud-0/recorder-a")["verified"]
    suites = [(suite["suite"], suite["result"], suite["passed"]) for suite in verified["suites"]]
    assert suites == [(name, "PASSED", ["first", "second"]) for name in ("images", "install", "static")]
    assert (verified["problem"], verified["verified_at"]) == ("", "2026-11-21T10:00:00Z")


def test_findings_say_whether_they_concern_what_was_asked(platform: Platform) -> None:
    main = platform.deployment
    gone: dict[str, str | None] = {"releases/vehicle-00/mqtt-bridge.yaml": None}
    main.commit(gone, "away with it\n", BEGAN + 60 * MINUTE, "ada")
    for word, concerns in (("vehicle-00/mqtt-bridge", True), ("cloud-0/recorder-a", False), ("", True)):
        findings = platform.audit(word)["findings"]
        assert [(finding["finding"], finding["concerns"]) for finding in findings] == [
            ("changed-by-hand", concerns),
            ("unchecked-commit", concerns),
        ]


def test_what_a_changed_note_says_is_not_believed(platform: Platform) -> None:
    commit = platform.names["recorder"]
    text = platform.deployment.note(OUTCOMES_REFERENCE, commit)
    platform.deployment.write_note(OUTCOMES_REFERENCE, commit, text.replace("cloud-0-node", "cloud-1-node"))
    document = platform.audit("cloud-0/recorder-a")
    assert document["ran"][0]["observed"] is None
    assert [(one["finding"], one["concerns"]) for one in document["findings"]] == [("note-edited", True)]


def test_a_copy_that_is_fetched_again_notices_that_main_was_put_back(platform: Platform, tmp_path: Path) -> None:
    forge = (str(platform.folder / "forge"), "robotkube/deployment", "", "", tmp_path / "copy")
    assert fetch_history(*forge) == ""
    newest = platform.names["second"]
    assert GitHistory(tmp_path / "copy").commits({})[-1].id == newest
    platform.deployment.move(platform.names["withdrawal"])
    former = fetch_history(*forge)
    assert former == newest
    assert GitHistory(tmp_path / "copy").commits({})[-1].id == platform.names["withdrawal"]
    kinds = [kind for kind, _ in found(platform.audit(former=[former]))]
    assert kinds[0] == "main-rewritten"


def test_findings_of_commits_that_were_known_are_left_out_and_counted(platform: Platform) -> None:
    main = platform.deployment
    accepted = main.commit({"policies/edits.yaml": "edits: respect\n"}, "by hand\n", BEGAN + 60 * MINUTE, "ada")
    assert [kind for kind, _ in found(platform.audit())] == ["unchecked-commit"]
    document = platform.audit(since=[accepted])
    assert (found(document), document["findings_accepted"]) == ([], 1)
    main.commit({"policies/edits.yaml": "edits: revert\n"}, "by hand\n", BEGAN + 61 * MINUTE, "ada")
    assert [kind for kind, _ in found(platform.audit(since=[accepted]))] == ["unchecked-commit"]


@pytest.mark.parametrize("word", ["cloud-0/nobody", "f" * 32, "sha256:" + "0" * 64, "x" * 1000, "../..", "\0", "a b"])
def test_an_unknown_subject_is_said_in_words(clean: Platform, word: str) -> None:
    with pytest.raises(InputError, match=r"nothing on main has to do with|that names nothing"):
        clean.audit(word)


def test_a_pod_of_two_namespaces_is_not_guessed() -> None:
    releases = ["cloud-0/recorder", "cloud-1/recorder"]
    assert release_of_pod("recorder-758c5bc65c-bglft", releases) == ""
    assert release_of_pod("cloud-1/recorder-758c5bc65c-bglft", releases) == "cloud-1/recorder"
    assert release_of_pod("cloud-1/recorder", releases) == ""


def test_a_pod_says_that_git_knows_no_pods(clean: Platform) -> None:
    document = clean.audit("cloud-0/recorder-b-758c5bc65c-bglft")
    words = "whether a pod cloud-0/recorder-b-758c5bc65c-bglft existed"
    assert any(words in sentence for sentence in document["cannot_be_told"])


def test_an_empty_repository_is_said_in_words(clean: Platform, tmp_path: Path) -> None:
    empty = Platform(tmp_path)
    (tmp_path / "forge" / "robotkube").mkdir(parents=True)
    Repository(tmp_path / "forge" / "robotkube" / "deployment.git")
    Repository(tmp_path / "forge" / "robotkube" / "catalogue.git")
    (tmp_path / "keys").mkdir()
    with pytest.raises(InputError, match="there is no public key"):
        empty.audit(registry=False)
    (key,) = (clean.folder / "keys").iterdir()
    (tmp_path / "keys" / key.name).write_bytes(key.read_bytes())
    with pytest.raises(InputError, match="the deployment repository has no main branch: nothing ever ran"):
        empty.audit(registry=False)


def test_an_empty_catalogue_is_a_finding(platform: Platform) -> None:
    platform.catalogue.git.references.delete("refs/heads/main")
    kinds = {kind for kind, _ in found(platform.audit())}
    assert kinds == {
        "application-not-verified",
        "catalogue-not-readable",
        "catalogue-rewritten",
        "not-in-catalogue",
    }


def test_a_folder_without_a_clone_is_said_in_words(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no clone of a Git repository; make it with `git clone --mirror`"):
        GitHistory(tmp_path)


def test_a_shallow_clone_is_said_in_words(platform: Platform) -> None:
    repository = platform.deployment
    (repository.folder / "shallow").write_text(f"{platform.names['second']}\n")
    with pytest.raises(InputError, match="a shallow clone, its history is cut off"):
        GitHistory(repository.folder)


def test_a_clone_with_missing_objects_is_said_in_words(platform: Platform) -> None:
    commit, child = platform.names["recorder"], platform.names["policy"]
    (platform.deployment.folder / "objects" / commit[:2] / commit[2:]).unlink()
    with pytest.raises(InputError, match=f"{child} or its parent needs is missing; the clone is not whole"):
        platform.audit()


def test_after_broken_yaml_the_story_goes_on(platform: Platform) -> None:
    main = platform.deployment
    path = "releases/cloud-0/recorder-b.yaml"
    good = main.text(path)
    platform.merge({path: "a: [\n"}, "oops\n", BEGAN + 60 * MINUTE, "approval", "ada", "grace")
    platform.merge({path: good}, "as before\n", BEGAN + 61 * MINUTE, "approval", "ada", "grace")
    document = platform.audit("cloud-0/recorder-b")
    assert [kind for kind, _ in found(document)] == ["file-not-readable", "changed-by-hand", "changed-by-hand"]
    assert [(run["from"], run["until"]) for run in document["ran"]] == [
        ("2026-11-18T11:23:41Z", "2026-11-18T12:07:41Z"),
        ("2026-11-18T12:07:41Z", None),
    ]


def test_text_that_is_no_utf_8_and_times_without_a_calendar_are_read(platform: Platform) -> None:
    main = platform.deployment
    commit = _odd_commit(main)
    document = platform.audit(commit)
    assert document["changes"][0]["time"].endswith(" s")
    assert "time-order" in {kind for kind, _ in found(document)}


def _odd_commit(main: Repository) -> str:
    """A commit whose message is Latin-1 and whose time no calendar has."""
    tip = main.git[main.tip]
    text = f"tree {tip.tree.id}\nparent {tip.id}\n".encode()
    text += b"author x <x@x> 999999999999999 +0000\ncommitter x <x@x> 999999999999999 +0000\n\ncaf\xe9\n"
    commit = str(main.git.write(pygit2.enums.ObjectType.COMMIT, text))
    main.move(commit)
    return commit


def many_plans(platform: Platform) -> list[tuple[str, Release, str]]:
    """COMMITS more plans on main, by one run of Git; a mark, the release and the message of each."""
    evidence = platform.names["evidence of recorder"]
    made = []
    for number in range(COMMITS):
        plan = f"20261118-{number // 3600:06d}-{number:06x}"
        one = release(RECORDER, evidence, f"vehicle-{number % 20:02d}", "recorder", plan, MEETING, number=number)
        made.append((f":{number + 1}", one, message_of(one)))
    return made


def data(text: str) -> str:
    return f"data {len(text.encode())}\n{text}\n"


def fast_import(platform: Platform, stream: str, *options: str) -> None:
    command = ["git", "-C", str(platform.deployment.folder), "fast-import", "--quiet", *options]
    subprocess.run(command, input=stream.encode(), check=True, timeout=120)


def write_plans(platform: Platform) -> None:
    """The plans, an outcome and a record of the gate for each, every one a commit of its own."""
    plans = many_plans(platform)
    parts = []
    for number, (mark, made, message) in enumerate(plans):
        who = f"manager <manager@robotkube.invalid> {BEGAN + 3600 + number} +0000"
        parts.append(f"commit refs/heads/main\nmark {mark}\nauthor {who}\ncommitter {who}\n{data(message)}")
        parts += ["from refs/heads/main^0\n"] if not number else []
        parts += [f"M 100644 inline {path}\n{data(text)}" for path, text in files_of(made).items()]
    marks = platform.folder / "marks"
    fast_import(platform, "".join(parts), f"--export-marks={marks}")
    commits = dict(line.split() for line in marks.read_text().splitlines())
    outcomes = {commits[mark]: outcome_of(commits[mark], made) for mark, made, _ in plans}
    write_notes(platform, OUTCOMES_REFERENCE, outcomes)
    write_notes(platform, REFERENCE, records_of(platform, [commits[mark] for mark, _, _ in plans]))


def outcome_of(commit: str, made: Release) -> str:
    seen = ReleaseOutcome(made.key, "Synced", "Healthy", ("node",), ())
    return note_text(PlanOutcome(made.plan, commit, 1, 2, 3, (seen,), ()))


def records_of(platform: Platform, commits: list[str]) -> dict[str, str]:
    """Signed records of these commits, each of which stands on the one before."""
    key = signing_key(platform.folder / "gate-key", SEED_OF_GATE)
    tips = [str(platform.deployment.git.references[name].target) for name in (OUTCOMES_REFERENCE, REFERENCE)]
    signed = {}
    for number, commit in enumerate(commits):
        previous = commits[number - 1] if number else platform.names["second"]
        time_of_merge = seconds_text(BEGAN + 3601 + number)
        record = MergeRecord(commit, previous, "manager", "automatic", "7", (), time_of_merge, platform.catalogue.tip)
        signed[commit] = key.sign(record_statement(record.anchored(*tips), "http://forge.example/d", "gate")).decode()
    return signed


def write_notes(platform: Platform, reference: str, texts: Mapping[str, str]) -> None:
    parts = []
    for number, (commit, text) in enumerate(texts.items()):
        who = f"gate <gate@robotkube.invalid> {BEGAN + 3600 + number} +0000"
        parts.append(f"commit {reference}\ncommitter {who}\n{data('notes')}")
        parts += [f"from {reference}^0\n"] if not number else []
        parts.append(f"N inline {commit}\n{data(text)}")
    fast_import(platform, "".join(parts))


@pytest.mark.thorough
def test_ten_thousand_commits_are_read_within_a_bound(platform: Platform) -> None:
    write_plans(platform)
    began = time.process_time()
    document = platform.audit(now=BEGAN + 86_400)
    seconds = time.process_time() - began
    assert (found(document), len(document["changes"])) == ([], COMMITS + 6)
    assert len([run for run in document["ran"] if run["observed"]]) == COMMITS + 3
    print(f"{COMMITS} commits: {seconds:.1f} s of the processor")
    assert seconds < SECONDS_MAX
