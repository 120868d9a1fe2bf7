"""The HTTP server of the console: uvicorn on a thread of its own."""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence

import uvicorn
from starlette.types import ASGIApp

from robotkube.delivery.console.adapters.web.connections import WebBounds, bounded_connections

STOP_SECONDS_MAX = 3.0
CONNECTIONS_MAX = 1000
DEFAULT_BOUNDS = WebBounds()


class AsgiServer:
    """Serves `app`; `start()`, then `stop()`. Port 0 is a free one, see `port`. `proxies` are those whose word counts
    for who asks; `bounds` are those of every other client."""

    def __init__(
        self,
        app: ASGIApp,
        address: str,
        port: int,
        proxies: Sequence[str] = (),
        bounds: WebBounds = DEFAULT_BOUNDS,
    ) -> None:
        self._socket = socket.create_server((address, port), backlog=128)
        configuration = uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            server_header=False,
            lifespan="off",
            loop="asyncio",
            http=bounded_connections(bounds, proxies),
            ws="none",
            proxy_headers=bool(proxies),
            forwarded_allow_ips=list(proxies),
            limit_concurrency=CONNECTIONS_MAX,
            timeout_graceful_shutdown=int(STOP_SECONDS_MAX),
        )
        self._server = uvicorn.Server(configuration)
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), name="http", daemon=True)

    @property
    def port(self) -> int:
        """The TCP port it listens on."""
        return int(self._socket.getsockname()[1])

    @property
    def connections(self) -> int:
        """How many connections there are."""
        return len(self._server.server_state.connections)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def stop(self) -> None:
        """End, within STOP_SECONDS_MAX and a moment."""
        self._server.should_exit = True
        self._thread.join(STOP_SECONDS_MAX + 1.0)
        self._socket.close()
