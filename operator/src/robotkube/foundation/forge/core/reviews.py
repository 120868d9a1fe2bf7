"""A person's review of a pull request, and when reviews approve it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Review:
    """A review of a pull request when its head was `commit`: `approved`, or else against it; `official`
    when the forge knows the author as one with write rights."""

    author: str
    commit: str
    approved: bool
    official: bool


def approvers(reviews: Iterable[Review], commit: str, author: str, excluded: Iterable[str]) -> tuple[str, ...]:
    """The people other than the author who approved exactly `commit`; none while one who may is against it. The last
    review of each person counts; `reviews` are oldest first, `excluded` accounts whose reviews do not count."""
    nobody = {account.lower() for account in (author, *excluded)}
    counting = [
        review
        for review in reviews
        if review.official and review.commit == commit and review.author.lower() not in nobody
    ]
    last = {review.author: review for review in counting}
    return tuple(sorted(last)) if all(review.approved for review in last.values()) else ()
