"""What a submission may touch and say: every refusal with the words that its author reads."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping
from robotkube.registry.charts.core.packing import PackedChart
from robotkube.registry.charts.core.unpacking import unpack_chart
from robotkube.registry.evidence.core.verification_policy import PATH as POLICY
from robotkube.registry.evidence.core.verification_policy import read_verification_policy
from robotkube.registry.publication.adapters.submission_folders import validation_tools
from robotkube.registry.publication.core.submissions import (
    Proposed,
    Submission,
    SubmittedChart,
    VerifiedChart,
    artefact_problems,
    is_published,
    publication_files,
    publication_message,
    read_entry,
    read_submission,
)
from tests.stages.registry.submissions import CATALOGUE, IMAGE, application, chart, entry, entry_path

PARENT = "a" * 40
PACKED, SPEC = chart()
PATH = entry_path(PACKED)
TOOLS = validation_tools()


def submitted(changes: Mapping[str, str | None], main: Mapping[str, str] = CATALOGUE, **other: Any) -> Submission:
    """Read a submission on main's tip."""
    local = other.pop("local_builds", False)
    proposed = Proposed((PARENT,), changes, (), True, main, main)
    return read_submission(replace(proposed, **other), local, TOOLS)


def published(packed: PackedChart, spec: Mapping[str, Any], state: str = "verified") -> dict[str, str]:
    """Main with a chart version."""
    return {**CATALOGUE, entry_path(packed): entry(packed, spec, state=state, evidence="sha256:" + "e" * 64)}


def test_an_entry_and_an_application_are_taken() -> None:
    submission = submitted({PATH: entry(PACKED, SPEC), "applications/relaying.yaml": application()})
    assert submission.problems == ()
    assert [one.name for one in submission.charts] == ["relay 0.1.0"]
    assert submission.names == "relay 0.1.0, application relaying"


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("policies/release.yaml", "assurance: none\n"),
        ("policies/verification.yaml", ""),
        ("keys/0123456789abcdef.pem", "mine"),
        ("charts/relay/0.1.0.schema.json", "{}"),
        ("evidence/relay/readme.md", "hello"),
        ("README.md", "hello"),
        (".gitea/workflows/build.yaml", "on: push"),
        ("applications/deeper/relaying.yaml", application()),
    ],
)
def test_other_files_may_not_be_touched(path: str, text: str) -> None:
    submission = submitted({PATH: entry(PACKED, SPEC), path: text})
    assert any(problem.startswith(f"{path}: a publisher may only touch charts/") for problem in submission.problems)


def test_nothing_is_removed() -> None:
    submission = submitted({PATH: None}, published(PACKED, SPEC))
    assert f"{PATH}: a publisher removes nothing; ask a person who may write the catalogue" in submission.problems


@pytest.mark.parametrize(
    ("status", "words"),
    [
        ({"state": "verified"}, "status.state: 'verified' must be 'staged'; only the gate calls a version verified"),
        ({"evidence": "sha256:" + "a" * 64}, "status.evidence: unknown key; remove it"),
        ({"digest": "sha256:short"}, "status.digest"),
        ({"images": ["ros:latest"]}, "status.images[0]"),
    ],
)
def test_a_status_says_staged_and_no_more(status: dict[str, Any], words: str) -> None:
    submission = submitted({PATH: entry(PACKED, SPEC, **status)})
    assert any(words in problem for problem in submission.problems)
    assert submission.charts == ()


def test_the_commit_must_stand_on_main() -> None:
    changes = {PATH: entry(PACKED, SPEC)}
    assert "the commit's parent is not on main" in submitted(changes, on_main=False).problems[0]
    assert "the commit has 2 parents" in submitted(changes, parents=("a", "b")).problems[0]
    assert submitted({}).problems == ("the commit changes nothing",)
    assert "charts/x: not an ordinary text file" in submitted(changes, irregular=("charts/x",)).problems[0]


def test_a_published_version_keeps_its_digest() -> None:
    other, spec = chart(text="kind: Secret\n")
    main = published(PACKED, SPEC)
    refused = submitted({PATH: entry(other, spec)}, main)
    assert (
        f"is published with digest {PACKED.digest}, this is {other.digest}; a version is never" in refused.problems[0]
    )
    assert submitted({PATH: entry(other, spec)}, main, local_builds=True).problems == ()


def test_a_version_is_published_under_the_policy_of_main_only() -> None:
    mine = read_entry(entry(PACKED, SPEC), PATH)
    policy = read_verification_policy(CATALOGUE[POLICY]).digest
    main = {**CATALOGUE, PATH: entry(PACKED, SPEC, state="verified", policy=policy)}
    assert is_published(mine, main)
    assert not is_published(mine, published(PACKED, SPEC))
    assert not is_published(mine, {**main, POLICY: CATALOGUE[POLICY].replace("seconds: 60", "seconds: 61")})
    assert not is_published(mine, {**main, POLICY: "broken"})
    assert not is_published(mine, CATALOGUE)


def test_an_entry_that_somebody_changed_on_main_can_be_restored() -> None:
    """What belongs to the digest says the chart itself, not main (`artefact_problems`)."""
    changed = published(PACKED, {**SPEC, "description": "Better"})
    assert not is_published(read_entry(entry(PACKED, SPEC), PATH), changed)
    assert submitted({PATH: entry(PACKED, SPEC)}, changed).problems == ()


def test_what_was_withdrawn_stays_so() -> None:
    submission = submitted({PATH: entry(PACKED, SPEC)}, published(PACKED, SPEC, "withdrawn"))
    assert "relay 0.1.0 was withdrawn; a person has to revert the withdrawal first" in submission.problems[0]


def test_evidence_must_belong_to_the_submission() -> None:
    folder = f"evidence/relay/0.1.0_{PACKED.digest[7:19]}"
    mine = {PATH: entry(PACKED, SPEC), f"{folder}/static.json": "{}"}
    assert submitted(mine).problems == ()
    other = {**mine, f"evidence/relay/0.1.0_{'0' * 12}/static.json": "{}"}
    assert "belongs to no chart digest of this submission" in submitted(other).problems[0]


def test_the_catalogue_must_hold_together_afterwards() -> None:
    dangling = submitted({"applications/relaying.yaml": application(chart_name="nothing")})
    assert "there is no chart 'nothing'" in dangling.problems[0]
    second = chart(version="0.3.0", replaces="0.2.0")
    submission = submitted({entry_path(second[0]): entry(*second)}, published(PACKED, SPEC))
    assert any("spec.replaces" in problem for problem in submission.problems)


def test_what_main_had_wrong_before_does_not_count() -> None:
    main = {**CATALOGUE, "applications/broken.yaml": "a: [\n"}
    assert submitted({PATH: entry(PACKED, SPEC)}, main).problems == ()


def test_an_application_that_moved_meanwhile_is_not_overwritten() -> None:
    path = "applications/relaying.yaml"
    base = {**published(PACKED, SPEC), path: application()}
    main = {**base, path: application() + "# a person was here\n"}
    submission = submitted({path: application() + "# mine\n"}, base=base, main=main)
    assert f"{path}: changed on main since the commit's parent; submit again on main's tip" in submission.problems


def test_all_problems_are_told_at_once() -> None:
    submission = submitted({PATH: entry(PACKED, SPEC, state="verified"), "README.md": "x", "keys/a.pem": None})
    assert len(submission.problems) == 3


def test_several_platforms_are_refused() -> None:
    packed, spec = chart(platforms=["linux/amd64", "linux/arm64"])
    assert "spec.platforms: name exactly one" in submitted({PATH: entry(packed, spec)}).problems[0]


# -- the chart that the digest names ---------------------------------------------------------------------------------


def problems_of(packed: PackedChart, spec: Mapping[str, Any], **status: Any) -> list[str]:
    submitted_chart = read_entry(entry(packed, spec, **status), entry_path(packed))
    return artefact_problems(submitted_chart, unpack_chart("here", packed.manifest, packed.config, packed.archive))


def test_the_chart_says_what_the_entry_says() -> None:
    assert problems_of(PACKED, SPEC) == []


def test_another_name_version_image_or_entry_is_refused() -> None:
    other, spec = chart("other", "0.2.0")
    mine = read_entry(entry(PACKED, SPEC), PATH)
    differences = artefact_problems(mine, unpack_chart("here", other.manifest, other.config, other.archive))
    assert "has name 'other', not 'relay'" in differences[0]
    assert "has version '0.2.0', not '0.1.0'" in differences[1]
    assert "was packed with another entry" in differences[2]
    images = ["forge.invalid/robotkube/ros@sha256:" + "2" * 64]
    assert "status.images differ from the chart's images.yaml" in problems_of(PACKED, SPEC, images=images)[0]
    packed, spec = chart(images=["ros", "platform"])
    assert "spec.images differ from the chart's images.yaml, which names ros" in problems_of(packed, spec)[0]


def test_the_publication_says_verified_and_nothing_else_changes() -> None:
    mine: SubmittedChart = read_entry(entry(PACKED, SPEC), PATH)
    submission = Submission(charts=(mine,), applications={"applications/relaying.yaml": application()})
    summary = "sha256:" + "5" * 64
    verified = VerifiedChart(mine, {"static": b"{}", "summary": b"[]"}, summary, "sha256:" + "6" * 64, "{}\n")
    files = publication_files(submission, [verified])
    folder = mine.artefact.folder
    assert set(files) == {
        PATH,
        "charts/relay/0.1.0.schema.json",
        f"{folder}/static.json",
        f"{folder}/summary.json",
        "applications/relaying.yaml",
    }
    status = {
        "state": "verified",
        "digest": PACKED.digest,
        "images": [IMAGE],
        "evidence": summary,
        "policy": "sha256:" + "6" * 64,
    }
    assert read_mapping(files[PATH], PATH) == {**read_mapping(entry(PACKED, SPEC), PATH), "status": status}
    message = (
        f"publish: relay 0.1.0, application relaying\n\nRobotKube-Chart: relay@0.1.0@{PACKED.digest}\n"
        f"RobotKube-Evidence: {summary}\nRobotKube-Policy: sha256:{'6' * 64}\nRobotKube-Pull-Request: 7\n"
    )
    assert publication_message(submission, [verified], 7) == message
    approved = publication_message(submission, [verified], 7, ("ada", "grace"))
    assert approved == f"{message}RobotKube-Approved-By: ada\nRobotKube-Approved-By: grace\n"


@pytest.mark.parametrize("text", ["", "[]", "a: [", "status: x\n", write_mapping({"kind": "ChartVersion"}), "\0"])
def test_a_text_that_is_no_entry_is_refused(text: str) -> None:
    submission = submitted({PATH: text})
    assert submission.problems
    assert all(problem.startswith(PATH) for problem in submission.problems)
