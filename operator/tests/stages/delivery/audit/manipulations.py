"""Manipulations of a platform's repositories, notes, evidence and registry, each a function over it."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from dataclasses import replace

import pygit2

from robotkube.delivery.deployment.core.break_glass import SIGNERS_PATH
from robotkube.delivery.deployment.core.merge_records import REFERENCE, MergeRecord, record_statement
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.foundation.forge.adapters.git.notes import REFERENCE as OUTCOMES
from robotkube.registry.charts.core.packing import build_tag
from tests.stages.delivery.audit.audited_platform import (
    APPLICATION,
    BEGAN,
    BRIDGE,
    MINUTE,
    NOW,
    RECORDER,
    RECORDING,
    SECOND,
    SEED_OF_GATE,
    SEED_OF_STRANGER,
    SIGN,
    STRICTER,
    Platform,
    about,
    edited,
    files_of,
    message_of,
    plan_id,
    release,
)
from tests.stages.registry.signed_evidence import (
    POLICY_TEXT,
    Signing,
    application_evidence,
    artefact,
    entry,
    listing,
    published,
    signing_key,
)

LATER = BEGAN + 60 * MINUTE
Manipulate = Callable[[Platform], object]


def third(platform: Platform, **changes: object) -> tuple[dict[str, str], str]:
    """Files and message of one more plan as a manager makes it."""
    evidence = platform.names["evidence of recorder"]
    made = release(RECORDER, evidence, "cloud-0", "recorder-c", plan_id(6), replace(SECOND, task="cloud-0/third"))
    made = replace(made, **changes)  # type: ignore[arg-type]
    return files_of(made), message_of(made)


# -- notes --------------------------------------------------------------------------------------------------------


def outcome_rewritten(platform: Platform) -> None:
    commit = platform.names["recorder"]
    text = platform.deployment.note(OUTCOMES, commit)
    platform.deployment.write_note(OUTCOMES, commit, text.replace("cloud-0-node", "cloud-1-node"))


def outcome_rewritten_without_a_trace(platform: Platform) -> None:
    commit = platform.names["recorder"]
    text = platform.deployment.note(OUTCOMES, commit)
    platform.deployment.rewrite_notes(OUTCOMES, {commit: text.replace("cloud-0-node", "cloud-1-node")})


def outcome_for_another_commit(platform: Platform) -> None:
    names = platform.names
    text = platform.deployment.note(OUTCOMES, names["recorder"])
    platform.deployment.write_note(OUTCOMES, names["withdrawal"], text)


def outcome_of_another_plan(platform: Platform) -> None:
    names = platform.names
    text = platform.deployment.note(OUTCOMES, names["recorder"])
    platform.deployment.write_note(OUTCOMES, names["withdrawal"], edited(text, commit=names["withdrawal"]))


def outcome_overwritten_with_words(platform: Platform) -> None:
    platform.deployment.write_note(OUTCOMES, platform.names["withdrawal"], "all was well\n")


def outcome_of_a_commit_that_never_was(platform: Platform) -> None:
    platform.deployment.write_note(OUTCOMES, "1" * 40, "{}")


def outcome_removed(platform: Platform) -> None:
    platform.deployment.remove_note(OUTCOMES, platform.names["recorder"])


def all_outcomes_removed(platform: Platform) -> None:
    platform.deployment.git.references.delete(OUTCOMES)


def record_removed(platform: Platform) -> None:
    platform.deployment.remove_note(REFERENCE, platform.names["withdrawal"])


def record_removed_without_a_trace(platform: Platform) -> None:
    platform.deployment.rewrite_notes(REFERENCE, {platform.names["second"]: None})


def oldest_records_removed_without_a_trace(platform: Platform) -> None:
    names = platform.names
    platform.deployment.rewrite_notes(REFERENCE, dict.fromkeys((names["bridge"], names["recorder"])))


def all_records_removed(platform: Platform) -> None:
    platform.deployment.git.references.delete(REFERENCE)


# -- commits that the gate did not check ---------------------------------------------------------------------------


def commit_past_the_gate(platform: Platform) -> None:
    platform.deployment.commit(*third(platform), LATER)


def commit_with_the_record_of_another(platform: Platform) -> None:
    commit = platform.deployment.commit(*third(platform), LATER)
    record = platform.deployment.note(REFERENCE, platform.names["second"])
    platform.deployment.write_note(REFERENCE, commit, record)


def commit_with_a_record_of_a_stranger(platform: Platform) -> None:
    commit = platform.deployment.commit(*third(platform), LATER)
    stranger = signing_key(platform.folder / "stranger", SEED_OF_STRANGER)
    statement = record_statement(record_of(platform, commit), "http://forge.example/d", "robotkube-gate")
    platform.deployment.write_note(REFERENCE, commit, stranger.sign(statement).decode())


def record_of(platform: Platform, commit: str) -> MergeRecord:
    names = platform.names
    time = "2026-11-18T12:06:41Z"
    return MergeRecord(commit, names["second"], "manager", "automatic", "8", (), time, platform.catalogue.tip)


def commit_with_an_edited_record(platform: Platform) -> None:
    names = platform.names
    commit = platform.deployment.commit(*third(platform), LATER)
    envelope = json.loads(platform.deployment.note(REFERENCE, names["second"]))
    statement = base64.b64decode(envelope["payload"]).replace(names["second"].encode(), commit.encode())
    envelope["payload"] = base64.b64encode(statement).decode()
    platform.deployment.write_note(REFERENCE, commit, canonical_json(envelope).decode())


def commit_with_evidence_of_a_chart_as_its_record(platform: Platform) -> None:
    commit = platform.deployment.commit(*third(platform), LATER)
    platform.deployment.write_note(REFERENCE, commit, platform.catalogue.text(f"{RECORDER.folder}/summary.json"))


def merge_with_a_side_branch(platform: Platform) -> None:
    main = platform.deployment
    files, message = third(platform)
    tip = main.tip
    first = main.commit({"README.md": "side\n"}, "side\n", LATER, parents=[platform.names["recorder"]], move=False)
    side = main.commit(files, message, LATER, parents=[first], move=False)
    main.commit(files, "Merge branch 'side'\n", LATER + 1, parents=[tip, side])


def releases_changed_by_hand(platform: Platform) -> None:
    main = platform.deployment
    path = "releases/cloud-0/recorder-b.yaml"
    changes = {path: main.text(path).replace("values: {}", "values: {seconds: 9}")}
    commit = main.commit(changes, "try something\n", LATER, "ada")
    platform.record(commit, LATER + 1, "", "approval", "grace")


def break_glass(platform: Platform) -> None:
    main = platform.deployment
    files, _ = third(platform)
    tree = str(main.git[main.commit(files, "x\n", LATER, "ada", move=False)].tree_id)
    main.commit(files, platform.people.message(main.tip, tree, "let it through", *SIGN), LATER, "ada")


def break_glass_that_nobody_signed(platform: Platform) -> None:
    files, _ = third(platform)
    message = "let it through\n\nRobotKube-Break-Glass: 2026-11-18T12:06:40Z\n"
    message += "".join(f"RobotKube-Signed-By: {name} AAAA\n" for name in SIGN)
    platform.deployment.commit(files, message, LATER, "ada")


def break_glass_by_people_whom_nobody_checked(platform: Platform) -> None:
    """Registered by a commit past the gate, which is taken back afterwards."""
    main = platform.deployment
    before = main.text(SIGNERS_PATH)
    main.commit({SIGNERS_PATH: platform.people.add("mallory", "eve").signers("mallory", "eve")}, "x\n", LATER)
    files, _ = third(platform)
    tree = str(main.git[main.commit(files, "x\n", LATER, move=False)].tree_id)
    main.commit(files, platform.people.message(main.tip, tree, "let it through", "mallory", "eve"), LATER)
    main.commit({SIGNERS_PATH: before}, "x\n", LATER)


# -- what a commit says ---------------------------------------------------------------------------------------------


def digest_other_than_its_trailer(platform: Platform) -> None:
    files, _ = third(platform)
    _, message = third(platform, digest="sha256:" + "e" * 64)
    platform.merge(files, message, LATER)


def evidence_other_than_its_trailer(platform: Platform) -> None:
    files, _ = third(platform)
    _, message = third(platform, evidence="sha256:" + "e" * 64)
    platform.merge(files, message, LATER)


def task_that_the_release_does_not_have(platform: Platform) -> None:
    files, _ = third(platform)
    _, message = third(platform, causes=(replace(SECOND, task="cloud-0/somebody-else"),))
    platform.merge(files, message, LATER)


def plan_that_touches_a_policy(platform: Platform) -> None:
    files, message = third(platform)
    platform.merge({**files, "policies/edits.yaml": "edits: respect\n"}, message, LATER)


def trailers_edited(platform: Platform) -> None:
    files, message = third(platform)
    platform.merge(files, message.replace("RobotKube-Rule: proximity", "RobotKube-Rule: none of yours"), LATER)


def source_that_leads_elsewhere(platform: Platform) -> None:
    files, message = third(platform)
    main = platform.deployment
    source = next(path for path in main_files(platform) if path.startswith("sources/cloud-0/"))
    other = main.text(source).replace(RECORDER.digest, "sha256:" + RECORDER.digest[7:19] + "f" * 52)
    platform.merge({**files, source: other}, message, LATER)


def main_files(platform: Platform) -> list[str]:
    index = pygit2.Index()
    index.read_tree(platform.deployment.git[platform.deployment.tip].tree)
    return [one.path for one in index]


def broken_yaml(platform: Platform) -> None:
    files, message = third(platform)
    platform.merge({**files, "releases/cloud-0/recorder-b.yaml": "a: [\n"}, message, LATER)


# -- history and time -----------------------------------------------------------------------------------------------


def main_under_a_record_replaced(platform: Platform) -> None:
    """The record of the newest commit says that main stood at a commit that nobody has any more."""
    commit = platform.deployment.commit(*third(platform), LATER)
    platform.record(commit, LATER + 1, "9" * 40)


def main_replaced(platform: Platform) -> None:
    main = platform.deployment
    files, message = third(platform)
    main.commit(files, message, LATER, parents=[platform.names["withdrawal"]])


def main_replaced_in_the_middle(platform: Platform) -> None:
    """The commit of a withdrawal never was: what came after stands on what came before it, and has the same files."""
    main, names = platform.deployment, platform.names
    changes = {path: main.text(path) for path in main_files(platform) if path.startswith(("releases/", "sources/"))}
    main.commit(changes, str(main.git[names["second"]].message), LATER, parents=[names["policy"]])


def catalogue_replaced(platform: Platform) -> None:
    index = pygit2.Index()
    repository = platform.catalogue
    index.read_tree(repository.git[repository.tip].tree)
    files = {one.path: repository.text(one.path) for one in index}
    repository.commit(files, "seed\n", BEGAN, "administrator", parents=[])


def commit_before_its_parent(platform: Platform) -> None:
    platform.merge(*third(platform), BEGAN - MINUTE)


def commit_in_the_future(platform: Platform) -> None:
    platform.merge(*third(platform), NOW + 10 * MINUTE)


def commit_stamped_after_it_was_merged(platform: Platform) -> None:
    commit = platform.deployment.commit(*third(platform), LATER)
    platform.record(commit, LATER - 10 * MINUTE)


def catalogue_commit_in_the_past(platform: Platform) -> None:
    platform.catalogue.commit({"README.md": "hello\n"}, "words\n", BEGAN - 10 * MINUTE, "ada")


# -- policies -------------------------------------------------------------------------------------------------------


def assurance_none_in_between(platform: Platform) -> None:
    offered = platform.catalogue
    offered.commit({"policies/release.yaml": "assurance: none\n"}, "quickly\n", LATER, "ada")
    files, message = third(platform, evidence="none")
    platform.merge(files, message, LATER + MINUTE)
    offered.commit({"policies/release.yaml": "assurance: verified\n"}, "as before\n", LATER + 2 * MINUTE, "ada")


def initial_applications_without_approval(platform: Platform) -> None:
    changes = {"policies/release.yaml": "assurance: verified\ninitialFor: automatic\n"}
    platform.catalogue.commit(changes, "quickly\n", LATER, "ada")


def suite_not_asked_for(platform: Platform) -> None:
    policy = POLICY_TEXT.replace('  - {name: install, version: "2", seconds: 240}\n', "")
    platform.catalogue.commit({"policies/verification.yaml": policy}, "faster\n", LATER, "ada")


def publishers_plans_merge_by_themselves(platform: Platform) -> None:
    policy = STRICTER.replace("person:", "- {author: publisher, paths: [releases/]}\nperson:")
    platform.merge({"policies/merge.yaml": policy}, "policies: faster\n", LATER, "approval", "ada", "grace")


def plans_of_policies_merge_by_themselves(platform: Platform) -> None:
    policy = STRICTER.replace("paths: [releases/, sources/]", "paths: [releases/, sources/, policies/]")
    platform.merge({"policies/merge.yaml": policy}, "policies: faster\n", LATER, "approval", "ada", "grace")


# -- evidence -------------------------------------------------------------------------------------------------------


def publish(platform: Platform, files: dict[str, str]) -> None:
    platform.catalogue.commit(files, "publish: something\n", LATER, "ada")


def gates_key(platform: Platform) -> Signing:
    return Signing(signing_key(platform.folder / "gate-key", SEED_OF_GATE))


def statement_for_other_bytes(platform: Platform) -> None:
    """Evidence of one build, named by the entry of another, which a plan deploys."""
    mine = about("relay")
    other = artefact("relay", "0.1.0", "other bytes")
    signing = gates_key(platform)
    signing.listed = listing(mine)
    signing.sign(other)
    evidence = sha256(signing.envelopes["summary"])
    files = {f"{mine.folder}/{name}.json": data.decode() for name, data in signing.envelopes.items()}
    publish(platform, files | entry(mine, evidence=evidence))
    made = release(mine, evidence, "cloud-0", "relay", plan_id(7), replace(SECOND, task="cloud-0/relay"))
    platform.merge(files_of(made), message_of(made), LATER + MINUTE)


def statement_of_a_stranger(platform: Platform) -> None:
    stranger = signing_key(platform.folder / "stranger", SEED_OF_STRANGER)
    publish(platform, published(stranger, about("relay")))


def suite_missing(platform: Platform) -> None:
    files = published(gates_key(platform).key, about("relay"))
    publish(platform, {path: text for path, text in files.items() if not path.endswith("/install.json")})


def entry_edited(platform: Platform) -> None:
    path = "charts/recorder/0.1.0.yaml"
    publish(platform, {path: platform.catalogue.text(path).replace("A chart of the tests", "The best chart")})


def images_edited(platform: Platform) -> None:
    path = "charts/recorder/0.1.0.yaml"
    publish(platform, {path: platform.catalogue.text(path).replace("d" * 64, "e" * 64)})


def evidence_swapped(platform: Platform) -> None:
    names = ("static", "images", "install", "summary")
    texts = {name: platform.catalogue.text(f"{BRIDGE.folder}/{name}.json") for name in names}
    path = "charts/recorder/0.1.0.yaml"
    old, new = platform.names["evidence of recorder"], platform.names["evidence of bridge"]
    moved = {f"{RECORDER.folder}/{name}.json": text for name, text in texts.items()}
    publish(platform, {**moved, path: platform.catalogue.text(path).replace(old, new)})


def statement_edited(platform: Platform) -> None:
    path = f"{RECORDER.folder}/static.json"
    envelope = json.loads(platform.catalogue.text(path))
    envelope["payload"] = base64.b64encode(base64.b64decode(envelope["payload"]).replace(b"first", b"fifth")).decode()
    publish(platform, {path: canonical_json(envelope).decode()})


def chart_that_was_never_published(platform: Platform) -> None:
    made = release(artefact("ghost"), "sha256:" + "e" * 64, "cloud-0", "ghost", plan_id(7), SECOND)
    platform.merge(files_of(made), message_of(made), LATER)


def entry_not_readable(platform: Platform) -> None:
    publish(platform, {"charts/recorder/0.1.0.yaml": "a: [\n"})


STATEMENT = "evidence/applications/recording.json"


def application_edited(platform: Platform) -> None:
    publish(platform, {APPLICATION: RECORDING.replace("rate: 5", "rate: 500")})


def application_edited_and_deployed(platform: Platform) -> None:
    application_edited(platform)
    platform.merge(*third(platform), LATER + MINUTE)


def statement_of_another_application(platform: Platform) -> None:
    key = gates_key(platform).key
    other = application_evidence(key, "other", RECORDING)["evidence/applications/other.json"]
    publish(platform, {STATEMENT: other})


def application_without_its_statement(platform: Platform) -> None:
    platform.catalogue.commit({STATEMENT: None}, "nobody needs it\n", LATER, "ada")


def application_removed_and_deployed(platform: Platform) -> None:
    platform.catalogue.commit({APPLICATION: None, STATEMENT: None}, "away\n", LATER, "ada")
    platform.merge(*third(platform), LATER + MINUTE)


def applications_not_asked_for(platform: Platform) -> None:
    changes = {"policies/release.yaml": "assurance: verified\napplications: none\n"}
    platform.catalogue.commit(changes, "quickly\n", LATER, "ada")


def unsigned_application(platform: Platform) -> None:
    """One that an older gate published, for which a plan deploys, while the policy lets that pass."""
    policy = "assurance: verified\napplications: transition\n"
    publish(platform, {"policies/release.yaml": policy, APPLICATION: RECORDING.replace("rate: 5", "rate: 6")})
    platform.catalogue.commit({STATEMENT: None}, "away\n", LATER + 1, "ada")
    platform.merge(*third(platform), LATER + MINUTE)


# -- registry -------------------------------------------------------------------------------------------------------


def in_the_registry(platform: Platform, change: Callable[[list[dict[str, object]]], object]) -> None:
    document = json.loads(platform.index.read_text())
    change(document["manifests"])
    platform.index.write_text(json.dumps(document))


def name_of(one: dict[str, object]) -> str:
    annotations = one["annotations"]
    assert isinstance(annotations, dict)
    return str(annotations["org.opencontainers.image.ref.name"])


def tag_moved(platform: Platform) -> None:
    tag = f"verified/recorder:{build_tag('0.1.0', RECORDER.digest)}"

    def move(entries: list[dict[str, object]]) -> None:
        other = next(one["digest"] for one in entries if name_of(one).startswith("verified/bridge@"))
        next(one for one in entries if name_of(one) == tag)["digest"] = other

    in_the_registry(platform, move)


def tag_removed(platform: Platform) -> None:
    in_the_registry(platform, lambda all_: all_.remove(next(e for e in all_ if "recorder:" in name_of(e))))


def chart_deleted(platform: Platform) -> None:
    in_the_registry(platform, lambda all_: all_.remove(next(e for e in all_ if "recorder@" in name_of(e))))


def other_bytes_under_the_digest(platform: Platform) -> None:
    (platform.folder / "oci" / "blobs" / "sha256" / RECORDER.digest.removeprefix("sha256:")).write_bytes(b"{}")


# -- beyond an audit ---


def everything_put_back(platform: Platform) -> None:
    """Main and all notes as they were before the last plan."""
    main, names = platform.deployment, platform.names
    main.move(names["withdrawal"])
    for reference in (REFERENCE, OUTCOMES):
        notes = main.git[main.git.references[reference].target]
        assert len(notes.parent_ids) == 1
        main.move(str(notes.parent_ids[0]), reference)


def newest_outcome_rewritten_without_a_trace(platform: Platform) -> None:
    """Nothing that the gate signed came after it."""
    main = platform.deployment
    commit = platform.names["second"]
    text = main.note(OUTCOMES, commit)
    notes = main.git[main.git.references[OUTCOMES].target]
    main.move(str(notes.parent_ids[0]), OUTCOMES)
    main.write_note(OUTCOMES, commit, text.replace("cloud-0-node", "cloud-1-node"))
