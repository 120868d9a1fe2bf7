"""Expressions of rules of kind cel: the names that they may use, and the check before one is accepted."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robotkube.robots.rules.core.specification.specifications import PAIR, Cel

NamedExpression = tuple[str, tuple[str, ...]]
"""An expression and the names that it may use; of a pair `a.x` and `b.x`."""
CheckExpressions = Callable[[Sequence[NamedExpression]], Sequence[str]]
"""A function that gives the problem of each expression, empty when there is none."""


def usable_names(settings: Cel, scope: str) -> tuple[str, ...]:
    """The names that the expressions of a rule may use."""
    names = (*settings.fields, "agent")
    return tuple(f"{member}.{name}" for member in "ab" for name in names) if scope == PAIR else names
