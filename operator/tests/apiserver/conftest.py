"""One API server per session with the definitions of tasks and (in short) of Argo CD Applications."""

import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from api_calls import Api, prepare
from api_server import ApiServerProcess

from robotkube.adapters.kubernetes_api import api_client


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.filterwarnings("ignore::urllib3.exceptions.InsecureRequestWarning"))


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiServerProcess]:
    process = ApiServerProcess(tmp_path_factory.mktemp("api"))
    try:
        process.start()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            prepare(Api(api_client(str(process.kubeconfig))))
        yield process
    finally:
        process.stop()


@pytest.fixture
def api(server: ApiServerProcess) -> Iterator[Api]:
    found = Api(api_client(str(server.kubeconfig)))
    yield found
    found.client.rest_client.pool_manager.clear()
