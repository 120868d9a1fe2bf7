"""policies/merge.yaml: which way to main it opens for plans and for people."""

import pytest

from robotkube.delivery.deployment.core.policies.merge import APPROVAL, AUTOMATIC, CLOSED, read_merge_policy
from robotkube.errors import DocumentError
from tests.stages.paths import REPOSITORY

POLICY = """\
automatic:
- {author: manager, paths: [releases/, sources/]}
- {author: manager, paths: [README.md]}
person:
- {paths: [policies/, releases/]}
"""


@pytest.mark.parametrize(
    ("author", "paths", "way"),
    [
        ("manager", ["releases/a/b.yaml", "sources/a/c.yaml", "README.md"], AUTOMATIC),
        ("manager", ["README.md.yaml"], CLOSED),
        ("manager", ["releases/a/b.yaml", "policies/x.yaml"], APPROVAL),
        ("other", ["releases/a/b.yaml"], APPROVAL),
        ("other", ["releases/a/b.yaml", "sources/a/c.yaml"], CLOSED),
    ],
)
def test_the_way_of_a_plan(author: str, paths: list[str], way: str) -> None:
    assert read_merge_policy(POLICY).way_of_plan(author, paths) == way


@pytest.mark.parametrize(
    ("paths", "way"),
    [
        (["releases/a/b.yaml", "policies/x.yaml"], APPROVAL),
        (["releases/a/b.yaml", "sources/a/c.yaml"], CLOSED),
        (["README.md"], CLOSED),
        (["releases"], CLOSED),
    ],
)
def test_the_way_of_a_person_is_never_without_another(paths: list[str], way: str) -> None:
    for own in ("", "- {author: person, paths: [releases/, sources/, policies/, README.md]}\n"):
        policy = read_merge_policy(POLICY.replace("person:", f"{own}person:"))
        assert policy.way_of_person(paths) == way


@pytest.mark.parametrize("text", ["{}\n", "automatic: []\nperson: [{paths: [releases/]}]\n"])
def test_no_merge_policy_locks_people_out_of_it(text: str) -> None:
    policy = read_merge_policy(text)
    assert policy.way_of_person(["policies/merge.yaml"]) == APPROVAL
    assert policy.way_of_person(["policies/merge.yaml", "policies/initial.yaml"]) == CLOSED
    assert policy.way_of_plan("manager", ["policies/merge.yaml"]) == CLOSED


def test_the_first_policy_leaves_what_widens_what_runs_to_another_person() -> None:
    policy = read_merge_policy((REPOSITORY / "gitops" / "deployment" / "policies" / "merge.yaml").read_text())
    widening = ["policies/merge.yaml", "policies/initial.yaml", "policies/edits.yaml", "policies/updates.yaml"]
    for path in (*widening, "releases/a/b.yaml", "sources/a/b.yaml", "README.md", "bootstrap/appproject.yaml"):
        assert policy.way_of_person([path]) == APPROVAL, path
    for path in widening:
        assert policy.way_of_plan("manager", [path]) == APPROVAL, path
    assert policy.way_of_plan("manager", ["releases/a/b.yaml", "sources/a/b.yaml"]) == AUTOMATIC


def test_a_wrong_merge_policy_names_every_problem() -> None:
    with pytest.raises(DocumentError) as caught:
        read_merge_policy("automatic: [{author: a b, paths: ['/x', '../y']}]\nperson: 3\nother: 1\n")
    for part in ("other: unknown key", "author: 'a b'", "paths: '/x'", "person: must be a list"):
        assert part in str(caught.value)
