"""API servers of a session: one with the definitions of tasks and (in short) of Argo CD Applications, and one under the
admission policies of the examples."""

from collections.abc import Iterator

import pytest

from robotkube.foundation.kubernetes.adapters.client import api_client
from tests.stages.kubernetes.api_calls import Api, prepare
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.kubernetes.judged_api_server import Api as JudgedApi
from tests.stages.kubernetes.judged_api_server import judged_api_server


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


@pytest.fixture(scope="session")
def under_policies(tmp_path_factory: pytest.TempPathFactory) -> Iterator[JudgedApi]:
    """Under the policies from files. What tests of a file make there goes with them; a namespace stays, since no
    controller empties it."""
    from robotkube.registry.admission.core.policies import for_files
    from tests.stages.registry.admission_examples import ALLOWED, DOMAIN

    with judged_api_server(tmp_path_factory.mktemp("judged"), for_files(DOMAIN, ALLOWED)) as (made, _):
        yield made
