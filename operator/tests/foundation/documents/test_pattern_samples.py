"""Texts that are made from a pattern match it."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.foundation.documents.core.pattern_samples import CHARACTERS_MAX, fitting


@pytest.mark.parametrize(
    ("pattern", "first"),
    [
        ("^unit-[0-9]{3}$", "unit-000"),
        ("^[a-z]([a-z0-9-]*[a-z0-9])?$", "a"),
        ("^(north|south)_gate$", "north_gate"),
        (r"^\d{2}\w\s?$", "00a"),
        ("^[^a-z/]+$", "A"),
        ("^(?:x{2,}?|y)z.$", "xxza"),
        ("^(?P<a>b)++c$", "bc"),
        ("^$", ""),
        ("[A-Z]{2}-é", "AA-é"),
    ],
)
def test_every_text_fits(pattern: str, first: str) -> None:
    texts = list(fitting(pattern))
    assert texts[0] == first
    assert all(re.search(pattern, text) for text in texts)


@pytest.mark.parametrize("pattern", ["^unit-[0-9]{3}$", "^[a-z]([a-z0-9-]*[a-z0-9])?$", "^(a|b)$"])
def test_texts_differ(pattern: str) -> None:
    assert len(set(fitting(pattern))) > 1


@pytest.mark.parametrize(
    "pattern",
    ["(", "a{1000000}", "((a{99}){99}){99}", "[^\\s\\S]", "(" * 5000 + ")" * 5000, "a{99999999999999999999}"],
    ids=lambda pattern: pattern[:20],
)
def test_no_text_for_what_is_no_pattern_or_too_long(pattern: str) -> None:
    assert list(fitting(pattern)) == []


WORDS = st.sampled_from(["a", "[0-9]", "\\w", "[^b]", "(ab|c)", "(?:x)?", ".", "d*", "e{2,3}", "-"])


@given(st.lists(WORDS, max_size=12).map("".join))
def test_random_patterns(pattern: str) -> None:
    texts = list(fitting(f"^{pattern}$"))
    assert texts
    assert all(re.fullmatch(pattern, text) and len(text) <= CHARACTERS_MAX for text in texts)
