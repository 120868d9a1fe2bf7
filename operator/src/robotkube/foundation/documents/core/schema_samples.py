"""Sample values of a JSON Schema: enough to try every template with, few enough to try them all.

Only what the schema itself accepts is a sample, so a wrong guess costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

from robotkube.foundation.documents.core.pattern_samples import fitting

Validate = Callable[[Mapping[str, Any], Any], Sequence[str]]

OBJECTS_MAX = 24
VALUES_MAX = 12
TRIALS_MAX = 2000
DEPTH_MAX = 6
ITEMS_MAX = 100

_TEXTS = (
    "vehicle-00", "vehicle-01", "cloud-0", "text", "a", "A", "0", "1", "0.1.0", "/a", "/vehicles/vehicle_00/pose",
    "a/b", "vehicle_00", "a.b", "std_msgs/msg/String", "2026-11-21T10:00:00Z", "10s", "100m", "1Mi",
    "https://example.org", "",
)  # fmt: skip
_NUMBERS = (1, 0, 2, 10, 100, 1000, 0.5, -1)
_TYPES = ("object", "string", "integer", "boolean", "array", "null")
_CHOICES = ("anyOf", "oneOf", "allOf")
_BOUNDS = (("minimum", 0), ("exclusiveMinimum", 1), ("maximum", 0), ("exclusiveMaximum", -1))


class Sampler:
    """The sampler of one schema and its parts; asks `validate` at most TRIALS_MAX times."""

    def __init__(self, root: Mapping[str, Any], validate: Validate) -> None:
        self._root = root
        self._validate = validate
        self._trials = TRIALS_MAX
        self._shared = {key: root[key] for key in ("$defs", "definitions") if key in root}
        properties = _mapping(root.get("properties"))
        self.properties = {key: self._values(inner) for key, inner in properties.items() if isinstance(inner, Mapping)}
        """Property -> values that its schema accepts; none when no guess fitted."""

    def objects(self) -> list[dict[str, Any]]:
        """Objects that the schema accepts: only what is required, everything, and each value of each property."""
        required = _list(self._root.get("required"))
        least = {k: self.properties[k][0] for k in required if isinstance(k, str) and self.properties.get(k)}
        most = {key: values[0] for key, values in self.properties.items() if values}
        varied = ({**most, key: value} for key, values in self.properties.items() for value in values[1:])
        samples: list[dict[str, Any]] = []
        for candidate in (least, most, *islice(varied, OBJECTS_MAX)):
            if candidate not in samples and self._accepted(self._root, candidate):
                samples.append(candidate)
        return samples

    def _accepted(self, schema: Mapping[str, Any], value: Any) -> bool:
        self._trials -= 1
        return self._trials >= 0 and not self._validate(schema, value)

    def _values(self, schema: Mapping[str, Any], depth: int = 0) -> list[Any]:
        """A few values that `schema` accepts; the author's own (default, examples) first."""
        whole = {**schema, **self._shared}
        accepted: list[Any] = []
        candidates = self._candidates(schema, depth) if depth <= DEPTH_MAX and self._trials > 0 else ()
        for candidate in islice(candidates, 4 * VALUES_MAX):
            known = any(candidate == other and type(candidate) is type(other) for other in accepted)
            if not known and self._accepted(whole, candidate):
                accepted.append(candidate)
            if len(accepted) >= VALUES_MAX:
                break
        return accepted

    def _candidates(self, schema: Mapping[str, Any], depth: int) -> Iterator[Any]:
        closed = [*_list(schema.get("enum")), *([schema["const"]] if "const" in schema else ())]
        yield from ([schema["default"]] if "default" in schema else ())
        yield from _list(schema.get("examples"))
        yield from closed
        referred = self._referred(schema.get("$ref"))
        if referred is not None:
            yield from self._values(referred, depth + 1)
        plain = {key: value for key, value in schema.items() if key not in (*_CHOICES, "default", "examples")}
        for inner in (item for key in _CHOICES for item in _list(schema.get(key)) if isinstance(item, Mapping)):
            yield from self._values({**plain, **inner}, depth + 1)
        if not closed and referred is None:
            kinds = schema.get("type", _TYPES)
            for kind in (kinds,) if isinstance(kinds, str) else kinds if isinstance(kinds, (list, tuple)) else ():
                yield from self._of_type(kind, schema, depth)

    def _of_type(self, kind: Any, schema: Mapping[str, Any], depth: int) -> Iterator[Any]:
        if kind == "string":
            yield from _texts(schema)
        elif kind in ("integer", "number"):
            yield from _numbers(schema, kind == "integer")
        elif kind in ("boolean", "null"):
            yield from (False, True) if kind == "boolean" else (None,)
        elif kind == "array":
            yield from self._lists(schema, depth)
        elif kind == "object":
            yield from self._mappings(schema, depth)

    def _lists(self, schema: Mapping[str, Any], depth: int) -> Iterator[Any]:
        inner = schema.get("items")
        values = self._values(inner, depth + 1) if isinstance(inner, Mapping) else list(_TEXTS[:2])
        least = schema.get("minItems")
        least = least if isinstance(least, int) and 0 <= least <= ITEMS_MAX else 0
        for count in dict.fromkeys((max(least, 1), least + 1, least)):
            if values or not count:
                yield [values[index % len(values)] for index in range(count)]

    def _mappings(self, schema: Mapping[str, Any], depth: int) -> Iterator[Any]:
        properties = islice(_mapping(schema.get("properties")).items(), ITEMS_MAX)
        values = {key: self._values(inner, depth + 1) for key, inner in properties if isinstance(inner, Mapping)}
        required = [key for key in _list(schema.get("required")) if isinstance(key, str)]
        yield {key: values[key][0] for key in required if values.get(key)}
        yield {key: candidates[0] for key, candidates in values.items() if candidates}

    def _referred(self, reference: Any) -> Mapping[str, Any] | None:
        """The part of the root that a local reference names."""
        if not isinstance(reference, str) or not reference.startswith("#/"):
            return None
        target: Any = self._root
        for part in reference.removeprefix("#/").split("/"):
            target = _mapping(target).get(part.replace("~1", "/").replace("~0", "~"))
        return target if isinstance(target, Mapping) else None


def _texts(schema: Mapping[str, Any]) -> Iterator[str]:
    if not {"pattern", "format", "minLength", "maxLength"} & set(schema):
        yield from _TEXTS[:2]
        return
    yield from _TEXTS
    if isinstance(schema.get("pattern"), str):
        yield from fitting(schema["pattern"])
    length = schema.get("minLength")
    if isinstance(length, int) and 0 < length <= ITEMS_MAX:
        yield "a" * length


def _numbers(schema: Mapping[str, Any], whole: bool) -> Iterator[Any]:
    for key, step in _BOUNDS:
        bound = schema.get(key)
        if isinstance(bound, (int, float)) and not isinstance(bound, bool):
            yield from (bound + step,) if whole else (bound + step, bound + step / 1000)
    if isinstance(schema.get("multipleOf"), (int, float)):
        yield schema["multipleOf"]
    yield from (number for number in _NUMBERS if not whole or isinstance(number, int))


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []
