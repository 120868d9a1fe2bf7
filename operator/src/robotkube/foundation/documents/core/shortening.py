"""Long texts within a bound: the middle is left out, since a log or a traceback names its cause in the last line."""

from __future__ import annotations

MARK = " … "
BEGINNING_SHARE = 0.4


def shortened(text: str, characters_max: int) -> str:
    """The text, or its beginning and its end with a mark between them: at most `characters_max` characters in all."""
    if len(text) <= characters_max:
        return text
    kept = characters_max - len(MARK)
    beginning = int(kept * BEGINNING_SHARE)
    return f"{text[:beginning]}{MARK}{text[beginning - kept :]}"
