"""The list as a ConfigMap, and the documents that are written beside it."""

from __future__ import annotations

import pytest

from robotkube.errors import InputError
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.list_objects import (
    COMMIT,
    KEYS_CHARACTERS_MAX,
    documents_for_api,
    list_object,
    read_list,
)
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.core.policies import API_POLICIES, LIST, for_api
from tests.stages.registry.admission_examples import CHARTS, digest

DOMAIN = Domain(("vehicle-00",), ("robotkube-suite-0",), CHARTS, platform="robots", argocd="cd")
LISTED = AllowedVersions((f"app@{digest(8)}", f"event-detector@{digest(9)}"), (digest(1), digest(2)), commit="c" * 40)


def test_a_list_is_read_as_it_was_written() -> None:
    document = list_object("robots", LISTED)
    assert (document["metadata"]["name"], document["metadata"]["namespace"]) == (LIST, "robots")
    assert document["metadata"]["annotations"] == {COMMIT: "c" * 40}
    assert read_list(document) == LISTED


@pytest.mark.parametrize(
    "data",
    [
        None,
        {},
        {"image": "", "image.12": "", f"image.{'A' * 64}": "", f"platform.{'a' * 64}": ""},
        {f"chart.{'a' * 63}": "", "chart..": ""},
    ],
)
def test_what_is_no_entry_is_left_out(data: dict[str, str] | None) -> None:
    assert read_list({"metadata": {"name": LIST}, "data": data}) == AllowedVersions()


def test_a_list_that_does_not_fit_is_refused_whole_and_says_what_to_do() -> None:
    images = tuple(digest(number) for number in range(KEYS_CHARACTERS_MAX // 70))
    assert len(images) > 8500
    list_object("robots", AllowedVersions((), images))
    with pytest.raises(
        InputError, match=r"ConfigMap admission-list: 1 charts and 8571 images .* withdraw old versions"
    ):
        list_object("robots", AllowedVersions((f"app@{digest(9)}",), images))


def test_the_list_comes_before_the_policies_that_ask_for_it() -> None:
    documents = documents_for_api(DOMAIN, LISTED)
    assert [documents[0]["kind"], *(item["kind"] for item in documents[1:3])] == [
        "ConfigMap",
        "ValidatingAdmissionPolicy",
        "ValidatingAdmissionPolicyBinding",
    ]
    assert [item["spec"] for item in documents[1:]] == [item["spec"] for item in for_api(DOMAIN)]


def test_the_names_are_those_that_the_account_may_write() -> None:
    assert {item["metadata"]["name"] for item in for_api(DOMAIN)} == set(API_POLICIES)
