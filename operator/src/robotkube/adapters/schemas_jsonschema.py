"""JSON Schema (draft 2020-12) by jsonschema: problems as sentences that name the key; nothing is loaded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jsonschema
from jsonschema import Draft202012Validator

PROBLEMS_MAX = 20


def check_schema(schema: Mapping[str, Any]) -> Sequence[str]:
    """What is wrong with the schema itself."""
    try:
        Draft202012Validator.check_schema(schema)
    except jsonschema.SchemaError as error:
        return [f"schema: {error.json_path}: {error.message}"]
    return []


def validate(schema: Mapping[str, Any], value: Any) -> Sequence[str]:
    """Problems of `value` under `schema`, at most PROBLEMS_MAX; a broken schema is one problem."""
    broken = check_schema(schema)
    if broken:
        return broken
    try:
        errors = sorted(
            Draft202012Validator(schema).iter_errors(value), key=lambda e: (list(map(str, e.path)), e.message)
        )
    except Exception as error:  # an unresolvable reference raises types of another library
        return [f"schema: {error}"]
    return [f"{e.json_path.replace('$', 'parameters', 1)}: {e.message}" for e in errors[:PROBLEMS_MAX]]
