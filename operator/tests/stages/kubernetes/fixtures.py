"""One API server per session with the definitions of tasks and (in short) of Argo CD Applications."""

from collections.abc import Iterator

import pytest

from robotkube.foundation.kubernetes.adapters.client import api_client
from tests.stages.kubernetes.api_calls import Api, prepare
from tests.stages.kubernetes.api_server import ApiServerProcess


@pytest.fixture(scope="session")
def api_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiServerProcess]:
    process = ApiServerProcess(tmp_path_factory.mktemp("api"))
    try:
        process.start()
        prepare(Api(api_client(str(process.kubeconfig))))
        yield process
    finally:
        process.stop()


@pytest.fixture
def api(api_server: ApiServerProcess) -> Iterator[Api]:
    """As an administrator. The API server is that of many tests: what a test asked for goes with it."""
    made = Api(api_client(str(api_server.kubeconfig)))
    yield made
    made.withdraw_tasks()
    made.client.rest_client.pool_manager.clear()
