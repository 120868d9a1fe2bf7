"""Written YAML is what the library writes, character by character."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from robotkube.foundation.documents.core.yaml_codec import write_mapping, write_with_library

words = st.text(max_size=12) | st.text(alphabet="ab \"'\\:#-{}[]%&*!|>?@`,~=<.0e1\n\t", max_size=12)
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | words
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(words, inner, max_size=4), max_leaves=20
)


@given(st.dictionaries(words, values, max_size=5))
def test_every_document_is_written_as_the_library_writes_it(document: dict[str, Any]) -> None:
    assert write_mapping(document) == write_with_library(document)


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"a": {}, "b": [], "c": [[], {}, [[]]], "d": [[1, [2, {"x": [{"y": None}]}]], ()]},
        {"yes": "no", "NULL": "~", "12e34567": "0x1f", "a b": "a  b", "": "", "x" * 200: "y" * 300, "list": (1, 2)},
        {"text": 'a "quoted" back\\slash', "lines": "a\nb", "umlaut": "ä", "wide": "😀", "s": " a ", "z": "a b " * 999},
        {"annotations": {"robotkube.io/parameters": '[{"vehicles":["vehicle-00"]}]'}, "number": 1.5, "whole": -3},
    ],
)  # fmt: skip
def test_unusual_documents(document: dict[str, Any]) -> None:
    text = write_mapping(document)
    assert text == write_with_library(document)
    assert yaml.safe_load(text) is not None
