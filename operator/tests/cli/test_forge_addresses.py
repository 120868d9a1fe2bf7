"""Where the command line reaches the forge: the platform's own at its Service, one of others where the manager's
settings say."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.cli.platform import Platform
from robotkube.errors import InputError

PATH = "/api/v1/namespaces/"
SERVICES = {"robotkube/services/forge": "10.96.0.7", "managed/services/git": "10.96.0.8"}
ACCOUNT = {"username": "publisher", "password": "secret"}


class Known(Platform):
    """A platform with the settings of a manager, or without the right to read them."""

    def __init__(self, url: str | None) -> None:
        self._namespace, self._manager = "robotkube", "manager"
        self._url = url

    def _read(
        self, method: str, path: str, query: Sequence[tuple[str, str]] = (), body: Any = None
    ) -> Mapping[str, Any]:
        asked = path.removeprefix(PATH)
        if asked == "robotkube/configmaps/manager":
            if self._url is None:
                raise InputError("403 Forbidden")
            return {"data": {"config.yaml": f"forge: {{url: '{self._url}'}}\n"}}
        if asked == "robotkube/secrets/forge-account-publisher":
            return {"data": {key: base64.b64encode(value.encode()).decode() for key, value in ACCOUNT.items()}}
        return {"spec": {"clusterIP": SERVICES[asked], "ports": [{"name": "http", "port": 3000}]}}


@pytest.mark.parametrize(
    ("url", "reached"),
    [
        ("http://forge.robotkube.svc.cluster.local:3000", "http://10.96.0.7:3000"),
        (None, "http://10.96.0.7:3000"),
        ("http://git.managed.svc.cluster.local", "http://10.96.0.8:80"),
        ("https://git.example.com", "https://git.example.com"),
    ],
)
def test_the_forge_is_reached_where_it_is(url: str | None, reached: str) -> None:
    assert Known(url).forge_url() == reached
    assert Known(url).forge_account("publisher") == (reached, "publisher", "secret")


def test_a_service_that_is_not_there_is_named() -> None:
    with pytest.raises(InputError, match=r"^no Service away in namespace managed$"):
        Known("http://away.managed.svc").forge_url()
