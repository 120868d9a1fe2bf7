"""Pages of other processes: one that sends without end, or a little at a time, keeps the console from none of the
others."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from robotkube.errors import UnavailableError
from robotkube.foundation.pages.adapters.http_pages import PAGE_SECONDS_MAX, HttpPages


class Endless(BaseHTTPRequestHandler):
    """A page that never ends."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        try:
            while True:
                self.wfile.write(b" " * 1000)
        except OSError:
            pass

    def log_message(self, *arguments: object) -> None:
        """Nothing."""


@pytest.fixture
def url() -> Iterator[str]:
    server = HTTPServer(("127.0.0.1", 0), Endless)
    running = threading.Thread(target=server.serve_forever, args=(0.01,))
    running.start()
    yield f"http://127.0.0.1:{server.server_port}/events"
    server.shutdown()
    running.join()
    server.server_close()


def test_a_page_without_end_is_given_up_for_its_size(url: str) -> None:
    pages = HttpPages(50_000)
    with pytest.raises(UnavailableError, match="more than 50000 bytes"):
        pages.get(url)
    pages.close()


def test_a_page_without_end_is_given_up_for_its_time(url: str) -> None:
    clock = itertools.count(0.0, PAGE_SECONDS_MAX / 3)
    pages = HttpPages(1 << 40, lambda: next(clock))
    with pytest.raises(UnavailableError, match="no end within 6 s"):
        pages.get(url)
    pages.close()
