"""A browser (Debian's Chromium without a window) that tests look through: pages opened, read and photographed over the
DevTools protocol."""

from __future__ import annotations

import base64
import json
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import websocket

from ci import packages

START_SECONDS_MAX = 60.0
ANSWER_SECONDS_MAX = 60.0
PAUSE_SECONDS = 0.05
WIDTH, HEIGHT = 1280, 1000
ARGUMENTS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--no-proxy-server"),
    *("--remote-debugging-port=0", f"--window-size={WIDTH},{HEIGHT}", "about:blank"),
)


class BrowserError(AssertionError):
    """The browser did not start, or a page did not do what was asked in time."""


@dataclass
class Page:
    """One page. `failures` are scripts that failed, and files of the page that could not be had."""

    connection: websocket.WebSocket
    failures: list[str] = field(default_factory=list)
    _last: int = 0
    _loaded: bool = False

    def listen(self) -> None:
        """Have the browser say what happens on the page."""
        for domain in ("Page", "Runtime", "Network"):
            self._call(f"{domain}.enable")

    def open(self, url: str) -> None:
        """Go to an address and wait until it has loaded."""
        self._leave(lambda: self._call("Page.navigate", url=url))

    def submit(self, form: str, values: Mapping[str, str]) -> None:
        """Fill in the form that a selector names, send it, and wait until the next page has loaded."""
        element = f"document.querySelector({json.dumps(form)})"
        for name, value in values.items():
            self.evaluate(f"{element}.elements[{json.dumps(name)}].value = {json.dumps(value)}")
        self._leave(lambda: self.evaluate(f"{element}.requestSubmit()"))

    def evaluate(self, script: str) -> Any:
        """The value of an expression on the page."""
        answer = self._call("Runtime.evaluate", expression=script, returnByValue=True)
        if "exceptionDetails" in answer:
            raise BrowserError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    @property
    def text(self) -> str:
        """What is to be read on it."""
        return str(self.evaluate("document.body.innerText"))

    def photograph(self, path: Path) -> None:
        """Write a picture of the whole page."""
        picture = self._call("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(picture["data"]))

    def _leave(self, act: Callable[[], object]) -> None:
        self._loaded = False
        act()
        end = time.monotonic() + ANSWER_SECONDS_MAX
        while not self._loaded:
            if time.monotonic() > end:
                raise BrowserError("the page did not load in time")
            self._receive()

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._last += 1
        self.connection.send(json.dumps({"id": self._last, "method": method, "params": parameters}))
        while True:
            said = self._receive()
            if said.get("id") == self._last:
                if "error" in said:
                    raise BrowserError(f"{method}: {said['error']}")
                return dict(said["result"])

    def _receive(self) -> dict[str, Any]:
        said: dict[str, Any] = json.loads(self.connection.recv())
        about = said.get("params", {})
        if said.get("method") == "Page.loadEventFired":
            self._loaded = True
        elif said.get("method") == "Runtime.exceptionThrown":
            self.failures.append(str(about["exceptionDetails"]))
        elif said.get("method") == "Network.responseReceived" and about["response"]["status"] >= 400:
            self.failures.append(f"{about['response']['status']} {about['response']['url']}")
        return said


@contextmanager
def browsing(folder: Path) -> Iterator[Page]:
    """A browser that keeps what it writes in `folder`, with one page."""
    packages.ensure("browser")
    process = subprocess.Popen(
        ["chromium", f"--user-data-dir={folder}", *ARGUMENTS], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        address = _page_address(folder, process)
        connection = websocket.create_connection(address, timeout=ANSWER_SECONDS_MAX, suppress_origin=True)
        page = Page(connection)
        page.listen()
        yield page
        connection.close()
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(10)


def _page_address(folder: Path, process: subprocess.Popen[bytes]) -> str:
    """Where the browser's first page is spoken to."""
    written = folder / "DevToolsActivePort"
    end = time.monotonic() + START_SECONDS_MAX
    while time.monotonic() < end:
        if process.poll() is not None:
            raise BrowserError(f"chromium ended with {process.returncode}")
        if written.exists() and (lines := written.read_text().splitlines()):
            listed = httpx.get(f"http://127.0.0.1:{lines[0]}/json/list", trust_env=False).json()
            for one in listed:
                if one["type"] == "page":
                    return str(one["webSocketDebuggerUrl"])
        time.sleep(PAUSE_SECONDS)
    raise BrowserError(f"chromium showed no page within {START_SECONDS_MAX:.0f} s")
