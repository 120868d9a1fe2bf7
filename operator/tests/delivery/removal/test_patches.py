"""The patch that takes out of a Deployment what its chart does not render, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.removal.core.patches import restoring_patch
from tests.delivery.removal.examples import deployment, workload_target

TEMPLATE = "/spec/template/spec"
VERSION = {"op": "replace", "path": "/metadata/resourceVersion", "value": "7"}


def removed(*excess: str) -> list[str]:
    patch = restoring_patch(deployment(), workload_target(*excess))
    assert isinstance(patch, list)
    if patch:
        assert patch[0] == VERSION
        assert {one["op"] for one in patch[1:]} == {"remove"}
    return [one["path"] for one in patch[1:]]


def test_a_sidecar_a_volume_and_annotations_go() -> None:
    paths = [
        f"{TEMPLATE}/containers/1",
        f"{TEMPLATE}/volumes/1",
        "/metadata/annotations/note",
        "/spec/template/metadata/annotations/note",
    ]
    assert sorted(removed(*paths)) == sorted(paths)


def test_later_entries_of_a_list_go_first() -> None:
    env = f"{TEMPLATE}/containers/0/env"
    assert removed(f"{env}/0", f"{env}/2", f"{TEMPLATE}/containers/1", f"{TEMPLATE}/containers/2") == [
        f"{TEMPLATE}/containers/2",
        f"{TEMPLATE}/containers/1",
        f"{env}/2",
        f"{env}/0",
    ]


def test_what_is_below_another_goes_with_it() -> None:
    assert removed(f"{TEMPLATE}/containers/0/env/1", f"{TEMPLATE}/containers/0/env") == [f"{TEMPLATE}/containers/0/env"]


def test_names_with_slashes_and_tildes_stay_one_step() -> None:
    key = "/metadata/annotations/example.com~1a~0b"
    assert removed(key) == [key]


@pytest.mark.parametrize(
    "pointer",
    [
        "/metadata/annotations/gone",
        f"{TEMPLATE}/containers/3",
        f"{TEMPLATE}/containers/-",
        f"{TEMPLATE}/containers/x",
        f"{TEMPLATE}/containers/0/image/0",
        "/metadata/annotations/note/deeper",
        "/nowhere",
    ],
)
def test_what_is_not_there_needs_no_patch(pointer: str) -> None:
    assert removed(pointer) == []


@pytest.mark.parametrize(
    "pointer", ["", "/", "/spec", "/metadata", "/metadata/uid", "/metadata/labels", "/metadata/annotations", "spec"]
)
def test_nothing_else_of_the_object_may_go(pointer: str) -> None:
    assert removed(pointer) == []


def test_another_object_or_another_generation_is_left_alone() -> None:
    assert restoring_patch(deployment(), workload_target("/metadata/labels/app", uid="other")) == (
        "it was made anew since it was looked at"
    )
    assert restoring_patch(deployment(), workload_target("/metadata/labels/app", generation=2)) == (
        "it was changed since it was looked at"
    )


def pointers(value: Any, path: str = "") -> list[str]:
    """All pointers into a document."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    below = [(f"{path}/{str(key).replace('~', '~0').replace('/', '~1')}", part) for key, part in pairs]
    return [pointer for name, part in below for pointer in (name, *pointers(part, name))]


def applied(document: Any, patch: list[dict[str, Any]]) -> Any:
    """As RFC 6902 says, for `remove` and `replace`."""
    for step in patch:
        *way, last = [word.replace("~1", "/").replace("~0", "~") for word in step["path"].split("/")[1:]]
        place = document
        for word in way:
            place = place[int(word)] if isinstance(place, list) else place[word]
        key: Any = int(last) if isinstance(place, list) else last
        if step["op"] == "remove":
            del place[key]
        else:
            place[key] = step["value"]
    return document


def leaves(value: Any) -> list[Any]:
    below = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    return [value] if below is None else [leaf for part in below for leaf in leaves(part)]


def at(document: Any, pointer: str) -> Any:
    for word in pointer.split("/")[1:]:
        name = word.replace("~1", "/").replace("~0", "~")
        document = document[int(name)] if isinstance(document, list) else document[name]
    return document


@given(st.lists(st.sampled_from(pointers(deployment())), max_size=8))
def test_exactly_what_is_named_goes(excess: list[str]) -> None:
    """Whatever is named in whatever order: the leaves that are left are those that no pointer names."""
    whole = deployment()
    allowed = ("/spec/", "/metadata/annotations/", "/metadata/labels/")
    names = [pointer for pointer in pointers(whole) if not isinstance(at(whole, pointer), (dict, list))]
    meant = [one for one in excess if one.startswith(allowed)]
    kept = [name for name in names if not any(name == top or name.startswith(f"{top}/") for top in meant)]
    patch = restoring_patch(whole, workload_target(*excess))
    assert isinstance(patch, list)
    assert bool(patch) == bool(meant)
    assert sorted(map(str, leaves(applied(deployment(), patch)))) == sorted(str(at(whole, one)) for one in kept)
