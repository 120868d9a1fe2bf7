"""Checks of expressions by a process of its own, whose results are cached."""

from __future__ import annotations

from collections.abc import Sequence

from robotkube.robots.rules.core.specification.expressions import CheckExpressions, NamedExpression


class CachedExpressionCheck:
    """A check of expressions that remembers results, since a check takes a second. `check`: that of a process of its
    own when none is given."""

    def __init__(self, check: CheckExpressions | None = None) -> None:
        self._check = check or _check_in_process
        self._known: dict[NamedExpression, str] = {}

    def __call__(self, expressions: Sequence[NamedExpression]) -> Sequence[str]:
        """The problem of each expression, empty when there is none."""
        known = {expression: self._known[expression] for expression in expressions if expression in self._known}
        new = [expression for expression in dict.fromkeys(expressions) if expression not in known]
        self._known = {**known, **(dict(zip(new, self._check(new), strict=True)) if new else {})}
        return [self._known[expression] for expression in expressions]


def _check_in_process(expressions: Sequence[NamedExpression]) -> Sequence[str]:
    from robotkube.robots.rules import host  # only when there are expressions: it imports what starts processes

    return host.check_expressions(expressions)
