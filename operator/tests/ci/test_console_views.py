"""Every view and state of the console's page in a browser, before a synthetic fleet: on a desk and on a telephone,
light and dark, by keyboard."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from http.server import ThreadingHTTPServer

import pytest

from ci import console
from ci.folders import PROJECT
from robotkube.delivery.console.adapters.web.application import Console, ConsoleSurroundings
from robotkube.delivery.console.adapters.web.page_files import read_files
from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.adapters.web.server import AsgiServer
from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.links import BridgeReading, LinkRates
from tests.delivery.console import documents as given
from tests.delivery.console.people import PlatformInMemory
from tests.delivery.console.test_web import filled
from tests.stages.console.__main__ import MODES, Handler
from tests.stages.console.documents import PARAMETERS
from tests.stages.console.synthetic import Fleet

pytestmark = [
    pytest.mark.toolchain,
    pytest.mark.thorough,
]
PICTURES = PROJECT / "build" / "console" / "views"


def test_a_way_through_the_page_of_the_consoles_own_process() -> None:
    """With its headers, its Content-Security-Policy among them, and questions in a browser's own words."""
    model = filled()
    model.now_ms = lambda: time.time_ns() // 1_000_000
    model.put_source("broker", "", "", ())
    reading = BridgeReading(0, {("out", "/list"): {"messages_total": 1.0}})
    model.replace(kinds.LINKS, LinkRates().documents("cloud-0/mqtt-bridge", reading))
    catalogue = {"entries": [{**given.CATALOGUE["entries"][0], "parameters": PARAMETERS}]}
    model.put_catalogue("manager", catalogue)
    around = ConsoleSurroundings(["localhost"], files=read_files(console.build()))
    platform = PlatformInMemory()
    running = Console(model, People(None), platform.asking, around)
    server = AsgiServer(running.app, "127.0.0.1", 0)
    server.start()
    try:
        url = f"http://localhost:{server.port}/"
        said = console.browse("smoke", url, "cloud-0", "recording", "vehicles=vehicle-00", str(PICTURES))
    finally:
        running.streams.stop()
        server.stop()
    assert "as they should be" in said
    assert "encounter-0.layout.json came" in said
    [(_, question)] = platform.questions
    assert question["spec"]["parameters"] == {"vehicles": ["vehicle-00"]}


@contextmanager
def synthetic(mode: str, away: Iterable[str]) -> Iterator[str]:
    """The address of the page before a synthetic fleet of which some sources are away."""

    class Synthetic(Handler):
        page = console.build()
        fleet = Fleet(15, away=frozenset(away))

    Synthetic.mode = mode
    server = ThreadingHTTPServer(("127.0.0.1", 0), Synthetic)
    server.daemon_threads = True
    serving = threading.Thread(target=server.serve_forever, daemon=True)
    serving.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()
        serving.join(5)


@pytest.mark.parametrize("mode", MODES)
def test_views(mode: str) -> None:
    with synthetic(mode, ["broker"]) as url:
        said = console.browse("views", mode, url, str(PICTURES))
    assert said == f"{mode}: as it should be\n"


def test_each_source_that_is_away_is_said_where_what_it_carries_is_shown() -> None:
    views = {
        **{"manager/manager": "plans", "gate": "plans", "forge": "plans", "broker": "agents"},
        **{"api-server-nodes": "agents", "api-server-tasks": "tasks", "argocd-application-controller": "catalogue"},
        **{"detectors": "recordings", "gate-pages": "trust", "certificates": "agents"},
    }
    with synthetic("live", views) as url:
        said = console.browse("sources", url, *(f"{source}={view}" for source, view in views.items()))
    assert said == "each is said\n"
