"""`make reference`: docs/reference/schemas.md from the JSON Schemas of registry/schemas/."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ci.docs import markdown
from ci.folders import PROJECT

SCHEMAS = PROJECT / "registry" / "schemas"
PAGE = PROJECT / "docs" / "reference" / "schemas.md"
ORDER = ("application", "chart-version", "release-policy", "verification-policy")
HEAD = """# Schemas of the catalogue

Written by `make reference` from `registry/schemas/`; a test says when this page is not current. What the entries mean
and what `robotkube registry validate` checks besides: [catalogue](catalogue.md). What may stand in templates:
[contracts](contracts.md#catalogue). Lists hold at most 256 items where nothing else is said.
"""

Schema = Mapping[str, Any]
Row = tuple[str, str, str, str]
"""Key, whether it is required, what may stand there, what it means."""


def page(schemas: Mapping[str, Schema]) -> str:
    """The whole page; `schemas` by file name without suffix."""
    text = "\n".join([HEAD, *(line for name in ORDER for line in _chapter(name, schemas[name]))]).rstrip() + "\n"
    return markdown.wrapped(text)


def read_schemas() -> dict[str, Schema]:
    """The schemas of this repository. Raises KeyError later when ORDER misses one or names one that is not there."""
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(SCHEMAS.glob("*.json"))}


def _chapter(name: str, schema: Schema) -> Iterator[str]:
    yield from [f"## {_title(name)}", "", f"{schema['title']}. {schema.get('description', '')}".strip(), ""]
    yield from _table(list(_rows(name, schema, schema, "")))
    yield from _patterns(name, schema)
    for part, inner in schema.get("$defs", {}).items():
        if _is_object(inner):
            yield from [f"### {_title(name)}: {part}", ""]
            yield from [f"{inner['description']}", ""] if "description" in inner else []
            yield from _table(list(_rows(name, schema, inner, "")))


def _patterns(name: str, schema: Schema) -> Iterator[str]:
    """The patterns of texts that many keys share, by the word that stands for them."""
    shared = [(part, inner) for part, inner in schema.get("$defs", {}).items() if "pattern" in inner]
    for part, inner in shared:
        meaning = f": {inner['description']}" if "description" in inner else ""
        yield f"- *{part}* is a text `{inner['pattern']}`{meaning}"
    if shared:
        yield ""


def _title(name: str) -> str:
    return name.replace("-", " ").capitalize()


def _table(rows: Sequence[Row]) -> Iterator[str]:
    yield "| key | | value | meaning |"
    yield "| --- | --- | --- | --- |"
    yield from ("| " + " | ".join(cell.replace("|", "\\|") for cell in row).replace("  ", " ") + " |" for row in rows)
    yield ""


def _rows(name: str, root: Schema, schema: Schema, path: str) -> Iterator[Row]:
    required = schema.get("required", ())
    for key, inner in schema.get("properties", {}).items():
        if inner is False:
            continue
        full = f"{path}.{key}" if path else key
        yield f"`{full}`", "required" if key in required else "", _value(name, root, inner), _meaning(root, inner)
        if "$ref" not in inner:
            yield from _rows(name, root, inner, full)
            items = inner.get("items", {})
            if "$ref" not in items:
                yield from _rows(name, root, items, f"{full}[]")


def _meaning(root: Schema, schema: Schema) -> str:
    own = schema.get("description", "")
    return str(own or _definition(root, schema).get("description", "") if not _names_object(root, schema) else own)


def _definition(root: Schema, schema: Schema) -> Schema:
    reference = schema.get("$ref", "")
    definition: Schema = root["$defs"][reference.removeprefix("#/$defs/")] if reference else {}
    return definition


def _names_object(root: Schema, schema: Schema) -> bool:
    return _is_object(_definition(root, schema))


def _is_object(schema: Schema) -> bool:
    """Return whether a definition has keys of its own, so that it gets a table; conditions (`required` alone) get
    none."""
    return schema.get("type") == "object" and "properties" in schema


def _value(name: str, root: Schema, schema: Schema) -> str:
    """What may stand there, in words."""
    if "$ref" in schema:
        part = schema["$ref"].removeprefix("#/$defs/")
        inner = root["$defs"][part]
        if "pattern" in inner:
            return f"*{part}*"
        return _link(name, part) if _is_object(inner) else _value(name, root, inner)
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join(f"`{word}`" for word in schema["enum"])
    choices = schema.get("oneOf") or schema.get("anyOf")
    if choices and all(set(choice) != {"required"} for choice in choices):
        return " or ".join(_choice(name, root, choice) for choice in choices)
    return _plain(name, root, schema)


def _choice(name: str, root: Schema, schema: Schema) -> str:
    if "properties" in schema:
        required = schema.get("required", ())
        return "{" + ", ".join(f"{key}{'' if key in required else '?'}" for key in schema["properties"]) + "}"
    return _value(name, root, schema)


def _link(name: str, part: str) -> str:
    anchor = f"{_title(name)}: {part}".lower().replace(":", "").replace(" ", "-")
    return f"[{part}](#{anchor})"


def _plain(name: str, root: Schema, schema: Schema) -> str:
    kind = schema.get("type", "anything")
    if kind == "array":
        return f"list of {_value(name, root, schema['items'])}{_bounds(schema, 'minItems', 'maxItems')}"
    if kind == "string":
        return f"text `{schema['pattern']}`" if "pattern" in schema else "text"
    if kind == "object":
        return f"mapping{_bounds(schema, 'minProperties', 'maxProperties')}"
    words = {"integer": "whole number", "number": "number", "boolean": "`true`, `false`"}
    return words.get(kind, "anything") + _bounds(schema, "minimum", "maximum")


def _bounds(schema: Schema, least: str, most: str) -> str:
    words = [f"at least {schema[least]}"] if least in schema else []
    words += [f"at most {schema[most]}"] if most in schema and schema[most] != 256 else []
    return f" ({', '.join(words)})" if words else ""
