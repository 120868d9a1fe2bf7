"""Reading JSON whatever its depth."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.foundation.documents.core.json_codec import LEVELS_MAX, _flattened, read_json

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


@pytest.mark.parametrize("levels", [1, LEVELS_MAX, 900, 100_000])
def test_any_depth_is_read_and_the_rest_of_the_document_stays(levels: int) -> None:
    text = '{"items": [{"a": ' + '[{"b":' * levels + '"]["' + "}]" * levels + '}, {"name": "\\"{[ other"}]}'
    found = read_json(text)
    assert found["items"][1] == {"name": '"{[ other'}
    assert 1 < depth(found) <= 2000


@given(JSON)
def test_what_is_not_deep_is_not_touched(value: Any) -> None:
    text = json.dumps(value)
    assert _flattened(text) == text


@pytest.mark.parametrize("text", ["", "[" * 100_000, "}", "[" * 100_000 + "]" * 5, "nul"])
def test_what_is_no_json_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        read_json(text)


def test_bytes_are_read_as_text_is() -> None:
    deep = b"[" * 5000 + b"]" * 5000
    assert depth(read_json(deep)) == LEVELS_MAX
