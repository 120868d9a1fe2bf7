"""Objects of a kind are read page after page, and no more pages than a bound."""

from __future__ import annotations

import argparse
import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest

from robotkube.cli.platform import PAGE_OBJECTS, PAGES_MAX, Platform
from robotkube.errors import InputError

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
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler(pages.answer))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    cluster = {"name": "a", "cluster": {"server": f"http://127.0.0.1:{server.server_port}"}}
    context = {"name": "a", "context": {"cluster": "a", "user": "a"}}
    document = {"clusters": [cluster], "contexts": [context], "users": [{"name": "a", "user": {}}]}
    (tmp_path / "kubeconfig").write_text(json.dumps({**document, "current-context": "a"}))
    names = {"context": None, "platform_namespace": "robotkube", "argocd_namespace": "argocd", "manager": "manager"}
    try:
        yield Platform(argparse.Namespace(kubeconfig=str(tmp_path / "kubeconfig"), **names))
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def handler(
    answer: Callable[[str, dict[str, list[str]]], dict[str, object] | None],
) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            where = urlsplit(self.path)
            page = answer(where.path, parse_qs(where.query))
            body = json.dumps(page or {"message": "none"}).encode()
            self.send_response(404 if page is None else 200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *arguments: object) -> None:
            pass

    return Handler


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
