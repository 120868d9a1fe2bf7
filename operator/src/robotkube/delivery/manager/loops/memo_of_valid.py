"""The memo of composition, where values are checked while composing goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from robotkube.delivery.manager.core.composition.memo import Memo

T = TypeVar("T")


class MemoOfValid:
    """A memo of which only what stands on valid values is kept.

    The validation in the inputs of composition may take values for valid until `settled` waits for the answers and says
    whether all of them were. Once they were not, it takes none for valid until `settled` was asked once more.
    """

    def __init__(self, settled: Callable[[], bool]) -> None:
        self._settled = settled
        self._memo = Memo()

    def used(self, compute: Callable[[Memo], T]) -> T:
        """What `compute` gives, once more if values were not valid. An error that they may have caused is none."""
        memo, self._memo = self._memo, Memo()
        try:
            computed = compute(memo)
        except Exception:
            if self._settled():
                raise
        else:
            if self._settled():
                self._memo = memo
                return computed
        computed = compute(self._memo)
        self._settled()
        return computed
