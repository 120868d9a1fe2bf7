"""`ci/python -m tests.stages.console PAGE [--agents N] [--as MODE]`: the page PAGE before a synthetic fleet, for
pictures and measurements. Modes: live; reader (who may not write); buffered (the stream says nothing, and the snapshot
comes after the session); away (only the page is there); signed-out; forbidden; empty (a platform without agents).
"""

from __future__ import annotations

import argparse
import gzip
import json
import mimetypes
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from tests.stages.console.documents import explanation
from tests.stages.console.synthetic import STEP_MS, Fleet

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
SESSION = {"user": "operator-team", "groups": ["robotkube"], "may_read": True, "csrf": "paper"}
WRITER = {"may_write": True, "namespaces": ["cloud-0"], "why_not": ""}
READER = {
    "may_write": False,
    "namespaces": [],
    "why_not": "None of your groups may ask for tasks here (console.signIn.writers). Ask for them by "
    "`robotkube task submit`.",
}
REFUSALS = {
    "signed-out": (401, "Not signed in", "Sign in with your account of the provider.", {"sign_in": "/auth/login"}),
    "forbidden": (403, "Not of a group that reads", "Reading needs membership of the group robotkube.", {}),
    "away": (503, "Not ready", "The console has not read the platform yet.", {"retry_after_seconds": 2}),
}


MODES = ("live", "reader", "buffered", "empty", *REFUSALS)
LATE_SECONDS = 0.5


def version() -> int:
    return int(time.time() * 1000) // STEP_MS


class Handler(BaseHTTPRequestHandler):
    """Answers for one browser. `page`, `fleet` and `mode` are the server's."""

    protocol_version = "HTTP/1.1"
    page: Path
    fleet: Fleet
    mode: str

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        words = [unquote(word) for word in parts.path.strip("/").split("/")]
        if words[0] != "api":
            self.file(parts.path)
        elif words[1] == "session":
            rights = READER if self.mode == "reader" else WRITER
            self.document(200, SESSION | rights | {"sign_in": "/auth/login"})
        elif self.mode in REFUSALS:
            status, title, detail, more = REFUSALS[self.mode]
            self.document(status, {"status": status, "title": title, "detail": detail} | more)
        elif words[1] == "snapshot":
            time.sleep(LATE_SECONDS if self.mode == "buffered" else 0)
            self.document(200, self.snapshot())
        elif words[1] == "changes":
            self.document(200, self.fleet.change(self.after(parts.query), version()))
        elif words[1] == "events":
            self.stream(self.after(parts.query))
        else:
            self.chain(words[2], "/".join(words[3:]))

    def do_POST(self) -> None:
        question = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        if self.path == "/api/explain":
            self.document(200, explanation(question))
        elif self.headers["X-CSRF-Token"] == SESSION["csrf"]:
            self.document(201, {"task": next(iter(self.fleet.tasks(version() * STEP_MS)))})

    def do_DELETE(self) -> None:
        self.answer(204, "application/json", None)

    def snapshot(self) -> dict[str, Any]:
        snapshot = self.fleet.snapshot(version())
        return snapshot | {"items": {}} if self.mode == "empty" else snapshot

    def chain(self, kind: str, identity: str) -> None:
        chain = self.fleet.chain(kind, identity, version() * STEP_MS)
        unknown = {"status": 404, "title": "Not known", "detail": f"Nothing is known of {kind} {identity} (any more)."}
        self.document(*((200, chain) if chain else (404, unknown)))

    @staticmethod
    def after(query: str) -> int:
        return int(parse_qs(query)["after"][0].partition(".")[2])

    def stream(self, after: int) -> None:
        self.answer(200, "text/event-stream", None)
        self.close_connection = True
        self.wfile.write(b":" + b" " * 2048 + b"\n\n")
        while True:
            now = version()
            if self.mode in ("live", "reader") and now > after:
                change = self.fleet.change(after, now)
                self.wfile.write(f"id: {change['id']}\nevent: change\ndata: {json.dumps(change)}\n\n".encode())
                after = now
            elif self.mode == "empty" and now % 20 == 0:
                beat = {"version": after, "time_ms": now * STEP_MS}
                self.wfile.write(f"event: heartbeat\ndata: {json.dumps(beat)}\n\n".encode())
            self.wfile.flush()
            time.sleep(STEP_MS / 1000)

    def file(self, path: str) -> None:
        file = self.page / (path.strip("/") or "index.html")
        if not file.is_file() or not file.resolve().is_relative_to(self.page.resolve()):
            self.document(404, {})
            return
        kind = "text/javascript" if file.suffix == ".js" else mimetypes.guess_type(file.name)[0] or "text/plain"
        self.answer(200, kind, file.read_bytes())

    def document(self, status: int, document: Any) -> None:
        self.answer(status, "application/json", json.dumps(document).encode())

    def answer(self, status: int, kind: str, body: bytes | None) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Security-Policy", POLICY)
        if body is not None:
            body = gzip.compress(body, 6)
            self.send_header("Content-Encoding", "gzip")
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if body is not None:
            self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Says nothing: what is asked for is seen in the browser."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="tests.stages.console", description=__doc__)
    parser.add_argument("page", type=Path, help="folder of the built page: ci/python -m ci.console prints it")
    parser.add_argument("--agents", type=int, default=15)
    parser.add_argument("--releases", type=int, default=60)
    parser.add_argument("--port", type=int, default=8099)
    parser.add_argument("--as", dest="mode", default="live", choices=MODES)
    parser.add_argument("--without", action="append", default=[], help="a source that is away")
    given = parser.parse_args()
    Handler.page, Handler.mode = given.page, given.mode
    Handler.fleet = Fleet(given.agents, given.releases, frozenset(given.without))
    print(f"http://127.0.0.1:{given.port}/", flush=True)
    ThreadingHTTPServer(("127.0.0.1", given.port), Handler).serve_forever()


if __name__ == "__main__":
    main()
