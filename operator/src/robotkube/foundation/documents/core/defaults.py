"""Defaults of a JSON schema, filled in where a document leaves them out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def with_defaults(schema: Mapping[str, Any], parameters: Mapping[str, Any]) -> dict[str, Any]:
    """`parameters` with the schema's top-level defaults where a key is missing."""
    properties = schema.get("properties", {})
    defaults = {
        key: rule["default"] for key, rule in properties.items() if isinstance(rule, Mapping) and "default" in rule
    }
    return {**defaults, **parameters}
