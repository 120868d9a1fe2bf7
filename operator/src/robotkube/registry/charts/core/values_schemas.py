"""values.schema.json of a chart: strict, and with a description for every value.

A schema that lets unknown keys pass accepts a misspelt value in silence, and Helm, gate and manager all believe it. The
walk goes to every place at which a value is described; conditions (`if`, `allOf`, ...) only narrow such places
and are left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

DEPTH_MAX = 40
NODES_MAX = 20_000
DIALECTS = (
    "http://json-schema.org/draft-07/schema#",
    "https://json-schema.org/draft/2019-09/schema",
    "https://json-schema.org/draft/2020-12/schema",
)
SAMPLE_PLAN = "20000101-000000-000000"
NAMED = ("properties", "patternProperties", "$defs", "definitions")
NESTED = ("items", "additionalProperties", "additionalItems", "contains", "unevaluatedProperties")
LISTED = ("prefixItems", "anyOf", "oneOf")


class Validate(Protocol):
    """Problems of a value, which is called `name` in them, under a JSON Schema."""

    def __call__(self, schema: Mapping[str, Any], value: Any, name: str = ..., /) -> Sequence[str]:
        """At most a few dozen; none when the value is valid."""
        ...


def places(schema: Any, path: str = "values", depth: int = 0) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Every subschema that describes a value, with its path (`values.bridge.out[]`); stops at DEPTH_MAX."""
    if not isinstance(schema, Mapping) or depth > DEPTH_MAX:
        return
    yield path, schema
    for keyword in NAMED:
        for key, inner in _mapping(schema.get(keyword)).items():
            yield from places(inner, _joined(path, keyword, str(key)), depth + 1)
    for keyword in NESTED:
        if isinstance(schema.get(keyword), Mapping):
            yield from places(
                schema[keyword], f"{path}[]" if keyword != "additionalProperties" else f"{path}.*", depth + 1
            )
    for keyword in LISTED:
        for inner in schema.get(keyword) or () if isinstance(schema.get(keyword), list) else ():
            yield from places(inner, f"{path}[]" if keyword == "prefixItems" else path, depth + 1)


def _joined(path: str, keyword: str, key: str) -> str:
    return f"{path} {keyword}/{key}" if keyword.startswith(("$", "d")) else f"{path}.{key}"


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def strictness_problems(schema: Mapping[str, Any]) -> list[str]:
    """The places where unknown keys would pass or something outside the file is named, and what is no schema at all."""
    problems = []
    if schema.get("$schema") not in DIALECTS:
        problems.append(f"$schema: {schema.get('$schema')!r} is none of {', '.join(DIALECTS)}")
    if schema.get("type") != "object":
        problems.append("values: the schema's top level must say type: object")
    for number, (path, node) in enumerate(places(schema)):
        if number >= NODES_MAX:
            return [*problems, f"values: more than {NODES_MAX} places are described"]
        problems += [f"{path}: {problem}" for problem in _node_problems(node)]
    return problems + [f"$ref: {reference!r} is not in this file" for reference in sorted(_foreign_references(schema))]


def _node_problems(node: Mapping[str, Any]) -> Iterator[str]:
    if not is_object(node):
        return
    extra = node.get("additionalProperties")
    if node.get("properties") and extra is not False:
        yield "keys are described, but unknown ones pass"
    elif not node.get("properties") and "additionalProperties" not in node and not node.get("patternProperties"):
        yield "an object with any keys, and this is not said"


def is_object(node: Mapping[str, Any]) -> bool:
    """Return whether the subschema describes an object."""
    kind = node.get("type")
    return "properties" in node or kind == "object" or (isinstance(kind, list) and "object" in kind)


def _foreign_references(value: Any, depth: int = 0) -> set[str]:
    if depth > DEPTH_MAX:
        return {"(nested too deeply)"}
    if isinstance(value, Mapping):
        own = value.get("$ref")
        references = {own} if isinstance(own, str) and not own.startswith("#") else set()
        return references.union(*(_foreign_references(inner, depth + 1) for inner in value.values()))
    if isinstance(value, list):
        return set().union(*(_foreign_references(inner, depth + 1) for inner in value))
    return set()


def undescribed(schema: Mapping[str, Any]) -> list[str]:
    """Paths of the keys without a description."""
    return [
        f"{path}.{key}"
        for path, node in places(schema)
        for key, inner in _mapping(node.get("properties")).items()
        if not (isinstance(inner, Mapping) and (str(inner.get("description") or "").strip() or "$ref" in inner))
    ]


def unknown_values(schema: Mapping[str, Any], values: Mapping[str, Any]) -> list[str]:
    """Paths of the values that the schema does not name among its `properties`."""
    return list(_unknown(schema, schema, values, "values", 0))


def _unknown(root: Mapping[str, Any], node: Any, value: Any, path: str, depth: int) -> Iterator[str]:
    node = _resolved(root, node)
    if depth > DEPTH_MAX or not isinstance(value, Mapping) or not value:
        return
    named = _mapping(_mapping(node).get("properties"))
    if not named and "additionalProperties" in _mapping(node):
        return  # a free map, which says so
    for key, inner in value.items():
        if key not in named:
            yield f"{path}.{key}"
        else:
            yield from _unknown(root, named[key], inner, f"{path}.{key}", depth + 1)


def _resolved(root: Mapping[str, Any], node: Any, steps_left: int = 10) -> Any:
    reference = _mapping(node).get("$ref")
    if not isinstance(reference, str) or not reference.startswith("#") or not steps_left:
        return node
    target: Any = root
    for part in reference.removeprefix("#").strip("/").split("/"):
        target = _mapping(target).get(part.replace("~1", "/").replace("~0", "~"))
    return _resolved(root, target, steps_left - 1)


def names_value(schema: Mapping[str, Any], *path: str) -> bool:
    """Return whether the schema names the value at `path` among its `properties`."""
    node: Any = schema
    for key in path:
        named = _mapping(_mapping(_resolved(schema, node)).get("properties"))
        if key not in named:
            return False
        node = named[key]
    return True


def must_be_given(schema: Mapping[str, Any], path: tuple[str | int, ...], default: Any) -> bool:
    """Return whether the value at `path` is an empty text that stands for "must be given": its parent requires the
    key."""
    if default != "" or not path:
        return False
    node: Any = schema
    for part in path[:-1]:
        node = _resolved(schema, _mapping(_mapping(_resolved(schema, node)).get("properties")).get(str(part)))
    return path[-1] in (_mapping(_resolved(schema, node)).get("required") or ())


def overlay(base: Any, over: Any) -> Any:
    """`over` laid on `base` as Helm lays given values on a chart's: mappings are merged, null removes a key."""
    if not isinstance(base, Mapping) or not isinstance(over, Mapping):
        return over
    merged = {**base, **{key: overlay(base.get(key), value) for key, value in over.items()}}
    return {key: value for key, value in merged.items() if value is not None or key not in over}


def deployed(schema: Mapping[str, Any], values: Mapping[str, Any], plan: str = SAMPLE_PLAN) -> Any:
    """The values that Helm checks by a chart's `schema` when `values` are deployed by `plan`: laid over the chart's
    defaults, which the published schema carries."""
    return overlay(schema.get("default", {}), overlay(values, {"global": {"plan": plan}}))
