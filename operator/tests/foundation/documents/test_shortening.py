"""Long texts keep their beginning and their end."""

import pytest

from robotkube.foundation.documents.core.shortening import shortened


@pytest.mark.parametrize(("characters", "kept"), [(10, "abcdefghij"), (9, "ab … ghij"), (4, " … j")])
def test_the_middle_goes(characters: int, kept: str) -> None:
    assert shortened("abcdefghij", characters) == kept
    assert len(shortened("abcdefghij" * 9, characters)) == characters
