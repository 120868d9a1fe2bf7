"""Reviews of a commit, and which of them approve it."""

from dataclasses import replace

import pytest

from robotkube.foundation.forge.core.reviews import Review, approvers

HEAD = "c" * 40
APPROVED = Review("reviewer", HEAD, True, True)


@pytest.mark.parametrize(
    ("reviews", "approved"),
    [
        ([], False),
        ([APPROVED], True),
        ([replace(APPROVED, official=False)], False),
        ([replace(APPROVED, commit="d" * 40)], False),
        ([replace(APPROVED, author="author")], False),
        ([replace(APPROVED, author="manager")], False),
        ([replace(APPROVED, author="Author")], False),
        ([APPROVED, Review("other", HEAD, False, True)], False),
        ([Review("reviewer", HEAD, False, True), APPROVED], True),
        ([APPROVED, Review("reviewer", HEAD, False, True)], False),
    ],
)
def test_approval(reviews: list[Review], approved: bool) -> None:
    assert bool(approvers(reviews, HEAD, "author", ["manager"])) is approved


def test_who_approved_is_named() -> None:
    reviews = [APPROVED, replace(APPROVED, author="another"), replace(APPROVED, author="manager")]
    assert approvers(reviews, HEAD, "author", ["manager"]) == ("another", "reviewer")
    assert approvers([*reviews, replace(APPROVED, approved=False)], HEAD, "author", ["manager"]) == ()
