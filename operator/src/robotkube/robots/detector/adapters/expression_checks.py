"""Checks of expressions by a process of its own, whose results are cached."""

from __future__ import annotations

from collections.abc import Sequence

from robotkube.robots.rules.core.specification.expressions import Check, Checked


class CachedExpressionCheck:
    """A check of expressions that remembers results, since a check takes a second. `check`: that of a process of its
    own when none is given."""

    def __init__(self, check: Check | None = None) -> None:
        self._check = check or _check_in_process
        self._known: dict[Checked, str] = {}

    def __call__(self, texts: Sequence[Checked]) -> Sequence[str]:
        """The problem of each expression, empty when there is none."""
        known = {text: self._known[text] for text in texts if text in self._known}
        new = [text for text in dict.fromkeys(texts) if text not in known]
        self._known = {**known, **(dict(zip(new, self._check(new), strict=True)) if new else {})}
        return [self._known[text] for text in texts]


def _check_in_process(texts: Sequence[Checked]) -> Sequence[str]:
    from robotkube.robots.rules import host  # only when there are expressions: it imports what starts processes

    return host.check_expressions(texts)
