"""What is attached is asked of the registry's referrers API before the fallback tag, and not written there when the
registry keeps the list itself."""

from __future__ import annotations

import pytest

from robotkube.errors import InputError
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import pack_chart
from robotkube.registry.charts.core.referrers import ARTEFACTS_MAX, PAGES_MAX, fallback_tag
from tests.stages.registry.asking_registry import PASSWORD, USER, AskingRegistry, running

CHART = pack_chart("app", {"name": "app", "version": "0.1.0"}, {"Chart.yaml": b"name: app\nversion: 0.1.0\n"})
KIND = "application/vnd.in-toto+json"
TAG = fallback_tag(CHART.digest)


def attach(registry: OciRegistry, text: str, repository: str = "robots/app") -> str:
    return registry.attach(repository, CHART.digest, KIND, text.encode(), {"name": text})


@pytest.mark.parametrize("lists", [True, False], ids=["referrers API", "fallback tag"])
def test_both_ways_give_the_same(lists: bool) -> None:
    asking = AskingRegistry(lists=lists)
    with running(asking), OciRegistry(asking.url, USER, PASSWORD) as registry:
        registry.push_chart("robots", CHART)
        digests = {attach(registry, text) for text in ("static", "images")}
        assert {attachment.digest for attachment in registry.attachments("robots/app", CHART.digest)} == digests
        registry.copy_chart("robots/app", "verified/app", CHART.digest, "0.1.0", digests)
        assert {attachment.digest for attachment in registry.attachments("verified/app", CHART.digest)} == digests
        written = len(asking.manifests)
        attach(registry, "static")
        assert len(asking.manifests) == written
    assert (("robots/app", TAG) in asking.manifests) is not lists
    assert (("verified/app", TAG) in asking.manifests) is not lists


def test_the_fallback_is_not_asked_where_the_registry_lists() -> None:
    asking = AskingRegistry(tokens=False)
    with running(asking), OciRegistry(asking.url, "", "") as registry:
        registry.push_chart("robots", CHART)
        attach(registry, "static")
        registry.attachments("robots/app", CHART.digest)
    assert not [path for _, path, _ in asking.seen if TAG in path]


def test_a_registry_without_the_list_is_asked_for_it_once() -> None:
    asking = AskingRegistry(tokens=False, lists=False)
    with running(asking), OciRegistry(asking.url, "", "") as registry:
        registry.push_chart("robots", CHART)
        attach(registry, "static")
        for _ in range(3):
            assert len(registry.attachments("robots/app", CHART.digest)) == 1
    assert len([path for _, path, _ in asking.seen if "/referrers/" in path]) == 1


def test_a_list_in_pages_is_read_to_its_end() -> None:
    asking = AskingRegistry(page=2)
    with running(asking), OciRegistry(asking.url, USER, PASSWORD) as registry:
        registry.push_chart("robots", CHART)
        digests = {attach(registry, str(number)) for number in range(5)}
        assert {attachment.digest for attachment in registry.attachments("robots/app", CHART.digest)} == digests


def test_a_list_without_end_is_cut_off() -> None:
    asking = AskingRegistry(tokens=False, page=0)
    with running(asking), OciRegistry(asking.url, "", "") as registry:
        registry.push_chart("robots", CHART)
        asking.page = 100
        attach(registry, "static")
        asking.page = 0
        with pytest.raises(InputError, match=f"more than {PAGES_MAX} pages; they are not read"):
            registry.attachments("robots/app", CHART.digest)


def test_what_was_attached_before_the_registry_kept_lists_is_pushed_to_it_again() -> None:
    """The same manifest is there but not listed: pushing it is what makes such a registry list it."""
    asking = AskingRegistry(tokens=False)
    with running(asking), OciRegistry(asking.url, "", "") as registry:
        registry.push_chart("robots", CHART)
        digest = attach(registry, "static")
        hidden = asking.referrers
        asking.referrers = lambda name, subject: []  # type: ignore[method-assign]
        before = len([1 for method, path, _ in asking.seen if method == "PUT" and digest in path])

        def put_again(name: str, subject: str) -> list[dict[str, object]]:
            puts = len([1 for method, path, _ in asking.seen if method == "PUT" and digest in path])
            return hidden(name, subject) if puts > before else []

        asking.referrers = put_again  # type: ignore[method-assign,assignment]
        assert attach(registry, "static") == digest
        assert len(registry.attachments("robots/app", CHART.digest)) == 1


def test_a_list_of_too_many_is_refused() -> None:
    asking = AskingRegistry(tokens=False)
    with running(asking), OciRegistry(asking.url, "", "") as registry:
        registry.push_chart("robots", CHART)
        attach(registry, "static")
        [entry] = asking.referrers("robots/app", CHART.digest)
        asking.page = 200
        asking.referrers = lambda name, subject: [entry] * (ARTEFACTS_MAX + 1)  # type: ignore[method-assign]
        with pytest.raises(InputError, match=f"more than {ARTEFACTS_MAX} artefacts are attached"):
            registry.attachments("robots/app", CHART.digest)
