"""Objects of a kind are read page after page, and no more pages than a bound."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotkube.cli.platform import PAGE_OBJECTS, PAGES_MAX, Platform
from robotkube.errors import InputError
from tests.stages.kubernetes.served_objects import serving

PODS = "/api/v1/pods"
LAST = PAGES_MAX - 1


class Pages:
    """An API server that has the pages 0 to `last` of one object each, without end when `last` is None."""

    def __init__(self) -> None:
        self.last: int | None = 0
        self.asked: list[tuple[str, str]] = []

    def answer(self, path: str, query: dict[str, list[str]]) -> dict[str, object] | None:
        """The page that is asked for; None when there is no such kind."""
        token = query.get("continue", [""])[0]
        self.asked.append((query["limit"][0], token))
        page = int(token or 0)
        more = str(page + 1) if page != self.last else ""
        return {"items": [{"page": page}], "metadata": {"continue": more}} if path == PODS else None


@pytest.fixture
def pages() -> Pages:
    return Pages()


@pytest.fixture
def platform(pages: Pages, tmp_path: Path) -> Iterator[Platform]:
    """The command line's access to it."""
    names = {"context": None, "platform_namespace": "robotkube", "argocd_namespace": "argocd", "manager": "manager"}
    with serving(pages.answer, tmp_path) as kubeconfig:
        yield Platform(argparse.Namespace(kubeconfig=str(kubeconfig), **names))


def test_the_last_page_that_is_allowed_is_read(pages: Pages, platform: Platform) -> None:
    pages.last = LAST
    assert [item["page"] for item in platform.everything(PODS)] == list(range(PAGES_MAX))
    assert pages.asked == [(str(PAGE_OBJECTS), str(page or "")) for page in range(PAGES_MAX)]


def test_a_list_without_end_is_given_up(pages: Pages, platform: Platform) -> None:
    pages.last = None
    with pytest.raises(InputError, match=f"the cluster has more than {PAGES_MAX * PAGE_OBJECTS} {PODS}; remove old"):
        list(platform.everything(PODS))
    assert len(pages.asked) == PAGES_MAX


def test_a_kind_that_the_cluster_does_not_know_is_named(platform: Platform) -> None:
    with pytest.raises(InputError, match="the cluster has no /apis/none; is the platform installed"):
        list(platform.everything("/apis/none"))
