"""Value templates: values whose texts are templates and whose lists may hold forEach.

A list item `{forEach: {vehicle: <list or template>}, each: [...]}` stands for the items of `each`, once per element.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from robotkube.errors import DocumentError

Render = Callable[[Any, Mapping[str, Any]], Any]
"""Renders every template in a JSON value with the names; raises DocumentError."""

FOR_EACH_MAX = 256
ITEMS_MAX = 10_000
FOR_EACH_KEYS = {"forEach", "each"}


def expand_for_each(for_each: Mapping[str, Any], names: Mapping[str, Any], render: Render) -> Iterator[dict[str, Any]]:
    """The names once per element of forEach's list; once as they are without forEach."""
    if not for_each:
        yield dict(names)
    for variable, template in for_each.items():
        values = render(template, names)
        if not isinstance(values, list) or len(values) > FOR_EACH_MAX:
            raise DocumentError(f"forEach {variable}", [f"must give a list of at most {FOR_EACH_MAX}: {values!r:.60}"])
        for value in values:
            yield {**names, variable: value}


def render_templates(value: Any, names: Mapping[str, Any], render: Render) -> Any:
    """`value` with every forEach expanded and every template rendered; DocumentError names the template or the
    forEach."""
    return _render_value(value, names, render, [ITEMS_MAX])


def _render_value(value: Any, names: Mapping[str, Any], render: Render, budget: list[int]) -> Any:
    budget[0] -= 1
    if budget[0] < 0:
        raise DocumentError("values", [f"more than {ITEMS_MAX} values; use shorter lists"])
    if isinstance(value, str):
        return render(value, names)
    if isinstance(value, Mapping):
        return {key: _render_value(item, names, render, budget) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rendered for item in value for rendered in _item(item, names, render, budget)]
    return value


def _item(item: Any, names: Mapping[str, Any], render: Render, budget: list[int]) -> Iterator[Any]:
    if not (isinstance(item, Mapping) and set(item) == FOR_EACH_KEYS):
        yield _render_value(item, names, render, budget)
        return
    if not isinstance(item["each"], list) or not isinstance(item["forEach"], Mapping) or len(item["forEach"]) != 1:
        raise DocumentError("values", ["forEach needs one variable and `each` needs a list"])
    for scope in expand_for_each(item["forEach"], names, render):
        for inner in item["each"]:
            yield from _item(inner, scope, render, budget)
