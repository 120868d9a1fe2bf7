"""The client of the API server on connections that end before anything was said."""

import gc
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.adapters.client import api_client, call

ATTEMPTS = 20
RESET_AT_ONCE = struct.pack("ii", 1, 0)


@pytest.fixture
def resetting_server() -> Iterator[str]:
    """Address of a server that resets every connection before the handshake, as one that is being ended does."""
    listener = socket.create_server(("127.0.0.1", 0))

    def reset() -> None:
        while True:
            try:
                accepted, _ = listener.accept()
            except OSError:
                return
            accepted.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_AT_ONCE)
            accepted.close()

    thread = threading.Thread(target=reset)
    thread.start()
    yield f"https://127.0.0.1:{listener.getsockname()[1]}"
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()
    thread.join(10)
    assert not thread.is_alive()


def test_a_server_that_resets_the_connection_before_the_handshake_is_away(
    resetting_server: str, tmp_path: Path
) -> None:
    kubeconfig = tmp_path / "kubeconfig"
    document = {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [{"name": "c", "cluster": {"server": resetting_server, "insecure-skip-tls-verify": True}}],
        "users": [{"name": "u", "user": {"token": "t"}}],
        "contexts": [{"name": "x", "context": {"cluster": "c", "user": "u"}}],
        "current-context": "x",
    }
    kubeconfig.write_text(yaml.safe_dump(document))
    client = api_client(str(kubeconfig))
    for _ in range(ATTEMPTS):
        with pytest.raises(UnavailableError, match="GET /api"):
            call(client, "GET", "/api")
    gc.collect()  # the sockets that Python's ssl has not closed: nothing of ours, so no warning of ours
