"""Schemas that take for ever are refused in words, and the next one is checked as if nothing had been."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.foundation.documents.adapters import json_schema
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping
from robotkube.foundation.runtime.adapters import bounded_process
from robotkube.foundation.runtime.adapters.bounded_process import BoundedProcess
from robotkube.registry.catalogue.adapters.bounded_validation import COMMAND, BoundedSchemas, ValidationAhead
from tests.stages.registry.answering import Answering
from tests.stages.registry.publication_in_memory import PublicationStage
from tests.stages.registry.submissions import application

GOOD = {"type": "object", "properties": {"name": {"type": "string", "pattern": "^[a-z]+$"}}}
SLOW = {"properties": {"name": {"pattern": "^(a+)+$"}}}
VALUE = {"name": "a" * 40 + "b"}
TOO_MUCH = "checking takes more than 1 s or 160 MiB; simplify patterns and references of the schema"
DOUBLING = {
    "$ref": "#/$defs/d0",
    "$defs": {
        **{f"d{n}": {"allOf": [{"$ref": f"#/$defs/d{n + 1}"}, {"$ref": f"#/$defs/d{n + 1}"}]} for n in range(40)},
        "d40": True,
    },
}
PROCESSOR_SECONDS_MAX = 10.0  # the process that checks ends after 1 s of it; its start before counts as well


def processor_seconds() -> float:
    """What this process and its ended children have used of the processor."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


@pytest.fixture(scope="module")
def schemas() -> Iterator[BoundedSchemas]:
    bounded = BoundedSchemas()
    yield bounded
    bounded.close()


@pytest.mark.parametrize("value", [{"name": "abc"}, {"name": "ABC"}, {"name": 3}, [], None])
def test_answers_are_those_of_the_library(schemas: BoundedSchemas, value: Any) -> None:
    tools = schemas.tools()
    assert schemas.validate(GOOD, value, "values") == json_schema.validate(GOOD, value, "values")
    assert tools.validate(GOOD, value) == json_schema.validate(GOOD, value)
    assert tools.violations(GOOD, value) == json_schema.violations(GOOD, value)
    assert tools.check_schema({"pattern": "("}) == json_schema.check_schema({"pattern": "("})


@pytest.fixture
def little(monkeypatch: pytest.MonkeyPatch) -> tuple[dict[str, Any], str]:
    """A schema and a value whose check is refused as one that takes too much, and takes no second to be."""
    monkeypatch.setattr(bounded_process, "ANSWER_BYTES_MAX", 100)
    return {"maxLength": 1}, "x" * 1000


def test_an_answer_beyond_the_bound_is_refused_and_the_next_is_checked(
    schemas: BoundedSchemas, little: tuple[dict[str, Any], str]
) -> None:
    [problem] = schemas.validate(*little, "spec.values")
    assert problem.startswith(f"spec.values: {TOO_MUCH}")
    assert schemas.validate(GOOD, {"name": "abc"}) == []


def test_of_the_tools_it_is_an_error(schemas: BoundedSchemas, little: tuple[dict[str, Any], str]) -> None:
    with pytest.raises(InputError, match="simplify patterns"):
        schemas.tools().validate(*little)


def test_calls_that_are_sent_ahead_are_answered_each_by_itself() -> None:
    """Also behind one that took too much, and when they or their answers are more than a pipe holds."""
    process = BoundedProcess(COMMAND)
    began = processor_seconds()
    long = {"name": ["x" * 10_000] * 5}
    values = [{"name": "abc"}, {"name": 3}, long, VALUE, {"name": "ABC"}, *[long] * 20, *[{"name": "abc"}] * 100]
    asked = [process.ask("validate", SLOW if value is VALUE else GOOD, value, "values") for value in values]
    answers = [one.result() for one in reversed(asked) if one.error is None and one is not asked[3]]
    others = [value for value in values if value is not VALUE]
    assert answers == [json_schema.validate(GOOD, value, "values") for value in reversed(others)]
    with pytest.raises(InputError, match=TOO_MUCH):
        asked[3].result()
    assert processor_seconds() - began < PROCESSOR_SECONDS_MAX
    late = process.ask("validate", GOOD, {"name": 3}, "values")
    process.close()
    assert late.result() == json_schema.validate(GOOD, {"name": 3}, "values")


def test_what_was_taken_for_valid_is_told_and_not_taken_for_it_again() -> None:
    process = Answering()
    ahead = ValidationAhead(process)
    bad, good = {"name": "ABC"}, {"name": "abc"}
    assert [ahead.validate(GOOD, value) for value in (good, bad)] == [[], []]
    assert not ahead.settled()
    problems = json_schema.validate(GOOD, bad)
    assert ahead.validate(GOOD, bad) == problems
    assert process.asked == 2, "what was refused is known"
    assert ahead.validate(GOOD, {"name": "ABD"}) != [], "until it is settled again, nothing is taken for valid"
    assert ahead.settled()
    assert ahead.validate(GOOD, {"name": "ABE"}) == []
    assert ahead.validate({**GOOD}, bad) == [], "another schema has answers of its own"
    assert not ahead.settled()


def test_what_takes_too_much_was_not_valid(schemas: BoundedSchemas, little: tuple[dict[str, Any], str]) -> None:
    ahead = schemas.ahead()
    assert ahead.validate(*little, "spec.values") == []
    assert not ahead.settled()
    assert ahead.validate(*little, "spec.values")[0].startswith(f"spec.values: {TOO_MUCH}")


def test_a_process_that_went_is_started_again() -> None:
    process = BoundedProcess(COMMAND)
    process.close()
    assert process.call("validate", GOOD, {"name": "abc"}, "values") == []
    process.close()
    process.close()


def test_a_submission_whose_schema_takes_for_ever_is_refused(schemas: BoundedSchemas, tmp_path: Path) -> None:
    stage = PublicationStage(tmp_path)
    stage.tools = schemas.tools()
    stage.start()
    path = "applications/relaying.yaml"
    document = read_mapping(application(), path)
    document["spec"]["parameters"] = {**document["spec"]["parameters"], **DOUBLING}
    number = stage.submit(**{path: write_mapping(document)})
    assert TOO_MUCH in stage.settle(number)
    assert not stage.merged(number)
