"""Random JSON to try what reads documents of others: any value, and good documents in which one value is another."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Any

from hypothesis import strategies as st

Place = tuple[str | int, ...]

VALUES: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=10), inner, max_size=3),
    max_leaves=8,
)


def mistaken(good: Mapping[str, Any]) -> st.SearchStrategy[Any]:
    """Any JSON value, and `good` with another value at one of its places, or without that place."""
    places = [place for place in _places(good) if place]
    changed = st.builds(lambda place, value: _replaced(good, place, value), st.sampled_from(places), VALUES)
    shortened = st.sampled_from(places).map(lambda place: _without(good, place))
    return VALUES | changed | shortened


def _places(value: Any) -> Iterator[Place]:
    yield ()
    items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        for place in _places(inner):
            yield key, *place


def _replaced(document: Any, place: Place, value: Any) -> Any:
    changed = copy.deepcopy(document)
    _parent(changed, place)[place[-1]] = value
    return changed


def _without(document: Any, place: Place) -> Any:
    changed = copy.deepcopy(document)
    del _parent(changed, place)[place[-1]]
    return changed


def _parent(document: Any, place: Place) -> Any:
    for key in place[:-1]:
        document = document[key]
    return document
