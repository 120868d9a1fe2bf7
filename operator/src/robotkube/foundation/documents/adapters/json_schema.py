"""JSON Schema by jsonschema: problems as sentences that name the key; nothing is loaded.

A schema without `$schema` is read as draft 2020-12. Compiled schemas are kept: the gate asks for the same ones again
and again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import islice
from typing import Any

import jsonschema
from jsonschema import Draft202012Validator, validators
from jsonschema.validators import validator_for
from referencing import Registry

PROBLEMS_MAX = 20
SCHEMAS_CACHED_MAX = 512
ITEMS_CACHED_MAX = 20_000
OBJECTS_CACHED_MAX = 64


def check_schema(schema: Mapping[str, Any]) -> Sequence[str]:
    """The problems of the schema itself."""
    try:
        validator_for(schema, default=Draft202012Validator).check_schema(dict(schema))
    except jsonschema.SchemaError as error:
        return [f"schema: {error.json_path}: {error.message:.300}"]
    except Exception as error:  # `$schema` that is no text, a pattern that is no regular expression, ...
        return [f"schema: {type(error).__name__}: {error}"]
    return []


@lru_cache(SCHEMAS_CACHED_MAX)
def _compiled(text: str) -> tuple[Any, Sequence[str]]:
    """The validator of a schema's JSON text, and the schema's problems; None when it has any."""
    schema = json.loads(text)
    broken = check_schema(schema)
    if broken:
        return None, broken
    plain = validator_for(schema, default=Draft202012Validator)
    once = {"items": _items_once(plain.VALIDATORS["items"])}
    return validators.extend(plain, once)(schema, registry=Registry()), broken  # type: ignore[no-untyped-call]


def _items_once(plain: Any) -> Any:
    """The keyword `items` for one schema; what is valid is checked once: long lists grow by few items at a time."""
    valid: dict[tuple[int, str], None] = {}

    def check(validator: Any, items: Any, instance: Any, schema: Any) -> Iterator[Any]:
        if not isinstance(items, dict) or not isinstance(instance, list) or "prefixItems" in schema:
            yield from plain(validator, items, instance, schema)
            return
        for index, item in enumerate(instance):
            key = (id(items), json.dumps(item, sort_keys=True))  # the schema stays as long as this dictionary
            if key not in valid:
                errors = list(validator.descend(item, items, path=index))
                yield from errors
                if not errors and len(valid) < ITEMS_CACHED_MAX:
                    valid[key] = None

    return check


_validators: dict[int, tuple[Mapping[str, Any], Any, Sequence[str]]] = {}


def _validator(schema: Mapping[str, Any]) -> tuple[Any, Sequence[str]]:
    """The same as _compiled, by object: the same one is asked for again and again, and need not be written out each
    time."""
    known = _validators.get(id(schema))
    if known is None or known[0] is not schema:
        while len(_validators) >= OBJECTS_CACHED_MAX:
            _validators.pop(next(iter(_validators)))
        known = _validators[id(schema)] = (schema, *_compiled(json.dumps(schema, sort_keys=True)))
    return known[1], known[2]


def validate(schema: Mapping[str, Any], value: Any, name: str = "parameters") -> Sequence[str]:
    """Problems of `value`, which is called `name` in them, under `schema`, at most PROBLEMS_MAX; a broken schema is one
    problem."""
    validator, broken = _validator(schema)
    if broken:
        return broken
    try:
        errors = sorted(validator.iter_errors(value), key=lambda e: (list(map(str, e.path)), e.message))
    except Exception as error:  # an unresolvable reference raises types of another library
        return [f"schema: {error}"]
    return [f"{e.json_path.replace('$', name, 1)}: {e.message}" for e in errors[:PROBLEMS_MAX]]


def violations(schema: Mapping[str, Any], value: Any) -> Sequence[tuple[tuple[str | int, ...], str]]:
    """Path and message of every place where `value` breaks `schema`, at most PROBLEMS_MAX; a broken schema is one
    violation at the empty path."""
    validator, broken = _validator(schema)
    if broken:
        return [((), message) for message in broken]
    try:
        errors = list(islice(validator.iter_errors(value), PROBLEMS_MAX))
    except Exception as error:  # an unresolvable reference raises types of another library
        return [((), f"schema: {error}")]
    return sorted(
        ((tuple(e.absolute_path), e.message) for e in errors), key=lambda violation: (str(violation[0]), violation[1])
    )
