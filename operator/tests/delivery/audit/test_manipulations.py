"""Manipulations of repositories, notes, evidence and registry, each found by the audit, or said to be beyond it."""

from __future__ import annotations

import shutil

import pytest

from robotkube.delivery.audit.core.findings import MEANINGS
from tests.stages.delivery.audit.audited_platform import (
    MINUTE,
    RECORDER,
    Platform,
    files_of,
    found,
    message_of,
    plan_id,
    release,
)
from tests.stages.delivery.audit.manipulations import (
    LATER,
    Manipulate,
    all_outcomes_removed,
    all_records_removed,
    application_edited,
    application_edited_and_deployed,
    application_removed_and_deployed,
    application_without_its_statement,
    applications_not_asked_for,
    assurance_none_in_between,
    break_glass,
    break_glass_by_people_whom_nobody_checked,
    break_glass_that_nobody_signed,
    broken_yaml,
    catalogue_commit_in_the_past,
    catalogue_replaced,
    chart_deleted,
    chart_that_was_never_published,
    commit_before_its_parent,
    commit_in_the_future,
    commit_past_the_gate,
    commit_stamped_after_it_was_merged,
    commit_with_a_record_of_a_stranger,
    commit_with_an_edited_record,
    commit_with_evidence_of_a_chart_as_its_record,
    commit_with_the_record_of_another,
    digest_other_than_its_trailer,
    entry_edited,
    entry_not_readable,
    everything_put_back,
    evidence_other_than_its_trailer,
    evidence_swapped,
    images_edited,
    initial_applications_without_approval,
    main_files,
    main_replaced,
    main_replaced_in_the_middle,
    main_under_a_record_replaced,
    merge_with_a_side_branch,
    newest_outcome_rewritten_without_a_trace,
    oldest_records_removed_without_a_trace,
    other_bytes_under_the_digest,
    outcome_for_another_commit,
    outcome_of_a_commit_that_never_was,
    outcome_of_another_plan,
    outcome_overwritten_with_words,
    outcome_removed,
    outcome_rewritten,
    outcome_rewritten_without_a_trace,
    plan_that_touches_a_policy,
    plans_of_policies_merge_by_themselves,
    publishers_plans_merge_by_themselves,
    record_removed,
    record_removed_without_a_trace,
    releases_changed_by_hand,
    source_that_leads_elsewhere,
    statement_edited,
    statement_for_other_bytes,
    statement_of_a_stranger,
    statement_of_another_application,
    suite_missing,
    suite_not_asked_for,
    tag_moved,
    tag_removed,
    task_that_the_release_does_not_have,
    trailers_edited,
    unsigned_application,
)
from tests.stages.paths import DOCS
from tests.stages.registry.signed_evidence import POLICY_TEXT

MANIPULATIONS: list[tuple[Manipulate, str, str]] = [
    (outcome_rewritten, "note-edited", "was changed by"),
    (outcome_rewritten_without_a_trace, "notes-replaced", "refs/notes/robotkube stood at"),
    (outcome_for_another_commit, "outcome-of-other-commit", "it speaks of commit"),
    (
        outcome_of_another_plan,
        "outcome-of-other-commit",
        f"plan {plan_id(2)}, the commit's is {plan_id(4)}",
    ),
    (outcome_overwritten_with_words, "outcome-not-readable", "it is not the JSON of an outcome"),
    (outcome_of_a_commit_that_never_was, "outcome-off-main", "main has no commit 111111111111"),
    (outcome_removed, "note-edited", "was removed by"),
    (all_outcomes_removed, "notes-replaced", "refs/notes/robotkube stood at"),
    (record_removed, "unchecked-commit", "withdraw(recording)"),
    (record_removed, "note-edited", "was removed by"),
    (record_removed_without_a_trace, "unchecked-commit", "deploy(recording)"),
    (oldest_records_removed_without_a_trace, "records-removed", "it says that there were others before it"),
    (oldest_records_removed_without_a_trace, "notes-replaced", "refs/notes/robotkube-gate stood at"),
    (all_records_removed, "no-records", "main has no commit with a valid record"),
    (commit_past_the_gate, "unchecked-commit", "by manager"),
    (commit_with_the_record_of_another, "record-of-other-commit", "it is the record of"),
    (commit_with_the_record_of_another, "unchecked-commit", "by manager"),
    (commit_with_a_record_of_a_stranger, "record-not-valid", "which is not trusted here"),
    (commit_with_an_edited_record, "record-not-valid", "it was changed after signing"),
    (commit_with_evidence_of_a_chart_as_its_record, "record-not-valid", "about something else"),
    (merge_with_a_side_branch, "merge-commit", "2 parents; it brings 2 commits of a side branch"),
    (merge_with_a_side_branch, "unchecked-commit", "Merge branch 'side'"),
    (releases_changed_by_hand, "changed-by-hand", "releases/cloud-0/recorder-b.yaml, by ada: 'try something'"),
    (break_glass, "break-glass", "releases/cloud-0/recorder-c.yaml; signed by ada, grace"),
    (break_glass_that_nobody_signed, "break-glass-not-signed", "as the signature of ada is not over this commit"),
    (break_glass_that_nobody_signed, "changed-by-hand", "by ada: 'let it through'"),
    (break_glass_by_people_whom_nobody_checked, "break-glass-not-signed", "eve is none of the people in"),
    (break_glass_by_people_whom_nobody_checked, "unchecked-commit", "'x', by manager"),
    (digest_other_than_its_trailer, "trailers-differ", "is missing; a changed release uses it"),
    (evidence_other_than_its_trailer, "trailers-differ", f"is sha256:{'e' * 64}, releases/cloud-0/recorder-c.yaml has"),
    (
        task_that_the_release_does_not_have,
        "trailers-differ",
        "somebody-else has no part in any changed release",
    ),
    (plan_that_touches_a_policy, "trailers-differ", "a plan touches policies/edits.yaml"),
    (trailers_edited, "plan-not-readable", "RobotKube-Rule: none of yours"),
    (source_that_leads_elsewhere, "source-differs", "leads to recorder@sha256:"),
    (broken_yaml, "file-not-readable", "releases/cloud-0/recorder-b.yaml"),
    (main_replaced, "record-off-main", "pull request 7 by manager, merged at 2026-11-18T11:23:41Z"),
    (main_replaced_in_the_middle, "record-off-main", "merged at 2026-11-18T11:22:41Z"),
    (main_under_a_record_replaced, "record-contradicts-main", "main stood at 999999999999 before"),
    (catalogue_replaced, "catalogue-rewritten", "it was decided by commit"),
    (commit_before_its_parent, "time-order", "s before the commit that it stands on"),
    (commit_in_the_future, "time-order", "its time lies 600 s in the future"),
    (commit_stamped_after_it_was_merged, "time-order", "it was made 600 s after the gate merged it"),
    (catalogue_commit_in_the_past, "time-order", "s before the commit that it stands on"),
    (assurance_none_in_between, "policy-relaxed", "assurance none"),
    (assurance_none_in_between, "no-evidence", "recorder@0.1.0 with evidence none"),
    (initial_applications_without_approval, "policy-relaxed", "initialFor automatic"),
    (suite_not_asked_for, "policy-relaxed", "suite install is not asked for any more"),
    (publishers_plans_merge_by_themselves, "policy-relaxed", "what publisher proposes to releases/ merges by itself"),
    (plans_of_policies_merge_by_themselves, "policy-relaxed", "what manager proposes to policies/ merges by itself"),
    (statement_for_other_bytes, "evidence-not-valid", "suite static: the evidence is about another digest"),
    (statement_for_other_bytes, "entry-not-valid", "suite static: the evidence is about another digest"),
    (statement_of_a_stranger, "entry-not-valid", "which is not trusted here"),
    (suite_missing, "entry-not-valid", "suite install: there is no evidence; a missing suite is not a passed one"),
    (entry_edited, "entry-not-valid", "charts/recorder/0.1.0.yaml is not what was verified"),
    (images_edited, "entry-not-valid", "charts/recorder/0.1.0.yaml is not what was verified"),
    (evidence_swapped, "entry-not-valid", "the evidence is about bridge 0.1.0, not recorder 0.1.0"),
    (statement_edited, "entry-not-valid", "it was changed after signing"),
    (chart_that_was_never_published, "not-in-catalogue", "had none"),
    (entry_not_readable, "catalogue-not-readable", "charts/recorder/0.1.0.yaml"),
    (tag_moved, "tag-moved", "it leads to sha256:"),
    (tag_removed, "tag-moved", "the tag is gone"),
    (chart_deleted, "chart-missing", "there is no manifest of this digest"),
    (other_bytes_under_the_digest, "manifest-differs", "its bytes are sha256:"),
    (application_edited, "application-not-valid", "applications/recording.yaml is not what was verified"),
    (
        application_edited_and_deployed,
        "application-not-verified",
        "application recording, asked for by cloud-0/third: no valid evidence: applications/recording.yaml is not what",
    ),
    (statement_of_another_application, "application-not-valid", "the evidence is about application 'other'"),
    (application_without_its_statement, "application-not-valid", "there is no evidence that it was composed"),
    (application_removed_and_deployed, "application-not-verified", "asked for by cloud-0/third: the catalogue at"),
    (applications_not_asked_for, "policy-relaxed", "applications none; fewer applications have to be checked"),
]


@pytest.mark.parametrize(("manipulate", "kind", "words"), MANIPULATIONS)
def test_a_manipulation_is_found(platform: Platform, manipulate: Manipulate, kind: str, words: str) -> None:
    manipulate(platform)
    findings = found(platform.audit())
    assert any(name == kind and words in what for name, what in findings), findings


def test_what_a_later_plan_made_good_is_said(platform: Platform) -> None:
    break_glass(platform)
    commit = platform.deployment.tip
    made = release(RECORDER, platform.names["evidence of recorder"], "cloud-0", "recorder-c", plan_id(8))
    message = message_of(made, "withdraw", ("revert",))
    trailer = "RobotKube-Plan:"
    message = message.replace(trailer, f"RobotKube-Reverts: {commit}\n{trailer}")
    undone = platform.merge({path: None for path in files_of(made) if "recorder-c" in path}, message, LATER + MINUTE)
    ((kind, what),) = [one for one in found(platform.audit()) if one[0] == "break-glass"]
    assert what.endswith(f"; undone by commit {undone}"), kind
    (change,) = [one for one in platform.audit()["changes"] if one["commit"] == commit]
    assert change["made_good"] == {"how": "undone", "commit": undone}


def test_what_nobody_checked_makes_nothing_good(platform: Platform) -> None:
    break_glass(platform)
    commit = platform.deployment.tip
    made = release(RECORDER, platform.names["evidence of recorder"], "cloud-0", "recorder-c", plan_id(8))
    message = message_of(made, "withdraw", ("revert",))
    message = message.replace("RobotKube-Plan:", f"RobotKube-Reverts: {commit}\nRobotKube-Plan:")
    platform.deployment.commit({"README.md": "by hand\n"}, message, LATER + MINUTE, "mallory")
    ((_, what),) = [one for one in found(platform.audit()) if one[0] == "break-glass"]
    assert "by commit" not in what


def test_every_kind_of_finding_has_a_manipulation_and_a_row_in_the_reference() -> None:
    page = (DOCS / "reference" / "audit.md").read_text()
    assert {kind for _, kind, _ in MANIPULATIONS} | {"main-rewritten"} == set(MEANINGS)
    assert [kind for kind in MEANINGS if f"`{kind}`" not in page] == []


def test_a_platform_that_nobody_touched_has_no_finding(clean: Platform) -> None:
    assert found(clean.audit()) == []


def test_a_change_of_the_verification_policy_does_not_accuse_what_was_verified_before(platform: Platform) -> None:
    policy = POLICY_TEXT.replace('version: "2"', 'version: "3"')
    platform.catalogue.commit({"policies/verification.yaml": policy}, "the newer suite\n", LATER, "ada")
    assert found(platform.audit()) == []


def test_a_pull_request_of_several_commits_is_covered_by_the_record_of_its_last(platform: Platform) -> None:
    before = platform.deployment.tip
    for number in range(3):
        last = platform.deployment.commit({"policies/note.yaml": f"a: {number}\n"}, "one\n", LATER + number, "ada")
    platform.record(last, LATER + 4, before, "approval", "grace")
    assert found(platform.audit()) == []


def test_a_pull_request_into_which_main_was_merged_is_one_change_of_main(platform: Platform) -> None:
    """Its first parent is not where main stood."""
    main = platform.deployment
    before = main.tip
    side = main.commit(
        {"policies/note.yaml": "a: 1\n"}, "one\n", LATER, "ada", [platform.names["withdrawal"]], move=False
    )
    files = {path: main.text(path) for path in main_files(platform)}
    head = main.commit({**files, "policies/note.yaml": "a: 1\n"}, "Merge main\n", LATER, "ada", [side, before])
    assert "record-off-main" in {kind for kind, _ in found(platform.audit())}, "nobody signed for it yet"
    platform.record(head, LATER + 1, before, "approval", "grace")
    document = platform.audit()
    assert found(document) == []
    assert [change["commit"] for change in document["changes"]][-2:] == [before, head]


# -- beyond it -------------------------------------------------------------------------------------------------------


BEYOND: list[tuple[Manipulate, str]] = [
    (everything_put_back, "whether main, catalogue and all notes together were put back to an earlier state"),
    (newest_outcome_rewritten_without_a_trace, "what was observed a manager saw once, and nobody signed it"),
]


@pytest.mark.parametrize(("manipulate", "words"), BEYOND)
def test_what_cannot_be_told_is_said(platform: Platform, manipulate: Manipulate, words: str) -> None:
    manipulate(platform)
    document = platform.audit()
    assert found(document) == []
    assert any(words in sentence for sentence in document["cannot_be_told"]), document["cannot_be_told"]


def test_an_application_that_nobody_signed_is_named_where_the_policy_lets_it_pass(platform: Platform) -> None:
    assert not any("who changed these applications" in sentence for sentence in platform.audit()["cannot_be_told"])
    unsigned_application(platform)
    document = platform.audit("cloud-0/third")
    assert {kind for kind, _ in found(document)} == {"policy-relaxed"}
    words = "who changed these applications of the catalogue: recording. No statement covers them"
    assert any(words in sentence for sentence in document["cannot_be_told"])
    (row,) = document["applications"]
    assert (row["evidence"], row["key"], row["charts"]) == ("none", "", [])


def test_what_an_application_had_been_tried_with_is_shown(clean: Platform) -> None:
    document = clean.audit("cloud-0/second")
    (row,) = document["applications"]
    assert (row["application"], row["problem"]) == ("recording", "")
    assert row["charts"] == [f"recorder@0.1.0@{RECORDER.digest}"]
    assert row["key"] == document["as_of"]["keys"][0]


def test_what_was_put_back_is_found_by_a_tip_that_was_kept(platform: Platform) -> None:
    kept = platform.audit()["as_of"]["deployment"]["tip"]
    everything_put_back(platform)
    document = platform.audit(since=[kept])
    assert found(document) == [("main-rewritten", "neither main has it any more")]
    assert not any("put back to an earlier state" in sentence for sentence in document["cannot_be_told"])


def test_without_the_registry_its_manipulations_are_said_not_to_be_looked_at(platform: Platform) -> None:
    chart_deleted(platform)
    shutil.rmtree(platform.folder / "oci")
    document = platform.audit(registry=False)
    assert found(document) == []
    assert any(sentence.startswith("Not looked at: the OCI registry") for sentence in document["cannot_be_told"])
