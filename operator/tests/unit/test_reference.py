"""The generated reference is that of the schemas as they are."""

from __future__ import annotations

import copy

from ci import reference


def test_the_page_is_current() -> None:
    assert reference.PAGE.read_text(encoding="utf-8") == reference.page(reference.read_schemas()), "run: make reference"


def test_the_page_of_metrics_is_current() -> None:
    assert reference.METRICS_PAGE.read_text(encoding="utf-8") == reference.metrics_page(), "run: make reference"


def test_every_schema_has_a_chapter() -> None:
    assert set(reference.ORDER) == set(reference.read_schemas())


def test_a_new_key_is_on_the_page() -> None:
    schemas = copy.deepcopy(reference.read_schemas())
    schemas["release-policy"]["properties"]["colour"] = {"enum": ["red", "blue"], "description": "of the report"}  # type: ignore[index]
    assert "| `colour` | | `red`, `blue` | of the report |" in reference.page(schemas)
