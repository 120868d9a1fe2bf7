"""The reader of one mapping, key by key: every problem with its key and fix, refused with the file's name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.reader import NAME_LENGTH_MAX, MappingReader, Reader

Read = Callable[[MappingReader], Any]


@pytest.mark.parametrize(
    ("value", "read", "expected"),
    [
        ("a", lambda item: item.text("key"), "a"),
        (None, lambda item: item.text("key", ""), ""),
        ("a.b", lambda item: item.name("key"), "a.b"),
        ("b", lambda item: item.choice("key", ("a", "b")), "b"),
        (None, lambda item: item.choice("key", ("a", "b"), "a"), "a"),
        (1.5, lambda item: item.number("key", 0, 1.5), 1.5),
        (5.0, lambda item: item.whole_number("key", 1, 5), 5),
        (True, lambda item: item.flag("key", False), True),
        (["a", "b"], lambda item: item.texts("key", 2), ("a", "b")),
        ({"any": 1}, lambda item: item.any_mapping("key"), {"any": 1}),
        ({"inner": "a"}, lambda item: item.mapping("key").text("inner"), "a"),
        ([{"inner": "a"}], lambda item: [mapping.text("inner") for mapping in item.mappings("key", 1)], ["a"]),
    ],
)
def test_a_value_that_fits_is_read(value: Any, read: Read, expected: Any) -> None:
    reader = Reader("file")
    item = reader.keys_of({} if value is None else {"key": value}, "root")
    assert read(item) == expected
    item.refuse_unknown_keys()
    reader.finish()


@pytest.mark.parametrize(
    ("value", "read", "problem"),
    [
        ("", lambda item: item.text("key"), "must be a text that is not empty"),
        ("A", lambda item: item.name("key"), "must be a name of at most 100 of a-z, 0-9, - and ."),
        ("a" * (NAME_LENGTH_MAX + 1), lambda item: item.name("key"), "must be a name of at most 100"),
        ("c", lambda item: item.choice("key", ("a", "b")), "must be one of a, b"),
        (2, lambda item: item.number("key", 0, 1.5), "must be a number from 0 to 1.5"),
        ("30m", lambda item: item.number("key", 0, 1.5), "not the text '30m'; without unit and quotes, as 30 or 1.5"),
        (True, lambda item: item.whole_number("key", 0, 5), "must be a whole number from 0 to 5"),
        (1.5, lambda item: item.whole_number("key", 0, 5), "must be a whole number from 0 to 5"),
        ("yes", lambda item: item.flag("key", False), "must be true or false"),
        (["a", "a"], lambda item: item.texts("key", 1), "must be a list of at least 1 different texts"),
        ([], lambda item: item.any_mapping("key"), "must be a mapping"),
        ([], lambda item: item.mapping("key"), "must be a mapping"),
        ([], lambda item: item.mappings("key", 2), "must be a list of 1 to 2 mappings"),
        ([{}] * 3, lambda item: item.mappings("key", 2, required=False), "must be a list of 0 to 2 mappings"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_with_file_key_and_fix(value: Any, read: Read, problem: str) -> None:
    reader = Reader("file")
    read(reader.keys_of({"key": value}, "root"))
    with pytest.raises(DocumentError) as refused:
        reader.finish()
    assert refused.value.where == "file"
    [sentence] = refused.value.problems
    assert sentence.startswith("root.key: ")
    assert problem in sentence


def test_a_key_that_is_missing() -> None:
    reader = Reader("file")
    item = reader.keys_of({})
    item.text("name")
    item.number("seconds", 0, 1)
    assert reader.problems == [
        "name: is missing; it must be a text that is not empty",
        "seconds: is missing; it must be a number from 0 to 1",
    ]


def test_a_key_that_nobody_asks_for() -> None:
    reader = Reader("file")
    [item] = reader.keys_of({"topics": [{"name": "a", "nmae": "b", 1: 2}]}).mappings("topics", 10)
    item.text("name")
    item.refuse_unknown_keys()
    assert reader.problems == [
        "topics[0].1: unknown key; known are name",
        "topics[0].nmae: unknown key; known are name",
    ]


def test_what_is_no_mapping_is_refused_once() -> None:
    reader = Reader("file")
    item = reader.keys_of([], "")
    item.refuse_unknown_keys()
    assert reader.problems == ["document: must be a mapping"]
