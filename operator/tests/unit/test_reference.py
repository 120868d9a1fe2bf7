"""The generated reference is that of the schemas as they are."""

from __future__ import annotations

import copy

import pytest

from ci import command_reference, detector_reference, reference, rule_reference


def test_the_page_is_current() -> None:
    assert reference.PAGE.read_text(encoding="utf-8") == reference.page(reference.read_schemas()), "run: make reference"


def test_the_page_of_metrics_is_current() -> None:
    assert reference.METRICS_PAGE.read_text(encoding="utf-8") == reference.metrics_page(), "run: make reference"


def test_the_page_of_rules_is_current() -> None:
    assert rule_reference.PAGE.read_text(encoding="utf-8") == rule_reference.page(), "run: make reference"


def test_the_metrics_of_the_detector_are_current() -> None:
    text = detector_reference.PAGE.read_text(encoding="utf-8")
    assert text == detector_reference.page(text), "run: make reference"
    with pytest.raises(ValueError, match="needs both marks"):
        detector_reference.page("nothing")


def test_the_commands_are_current() -> None:
    text = command_reference.PAGE.read_text(encoding="utf-8")
    assert text == command_reference.page(text), "run: make reference"


def test_commands_are_written_between_the_marks_only() -> None:
    begin, end = command_reference.BEGIN, command_reference.END
    found = command_reference.page(f"before\n{begin}\nold\n{end}\nafter\n")
    assert found.startswith(f"before\n{begin}\n")
    assert found.endswith(f"{end}\nafter\n")
    assert "old\n" not in found.partition(begin)[2].partition("###")[0]
    assert "### robotkube task submit" in found
    assert "`--policy Reject\\|Postpone\\|Offload\\|Preempt`" in found
    with pytest.raises(ValueError, match="needs both marks"):
        command_reference.page("nothing")


def test_every_schema_has_a_chapter() -> None:
    assert set(reference.ORDER) == set(reference.read_schemas())


def test_a_new_key_is_on_the_page() -> None:
    schemas = copy.deepcopy(reference.read_schemas())
    schemas["release-policy"]["properties"]["colour"] = {"enum": ["red", "blue"], "description": "of the report"}  # type: ignore[index]
    assert "| `colour` | | `red`, `blue` | of the report |" in reference.page(schemas)
