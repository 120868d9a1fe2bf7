"""JSON is read to a bounded depth: refused beyond it, or shortened."""

import json
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.foundation.documents.core.json_codec import LEVELS_MAX, _flattened, read_json, read_json_shortened

PROCESSOR_SECONDS_MAX = 2.0

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
)


def depth(value: Any) -> int:
    levels = 0
    while isinstance(value, (list, dict)) and value:
        value = value[0] if isinstance(value, list) else next(iter(value.values()))
        levels += 1
    return levels


def nested(levels: int) -> str:
    """Lists and objects in each other, with a text that has brackets inside."""
    pairs = levels // 2
    inner = "[]" if levels % 2 else '"]["'
    return '[{"b":' * pairs + inner + "}]" * pairs


@pytest.mark.parametrize("levels", [1, LEVELS_MAX - 1, LEVELS_MAX])
def test_a_document_of_the_most_levels_is_read_by_both(levels: int) -> None:
    text = nested(levels)
    assert read_json(text) == read_json_shortened(text) == json.loads(text)
    assert read_json(text.encode()) == json.loads(text)


@pytest.mark.parametrize("levels", [LEVELS_MAX + 1, LEVELS_MAX + 2, 900, 5000, 100_000])
def test_what_is_nested_deeper_is_refused(levels: int) -> None:
    for text in (nested(levels), nested(levels).encode(), f'{{"a": 1, "b": {nested(levels - 1)}}}'):
        with pytest.raises(ValueError, match="nested deeper than 100 levels; write it flatter"):
            read_json(text)


@pytest.mark.parametrize("levels", [1, LEVELS_MAX, LEVELS_MAX + 1, 900, 100_000])
def test_what_is_nested_deeper_is_shortened_and_the_rest_of_the_document_stays(levels: int) -> None:
    text = '{"items": [{"a": ' + nested(levels) + '}, {"name": "\\"{[ other"}]}'
    document = read_json_shortened(text)
    assert document["items"][1] == {"name": '"{[ other'}
    assert 1 < depth(document) <= LEVELS_MAX


@given(JSON)
def test_what_is_not_deep_is_not_touched(value: Any) -> None:
    text = json.dumps(value)
    assert _flattened(text) == text
    assert read_json(text) == read_json_shortened(text) == value


@pytest.mark.parametrize("text", ["", "[" * 100_000, "}", "[" * 100_000 + "]" * 5, "nul", b"\xff", "[" + "9" * 5000])
def test_what_is_no_json_is_a_value_error(text: str | bytes) -> None:
    for read in (read_json, read_json_shortened):
        with pytest.raises(ValueError, match=r"."):
            read(text)


def test_a_text_without_end_is_looked_for_once() -> None:
    begin = time.process_time()
    with pytest.raises(ValueError, match=r"."):
        read_json_shortened("[" * 100_000 + '"' + '\\"' * 500_000)
    assert time.process_time() - begin < PROCESSOR_SECONDS_MAX


def test_many_documents_beside_each_other_are_not_deep() -> None:
    flat = [[{}]] * 1000
    assert read_json(json.dumps(flat)) == flat


def test_pairs_and_constants_are_read_as_asked() -> None:
    assert read_json('{"a": NaN, "a": 1}', list, str) == [("a", "NaN"), ("a", 1)]


def test_bytes_are_shortened_as_text_is() -> None:
    deep = b"[" * 5000 + b"]" * 5000
    assert depth(read_json_shortened(deep)) == LEVELS_MAX
