"""From a merge to a right: the process that keeps rights, behind a real forge that the chart's Job has set up, and at a
real broker. Nothing is polled: the forge's webhook is what brings it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.certificates.adapters.shut_accounts import ShutAccountsPage
from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import write_revoked
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.rights import __main__ as process
from robotkube.delivery.rights.loops import main_follower
from robotkube.errors import UnavailableError
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.pages.adapters.http_pages import HttpPages
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.setup import bootstrap
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap
from tests.charts.conftest import PLATFORM
from tests.stages.delivery.rights.main_of_links import POSE_01, bridge, texts
from tests.stages.delivery.rights.rights_broker import RightsBroker, password
from tests.stages.delivery.tasks.mqtt_connection import NOT_AUTHORISED, Connection
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import Clone
from tests.stages.programs import free_port
from tests.stages.settings_mounted import mounted
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
MQTT_01 = f"mqtt{POSE_01}"


@dataclass
class Stage:
    """`gate` pushes main as the gate does, `parts` is the process."""

    broker: RightsBroker
    gate: Clone
    parts: process.RightsProcess
    files: dict[str, str | None]

    def merge(self, *releases: Release) -> None:
        """Main has these releases and no others."""
        files = texts(*releases)
        gone = {path: None for path, text in self.files.items() if text is not None and path not in files}
        commit = self.gate.commit({**gone, **files}, "deploy: links", [self.gate.tip()])
        assert self.gate.push(commit, "refs/heads/main") == ""
        self.files = {**files}

    def until(self, code: int, listener: Connection) -> None:
        """Wait until the broker answers a subscription so."""
        until(lambda: listener.subscribe(MQTT_01) == code, "the right", state=self.parts.keeper.reasons_not_ready)


def prepared_forge(rendered: Any, forge: ForgeProcess, folder: Path, webhook: str) -> str:
    """Accounts, repositories and the process's webhook as the chart's Job makes them; the gate's password."""
    made = read_settings(mounted(rendered, "bootstrap", folder), bootstrap.read_configuration).forge
    assert made is not None
    hooks = tuple(replace(one, url=webhook) for one in made.setup.webhooks if "//rights." in one.url)
    assert [hook.repository for hook in hooks] == ["robotkube/deployment"]
    administration = GiteaAdministration(forge.url, forge.administrator, forge.administrator_password)
    Bootstrap(30, time.monotonic, time.sleep).forge(replace(made.setup, webhooks=hooks), administration)
    administration.disconnect()
    return next(account.password for account in made.setup.accounts if account.name == "gate")


def settings_of(rendered: Any, forge: ForgeProcess, port: int, broker: int, folder: Path) -> Path:
    """The chart's settings, with the places of these tests and the broker's password."""
    path = mounted(rendered, "rights", folder)
    document = yaml.safe_load(path.read_text())
    document["forge"]["url"] = forge.url
    document["listen"] = {"address": "127.0.0.1", "port": port}
    document["broker"] |= {"host": "127.0.0.1", "port": broker}
    for clear_text in ("forge", "broker"):
        del document[clear_text]["authorities"]
    (folder / "secrets" / "broker" / "password").write_text(password("rights"))
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.fixture(scope="module")
def stage(helm: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("rights")
    port = free_port()
    rendered = helm.template(PLATFORM, PROFILE, tls={"accounts": "passwords"})
    broker = RightsBroker(folder / "broker")
    forge = ForgeProcess(folder / "forge")
    stopping = threading.Event()
    broker.start()
    forge.start()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(main_follower, "RESYNC_SECONDS", 3600.0)
        try:
            secret = prepared_forge(rendered, forge, folder / "bootstrap", f"http://127.0.0.1:{port}/webhook")
            path = settings_of(rendered, forge, port, broker.port, folder / "own")
            settings = replace(read_settings(path, process.read_configuration), accounts=broker.accounts)
            clone = settings.forge.clone(settings.forge.deployment, folder / "work")
            parts = process.RightsProcess(settings, clone)
            thread = threading.Thread(target=parts.run, args=(stopping,))
            thread.start()
            until(lambda: parts.keeper.reasons_not_ready() == [], "ready", state=parts.keeper.reasons_not_ready)
            yield Stage(broker, Clone(forge.url, "robotkube/deployment", "gate", secret, folder / "clone"), parts, {})
            stopping.set()
            thread.join(20)
        finally:
            stopping.set()
            forge.remove()
            broker.stop()


def test_a_right_comes_and_goes_with_a_merge_that_the_webhook_tells(stage: Stage) -> None:
    """Main is read again after an hour only; nobody is disconnected."""
    listener = Connection(stage.broker.port, "vehicle-00", password("vehicle-00"))
    assert listener.subscribe(MQTT_01) == NOT_AUTHORISED
    for _ in range(2):
        stage.merge(bridge("vehicle-00", POSE_01))
        stage.until(1, listener)
        stage.merge()
        stage.until(NOT_AUTHORISED, listener)
    assert not listener.lost
    listener.close()


def test_who_asks_is_told_whom_main_shuts_out(stage: Stage) -> None:
    """By the adapter of who revokes certificates."""
    pages = HttpPages()
    page = ShutAccountsPage(pages, f"http://127.0.0.1:{stage.parts.server.ports['port']}/accounts")
    authority = new_authority("ours", time.time()).certificate
    assert page.shut(authority) == frozenset()
    stolen = {REVOKED_PATH: write_revoked({"vehicle-00": "its computer was stolen"})}
    for files, shut in ((stolen, {"vehicle-00"}), (dict.fromkeys(stolen), set())):
        commit = stage.gate.commit(files, "policy(revoked): vehicle-00", [stage.gate.tip()])
        assert stage.gate.push(commit, "refs/heads/main") == ""
        until(lambda s=shut: page.shut(authority) == s, "main's word")
    pages.close()


def test_the_account_at_the_forge_reads_one_repository_and_writes_nothing(stage: Stage, tmp_path: Path) -> None:
    settings = stage.parts._configuration.forge
    with pytest.raises(UnavailableError):
        settings.clone("robotkube/catalogue", tmp_path / "catalogue").fetch()
    own = Clone(settings.address.url, settings.deployment, "rights", settings.account.password, tmp_path / "own")
    commit = own.commit({"README.md": "mine"}, "mine", [own.tip()])
    assert own.push(commit, "refs/heads/main") != ""
    assert own.push(commit, "refs/heads/mine") != ""
