"""Validation remembers which items of lists are valid, and says the same as validation that remembers nothing."""

from __future__ import annotations

from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.foundation.documents.adapters.json_schema import validate

TOPIC = {
    "type": "object",
    "additionalProperties": False,
    "required": ["name"],
    "properties": {
        "name": {"type": "string", "pattern": "^/"},
        "depth": {"type": "integer"},
        "more": {"type": "array"},
    },
}
ITEMS: dict[str, Any] = {
    "draft-07": {"items": {"$ref": "#/$defs/topic"}},
    "newest": {"items": {"$ref": "#/$defs/topic"}, "maxItems": 3},
    "tuple": {"prefixItems": [{"type": "integer"}], "items": {"$ref": "#/$defs/topic"}},
    "closed": {"items": False},
    "nested": {"items": {"type": "array", "items": {"type": "integer"}}},
}
DIALECTS = {"draft-07": "http://json-schema.org/draft-07/schema#"}
SCHEMAS = {
    name: {
        "$schema": DIALECTS.get(name, "https://json-schema.org/draft/2020-12/schema"),
        "type": "array",
        "$defs": {"topic": TOPIC},
        **rule,
    }
    for name, rule in ITEMS.items()
}
topics = st.fixed_dictionaries(
    {"name": st.sampled_from(["/a", "/b", "c", 1])},
    optional={"depth": st.integers(0, 1) | st.booleans() | st.just(1.5)},
)
items = topics | st.integers() | st.lists(st.integers() | st.booleans(), max_size=2)


@pytest.mark.parametrize("name", sorted(SCHEMAS))
@given(st.lists(st.lists(items, max_size=5), max_size=4))
def test_what_was_valid_once_is_remembered_and_nothing_else(name: str, lists: list[list[Any]]) -> None:
    plain = jsonschema.validators.validator_for(SCHEMAS[name])(SCHEMAS[name])
    for value in lists:
        expected = sorted(error.message for error in plain.iter_errors(value))
        assert sorted(p.partition(": ")[2] for p in validate(SCHEMAS[name], value, "v")) == expected[:20]
        assert list(validate(SCHEMAS[name], value, "v")) == list(validate(dict(SCHEMAS[name]), value, "v"))


def test_the_place_of_an_item_is_named_each_time() -> None:
    good, bad = {"name": "/a"}, {"name": "a"}
    schema = SCHEMAS["draft-07"]
    assert [p.split(":")[0] for p in validate(schema, [good, bad], "v")] == ["v[1].name"]
    assert [p.split(":")[0] for p in validate(schema, [bad, good, bad], "v")] == ["v[0].name", "v[2].name"]
