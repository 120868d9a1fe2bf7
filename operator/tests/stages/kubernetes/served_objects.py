"""An API server that has what a test says, in the test's own process: for commands that read and nothing else."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

FORBIDDEN = {"kind": "Status", "message": "forbidden"}  # an answer that refuses
Answer = Callable[[str, dict[str, list[str]]], Mapping[str, Any] | None]


@contextmanager
def serving(answer: Answer, folder: Path) -> Iterator[Path]:
    """A kubeconfig below `folder` of a server that answers a GET by path and query: with a document, with 403 where it
    is FORBIDDEN, with 404 where it is None."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(answer))
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    cluster = {"name": "a", "cluster": {"server": f"http://127.0.0.1:{server.server_port}"}}
    context = {"name": "a", "context": {"cluster": "a", "user": "a"}}
    document = {"clusters": [cluster], "contexts": [context], "users": [{"name": "a", "user": {}}]}
    kubeconfig = folder / "kubeconfig"
    kubeconfig.write_text(json.dumps({**document, "current-context": "a"}))
    try:
        yield kubeconfig
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def _handler(answer: Answer) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            where = urlsplit(self.path)
            document = answer(where.path, parse_qs(where.query))
            body = json.dumps(document or {"message": "none"}).encode()
            self.send_response(404 if document is None else 403 if document is FORBIDDEN else 200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *arguments: object) -> None:
            pass

    return Handler
