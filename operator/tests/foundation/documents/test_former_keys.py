"""Former keys: read under the key of today, refused beside it, and named as they stand in the document."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.foundation.documents.core.former_keys import FormerKey, under_new_keys

TOP = FormerKey("rooms", "test_namespaces")
BELOW = FormerKey("hook_reader", "hook_readers", "argocd", convert=lambda value: [value])
BOTH = "rooms: is the former name of test_namespaces, which is there as well"


@pytest.mark.parametrize(
    ("written", "today"),
    [
        ({"rooms": [1], "a": 2}, {"test_namespaces": [1], "a": 2}),
        ({"rooms": None}, {"test_namespaces": None}),
        ({"argocd": {"hook_reader": "server", "a": 1}}, {"argocd": {"hook_readers": ["server"], "a": 1}}),
        ({"argocd": {"hook_reader": None}}, {"argocd": {"hook_readers": [None]}}),
    ],
)
def test_a_former_key_is_read_under_the_key_of_today(written: dict[str, Any], today: dict[str, Any]) -> None:
    renamed = under_new_keys(written, [TOP, BELOW])
    assert renamed.document == today
    assert renamed.problems == ()
    assert [former in renamed.written for former in (TOP, BELOW)] == ["rooms" in written, "argocd" in written]


@pytest.mark.parametrize(
    "document", [{}, {"test_namespaces": [1]}, {"argocd": None}, {"argocd": "hook_reader"}, {"argocd": [1]}]
)
def test_a_document_without_former_keys_stays_as_it_is(document: dict[str, Any]) -> None:
    renamed = under_new_keys(document, [TOP, BELOW])
    assert (renamed.document, renamed.written, renamed.problems) == (document, (), ())


@pytest.mark.parametrize(
    ("former", "now", "kept", "problem"),
    [
        ([1], [2], [2], f"{BOTH}; remove rooms"),
        ([1], [1], [1], f"{BOTH}; remove rooms"),
        (None, [2], [2], f"{BOTH}; remove rooms"),
        (None, None, None, f"{BOTH}; remove rooms"),
        ([1], None, [1], f"{BOTH}, without a value; give it what rooms has and remove rooms"),
    ],
)
def test_a_key_under_both_names_is_refused_also_when_one_is_empty(
    former: Any, now: Any, kept: Any, problem: str
) -> None:
    renamed = under_new_keys({"rooms": former, "test_namespaces": now}, [TOP])
    assert renamed.problems == (problem,)
    assert renamed.document == {"test_namespaces": kept}


def test_a_problem_names_the_key_as_it_stands_in_the_document() -> None:
    renamed = under_new_keys({"rooms": [], "argocd": {"hook_reader": 1}}, [TOP, BELOW])
    end = " (rooms is the former name of test_namespaces)"
    assert renamed.as_written("test_namespaces: must be a list") == f"rooms: must be a list{end}"
    assert renamed.as_written("test_namespaces[0].domain_id: missing") == f"rooms[0].domain_id: missing{end}"
    assert renamed.as_written("argocd.hook_readers: missing") == (
        "argocd.hook_reader: missing (argocd.hook_reader is the former name of argocd.hook_readers)"
    )
    for other in ("test_namespaces_max: missing", "argocd.hook: missing", "agent: missing"):
        assert renamed.as_written(other) == other


def test_a_document_is_not_changed() -> None:
    document = {"rooms": [1], "argocd": {"hook_reader": "server"}}
    under_new_keys(document, [TOP, BELOW])
    assert document == {"rooms": [1], "argocd": {"hook_reader": "server"}}
