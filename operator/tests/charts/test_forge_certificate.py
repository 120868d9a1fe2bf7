"""The forge as the chart starts it with `forge.tls`, a real Gitea: Git, charts and webhooks by TLS, who is refused and
in what words, and that a renewed certificate is shown, and another authority believed, without a lost request."""

from __future__ import annotations

import json
import secrets
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters import certificate_authorities
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.foundation.forge.adapters.git import GitClone
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import PackedChart, pack_chart
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap
from tests.stages.forge.encrypted_forge import PLATFORM, EncryptedForge
from tests.stages.forge.installation import ACCOUNTS, WEBHOOK_SECRET, Installation, forge_setup
from tests.stages.handshakes import certified
from tests.stages.waiting import WAIT_SECONDS_MAX, until

pytestmark = pytest.mark.toolchain

EMBEDDED = (PLATFORM / "values-embedded.yaml", Path(__file__).parent / "profiles" / "embedded.yaml")
RENEWALS, ASKING = 2, 3
DEPLOYMENT = "robotkube/deployment"


@dataclass
class Stage:
    """The forge with everything on it, and who hears its webhooks."""

    forge: EncryptedForge
    installation: Installation
    heard: list[WebhookDelivery]

    def account(self, name: str = "gate") -> tuple[str, str]:
        return name, self.installation.passwords[name]

    def clone(self, folder: Path, url: str = "") -> GitClone:
        return GitClone(url or self.forge.url, DEPLOYMENT, *self.account(), folder)


def hearing(folder: Path, authority: Pair, heard: list[WebhookDelivery]) -> WebServer:
    """A process that the forge calls by HTTPS, with a certificate of this authority."""
    certificate = certified(folder, authority, "localhost")
    server = WebServer("127.0.0.1", 0, list, str, WEBHOOK_SECRET.encode(), heard.append, certificate=certificate)
    server.start()
    return server


@pytest.fixture(scope="module")
def stage(helm: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    forge = EncryptedForge(
        tmp_path_factory.mktemp("forge") / "pod",
        helm.template(PLATFORM, *EMBEDDED),
    )
    heard: list[WebhookDelivery] = []
    server = hearing(tmp_path_factory.mktemp("gate"), forge.authority, heard)
    with pytest.MonkeyPatch.context() as patching:
        patching.setattr(certificate_authorities, "_trusted", {})
        try:
            forge.start()
            certificate_authorities.trust(forge.folder / "ca.crt")
            administration = GiteaAdministration(forge.url, *forge.administrator())
            passwords = {name: secrets.token_hex(12) for name in ACCOUNTS}
            port = server.ports["port"]
            setup = forge_setup(passwords, f"https://localhost:{port}/webhook")
            Bootstrap(60, time.monotonic, time.sleep).forge(setup, administration)
            administration.disconnect()
            made = Installation(forge.url, passwords, port, tmp_path_factory.mktemp("clones"), setup)
            yield Stage(forge, made, heard)
            made.disconnect()
        finally:
            forge.stop()
            server.stop()


def chart() -> PackedChart:
    metadata = {"apiVersion": "v2", "name": "app", "version": "0.1.0"}
    return pack_chart("app", metadata, {"Chart.yaml": json.dumps(metadata).encode()})


def complaint(attempt: Callable[[], object]) -> str:
    """What somebody says who cannot connect."""
    with pytest.raises(UnavailableError) as error:
        attempt()
    return str(error.value)


def merge(stage: Stage, gate: GitClone, release: str) -> None:
    """Have a release proposed and merged."""
    manager = stage.installation.clone("manager")
    tip = gate.fetch()
    commit = manager.commit({f"releases/{release}": "b\n"}, release, [manager.tip()])
    number = stage.installation.propose(manager, commit, release)  # by AGit: its hooks ask the forge
    assert gate.proposal(number).id == commit
    assert gate.push_main(commit)
    assert gate.fetch() == commit != tip


def test_git_by_tls_with_the_hooks_and_webhooks_behind_it(stage: Stage, tmp_path: Path) -> None:
    merge(stage, stage.clone(tmp_path / "gate"), "one")
    until(lambda: any(one.event == "push" for one in stage.heard), "the webhook")


def test_a_webhook_is_not_sent_to_whom_another_authority_signed_for(stage: Stage, tmp_path: Path) -> None:
    heard: list[WebhookDelivery] = []
    server = hearing(tmp_path, new_authority("another", time.time()), heard)
    url = f"https://localhost:{server.port}/webhook"
    administration = GiteaAdministration(stage.forge.url, *stage.forge.administrator())
    try:
        administration.make_webhook(DEPLOYMENT, url, ["push"], WEBHOOK_SECRET)
        known = len(stage.heard)
        merge(stage, stage.clone(tmp_path / "gate"), "two")
        until(lambda: len(stage.heard) > known, "the webhook to whom the forge believes")
        refused = "x509: certificate signed by unknown authority"
        until(lambda: refused in (stage.forge.folder / "log").read_text(), "the refusal in the forge's log")
        assert heard == []
    finally:
        administration.remove_webhook(DEPLOYMENT, url)
        administration.disconnect()
        server.stop()


def test_another_authority_is_believed_when_the_kubelet_has_brought_it(stage: Stage, tmp_path: Path) -> None:
    """Not when the forge starts the next time: whom it calls has the other certificate by then."""
    heard: list[WebhookDelivery] = []
    other = new_authority("another", time.time())
    folder = stage.forge.folder
    server = hearing(tmp_path, other, heard)
    url = f"https://localhost:{server.port}/webhook"
    administration = GiteaAdministration(stage.forge.url, *stage.forge.administrator())
    former = (folder / "run" / "pid").read_text()
    try:
        administration.make_webhook(DEPLOYMENT, url, ["push"], WEBHOOK_SECRET)
        (tmp_path / "ca.crt").write_text(stage.forge.authority.certificate + other.certificate)
        (tmp_path / "ca.crt").replace(folder / "ca.crt")
        until(lambda: (folder / "run" / "pid").read_text() != former, "another process of the forge")
        merge(stage, stage.clone(tmp_path / "gate"), "three")
        until(lambda: bool(heard), "the webhook to whom it believes now")
    finally:
        administration.remove_webhook(DEPLOYMENT, url)
        administration.disconnect()
        server.stop()


def test_charts_are_pushed_and_pulled_by_tls(stage: Stage) -> None:
    packed = chart()
    with OciRegistry(stage.forge.url, *stage.account()) as registry:
        assert registry.push_chart("verified", packed) == packed.digest
    with OciRegistry(stage.forge.url, *stage.account("argocd")) as registry:
        assert registry.pull_chart("verified/app", packed.digest).digest == packed.digest


def attempts(stage: Stage, url: str, folder: Path) -> Iterator[Callable[[], object]]:
    """A look at the forge by each kind of client."""
    yield stage.clone(folder, url).fetch
    yield lambda: OciRegistry(url, *stage.account()).list("verified/app")
    yield lambda: GiteaForge(url, DEPLOYMENT, *stage.account()).pull_requests()
    yield lambda: GiteaAdministration(url, *stage.forge.administrator()).answers()


def test_another_name_and_another_authority_are_refused_in_words(stage: Stage, tmp_path: Path) -> None:
    address, *others = attempts(stage, f"https://127.0.0.2:{stage.forge.port}", tmp_path / "address")
    with pytest.raises(InputError, match=r"the forge at 127\.0\.0\.2: Git does not compare addresses .* forge\.names"):
        address()
    for number, attempt in enumerate(others):
        words = complaint(attempt)
        assert "its certificate is not for the name 127.0.0.2; connect by one that it has, or add" in words, number
    other = f"https://{socket.gethostname()}:{stage.forge.port}"
    assert f"its certificate is not for the name {socket.gethostname()}" in complaint(
        stage.clone(tmp_path / "name", other).fetch
    )
    before = stage.forge.shown()
    stage.forge.show(3600, authority=new_authority("another", time.time()))
    until(lambda: stage.forge.shows_another_than(before), "the certificate of another authority")
    unknown = f"its certificate is of an authority that {stage.forge.folder / 'ca.crt'} does not have; compare"
    for number, attempt in enumerate(attempts(stage, stage.forge.url, tmp_path / "authority")):
        assert unknown in complaint(attempt), number
    until(stage.forge.renewed(), "the renewed certificate")


def fresh(stage: Stage) -> None:
    """A call of the forge's API on a new connection."""
    forge = GiteaForge(stage.forge.url, DEPLOYMENT, *stage.account())
    try:
        forge.pull_requests()
    finally:
        forge.disconnect()


def test_a_renewal_loses_no_request(stage: Stage, tmp_path: Path) -> None:
    """Requests of our clients on connections that are kept and on new ones, by Git, to the registry and to the forge's
    API, while it starts anew. It ends connections meanwhile: those that it accepted as its last."""
    ended = threading.Event()
    lost = []
    asked = [0] * ASKING

    def ask(number: int, attempt: Callable[[], object]) -> None:
        while not ended.is_set():
            try:
                attempt()
                asked[number] += 1
            except Exception as error:
                lost.append(repr(error))

    clone = stage.clone(tmp_path / "clone")
    registry = OciRegistry(stage.forge.url, *stage.account())
    asking = [clone.fetch, lambda: registry.list("verified/app"), lambda: fresh(stage)]
    threads = [threading.Thread(target=ask, args=one) for one in enumerate(asking)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(RENEWALS):
            until(stage.forge.renewed(), "the renewed certificate")
            before = list(asked)
            until(lambda before=before: all(a > b for a, b in zip(asked, before, strict=True)), "further answers")
    finally:
        ended.set()
        for thread in threads:
            thread.join()
    registry.disconnect()
    assert lost == []
    assert stage.forge.process.poll() is None


def test_it_ends_when_the_kubelet_says_so(stage: Stage) -> None:
    stage.forge.process.send_signal(signal.SIGTERM)
    stage.forge.process.wait(WAIT_SECONDS_MAX)
    assert not stage.forge.answers()
