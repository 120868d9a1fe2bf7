"""Every view and state of the console's page in a browser, before a synthetic fleet: on a desk and on a telephone,
light and dark, by keyboard."""

from __future__ import annotations

import shutil
import threading
from http.server import ThreadingHTTPServer

import pytest

from ci import console
from ci.folders import PROJECT
from tests.stages.console.__main__ import MODES, Handler
from tests.stages.console.synthetic import Fleet

pytestmark = [
    pytest.mark.toolchain,
    pytest.mark.thorough,
    pytest.mark.skipif(shutil.which("chromium") is None, reason="needs Debian's chromium: apt-get install chromium"),
]
PICTURES = PROJECT / "build" / "console" / "views"


@pytest.mark.parametrize("mode", MODES)
def test_views(mode: str) -> None:
    class Synthetic(Handler):
        page, fleet = console.build(), Fleet(15, away=frozenset(["broker"]))

    Synthetic.mode = mode
    server = ThreadingHTTPServer(("127.0.0.1", 0), Synthetic)
    server.daemon_threads = True
    serving = threading.Thread(target=server.serve_forever, daemon=True)
    serving.start()
    try:
        said = console.browse("views", mode, f"http://127.0.0.1:{server.server_port}/", str(PICTURES))
    finally:
        server.shutdown()
        server.server_close()
        serving.join(5)
    assert said == f"{mode}: as it should be\n"
