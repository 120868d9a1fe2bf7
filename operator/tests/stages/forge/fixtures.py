"""One real forge per test session, bootstrapped as an installation does it; a gate per test."""

import secrets
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robotkube.foundation.kubernetes.adapters.client import api_client
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap
from tests.stages.delivery.manager.manager_process import AGENTS
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import (
    ACCOUNTS,
    ApplicationSetController,
    Installation,
    RunningGate,
    forge_setup,
    start_gate,
)
from tests.stages.kubernetes.api_calls import Api, prepare
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.programs import free_port
from tests.stages.waiting import until


@pytest.fixture(scope="session")
def forge_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ForgeProcess]:
    process = ForgeProcess(tmp_path_factory.mktemp("forge"))
    process.start()
    yield process
    process.remove()


@pytest.fixture(scope="session")
def administration(forge_process: ForgeProcess) -> Iterator[GiteaAdministration]:
    made = GiteaAdministration(forge_process.url, forge_process.administrator, forge_process.administrator_password)
    yield made
    made.disconnect()


@pytest.fixture(scope="session")
def shared_installation(
    forge_process: ForgeProcess, administration: GiteaAdministration, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Installation]:
    passwords = {name: secrets.token_hex(12) for name in ACCOUNTS}
    port = free_port()
    setup = forge_setup(passwords, f"http://127.0.0.1:{port}/webhook")
    Bootstrap(30, time.monotonic, time.sleep).forge(setup, administration)
    made = Installation(forge_process.url, passwords, port, tmp_path_factory.mktemp("clones"), setup)
    yield made
    made.disconnect()


@pytest.fixture(scope="module")
def installation(shared_installation: Installation) -> Iterator[Installation]:
    """The forge that all modules share. What one leaves open, the gates of the next would judge and count."""
    yield shared_installation
    shared_installation.close_pull_requests()


@pytest.fixture(scope="module")
def own_installation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installation]:
    """A forge of the module's own, with an installation: for tests after which main is not what others expect."""
    process = ForgeProcess(tmp_path_factory.mktemp("own-forge"))
    with installed(process, tmp_path_factory.mktemp("own-clones")) as installation:
        yield installation


@contextmanager
def installed(process: ForgeProcess, folder: Path) -> Iterator[Installation]:
    """An installation on a forge that is started for it and gone afterwards; clones stand in `folder`."""
    process.start()
    made = GiteaAdministration(process.url, process.administrator, process.administrator_password)
    passwords = {name: secrets.token_hex(12) for name in ACCOUNTS}
    port = free_port()
    setup = forge_setup(passwords, f"http://127.0.0.1:{port}/webhook")
    Bootstrap(30, time.monotonic, time.sleep).forge(setup, made)
    made.disconnect()
    installation = Installation(process.url, passwords, port, folder, setup)
    yield installation
    installation.disconnect()
    process.remove()


@pytest.fixture(scope="session")
def manager_api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """An API server with the definitions of tasks and Argo CD's Applications, and the nodes of the agents."""
    process = ApiServerProcess(tmp_path_factory.mktemp("api"))
    try:
        process.start()
        connected = Api(api_client(str(process.kubeconfig)), process.kubeconfig)
        prepare(connected)
        for name, role in AGENTS:
            connected.node(name, role)
        yield connected
        connected.client.rest_client.pool_manager.clear()
    finally:
        process.stop()


@pytest.fixture
def controller() -> Iterator[ApplicationSetController]:
    controller = ApplicationSetController()
    yield controller
    controller.stop()


@pytest.fixture
def gate(installation: Installation, controller: ApplicationSetController, tmp_path: Path) -> Iterator[RunningGate]:
    running = start_gate(installation, controller.url, tmp_path)
    until(lambda: not running.gate.reasons_not_ready(), "gate ready")
    yield running
    running.stop()
