"""The broker's program as the chart renders it, on a real mosquitto: who is refused and in what words, and that a
renewed certificate is shown without a restart and without a lost message."""

from __future__ import annotations

import signal
import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.rights import first_file
from robotkube.delivery.tasks.adapters.paho_gateway import PahoGateway
from robotkube.errors import UnavailableError
from robotkube.foundation.certificates.adapters.issuing import issue, new_authority
from robotkube.foundation.certificates.adapters.verification import ServerVerification, client_context
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.registry.suites.adapters.broker_observer import PahoObserver
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import CLOSED, PahoChannel
from tests.stages.delivery.rights_broker import ACCOUNTS, PLUGIN, answers, open_accounts, password, plugin
from tests.stages.paths import CHARTS
from tests.stages.programs import free_port
from tests.stages.waiting import WAIT_SECONDS_MAX, until

pytestmark = pytest.mark.toolchain

PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
NAME = "broker.robotkube.svc.cluster.local"
POSE = "mqtt/vehicles/vehicle_00/pose"
PERIOD_SECONDS = 0.01
RENEWALS, MESSAGES = 4, 40


class Events:
    """What a channel tells its owner."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []
        self.heard = self.lost = 0

    def connected(self, session_kept: bool) -> None: ...

    def disconnected(self) -> None:
        self.lost += 1

    def acknowledged(self, token: int, heard: bool) -> None:
        self.heard += heard

    def rejected(self, token: int, reason: str) -> None: ...

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        self.messages.append(payload)

    def refused(self, topic: str, reason: str) -> None: ...

    def granted(self, topic: str) -> None: ...


@dataclass
class EncryptedBroker:
    """The container of the broker's pod, as a process: the program that the chart renders, on its files."""

    folder: Path
    files: dict[str, str]
    port: int = field(default_factory=free_port)
    authority: Pair = field(default_factory=lambda: new_authority("ours", time.time()))

    def start(self) -> None:
        """Prepared as by the init container, and started with looks at the certificate every 0.1 s."""
        run, passwords = self.folder / "run", self.folder / "passwords"
        run.mkdir(parents=True)
        names = ["rights", "observer", "manager", *(agent.name for agent in ACCOUNTS.agents)]
        passwords.write_text("".join(f"{name}:{password(name)}\n" for name in names))
        first_file.write(ACCOUNTS, passwords, run / "dynamic-security.json")
        open_accounts(run / "dynamic-security.json")
        (self.folder / "ca.crt").write_text(self.authority.certificate)
        self.show(3600)
        places = {"/run/mosquitto": str(run)}
        places |= dict.fromkeys(("/etc/mosquitto-tls", "/etc/mosquitto"), str(self.folder))
        places |= {"listener 8883": f"listener {self.port} 127.0.0.1\nuser root", PLUGIN: str(plugin())}
        places["sleep 5"] = "sleep 0.1"
        for name in ("mosquitto.conf", "run.sh"):
            text = self.files[name]
            for old, new in places.items():
                text = text.replace(old, new)
            (self.folder / name).write_text(text)
        with (self.folder / "log").open("ab") as sink:
            self.process = subprocess.Popen(["sh", str(self.folder / "run.sh")], stdout=sink, stderr=sink)
        until(lambda: answers(self.port), "the broker", state=lambda: (self.folder / "log").read_text())

    def show(self, seconds: float, began: float = 0.0, authority: Pair | None = None) -> None:
        """Another certificate in the mounted files, both at once as a kubelet does it."""
        pair = issue(authority or self.authority, [NAME, "broker"], time.time() - began, seconds)
        for name, text in (("tls.crt", pair.certificate), ("tls.key", pair.key)):
            (self.folder / f"{name}.new").write_text(text)
        for name in ("tls.key", "tls.crt"):
            (self.folder / f"{name}.new").replace(self.folder / name)

    def shown(self) -> bytes:
        """The certificate that a client sees now, valid or not."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        with socket.create_connection(("127.0.0.1", self.port), 5) as plain, context.wrap_socket(plain) as encrypted:
            return encrypted.getpeercert(binary_form=True) or b""

    def renewed(self, *arguments: Any, **options: Any) -> None:
        """Show another one, and wait until the broker does."""
        before = self.shown()
        self.show(*arguments, **options)
        until(lambda: self.shown() != before, "the renewed certificate")

    def account(self, name: str, server: str = NAME, authorities: Path | None = None) -> BrokerAccount:
        tls = ServerVerification(authorities or self.folder / "ca.crt", server)
        return BrokerAccount("127.0.0.1", self.port, name, password(name), tls)

    def children(self) -> list[Path]:
        """What runs beside mosquitto, below /proc."""
        everything = [one for one in Path("/proc").iterdir() if one.name.isdigit()]
        return [one for one in everything if _parent(one) == self.process.pid]

    def stop(self) -> int:
        """End it; what looked at the certificate beside it ends by itself."""
        beside = self.children()
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(10)
        until(lambda: not any(one.exists() for one in beside), "the end of what ran beside the broker")
        return code


@pytest.fixture(scope="module")
def files(helm: Any) -> dict[str, str]:
    return dict(helm.template(CHARTS / "robotkube", PROFILE).one("ConfigMap", "broker")["data"])


@pytest.fixture
def broker(files: dict[str, str], tmp_path: Path) -> Iterator[EncryptedBroker]:
    running = EncryptedBroker(tmp_path / "broker", files)
    running.start()
    yield running
    if running.process.poll() is None:
        assert running.stop() == 0


@dataclass
class Turned:
    """Channels that a thread turns, as a bridge's loop does."""

    channels: list[tuple[PahoChannel, Events]] = field(default_factory=list)

    def add(self, account: BrokerAccount, client: str) -> tuple[PahoChannel, Events]:
        events = Events()
        self.channels.append((PahoChannel(lambda: account, client, 60, events), events))
        return self.channels[-1]

    def turn(self) -> None:
        for channel, _ in self.channels:
            channel.turn(time.monotonic())
            channel.flush()

    def until(self, condition: Callable[[], object], what: str) -> None:
        end = time.monotonic() + 30
        while not condition():
            assert time.monotonic() < end, (what, [channel.complaint for channel, _ in self.channels])
            self.turn()
            time.sleep(PERIOD_SECONDS)

    def complaint(self, account: BrokerAccount) -> str:
        """What a client says that never connects."""
        channel, _ = self.add(account, "asking")
        self.until(lambda: "not connected to the broker yet" not in (channel.complaint or "yet"), "a complaint")
        return channel.complaint or ""

    def close(self) -> None:
        for channel, _ in self.channels:
            channel.close()


@pytest.fixture
def turned() -> Iterator[Turned]:
    made = Turned()
    yield made
    made.close()


def test_certificates_are_renewed_under_load_without_a_lost_message_or_connection(
    broker: EncryptedBroker, turned: Turned
) -> None:
    """A vehicle that sends poses and, now and then, 3 MB of clouds; each certificate lives for a minute."""
    vehicle, told = turned.add(broker.account("vehicle-00"), "vehicle-00-telemetry")
    observer, heard = turned.add(broker.account("observer"), "observer")
    turned.until(lambda: vehicle.complaint is None and observer.complaint is None, "connected")
    observer.subscribe(["mqtt/#"])
    turned.until(lambda: vehicle.publish(POSE, b"first", False) is not None and told.heard, "subscribed")
    heard.messages.clear()
    sent: list[bytes] = []

    def send() -> None:
        for _ in range(MESSAGES):
            payload = b"%d" % len(sent) if len(sent) % MESSAGES else bytes(3_000_000)
            if vehicle.publish(POSE, payload, False) is not None:
                sent.append(payload)
            turned.turn()

    for _ in range(RENEWALS):
        before = broker.shown()
        broker.show(60)
        end = time.monotonic() + WAIT_SECONDS_MAX
        while broker.shown() == before:
            assert time.monotonic() < end, "the certificate was not read again"
            send()
        send()
    turned.until(lambda: len(heard.messages) >= len(sent), "all of them")
    assert [message for message in heard.messages if message != b"first"] == sent
    assert (told.lost, heard.lost) == (0, 0)
    assert broker.process.poll() is None


def test_who_is_refused_is_told_what_and_what_to_do(broker: EncryptedBroker, turned: Turned) -> None:
    """Wrong name, another authority, expired, and a client that speaks in clear text."""
    at = f"no encrypted connection to the broker 127.0.0.1:{broker.port}: its certificate"
    assert f"{at} is not for the name forge; connect by one" in turned.complaint(broker.account("vehicle-00", "forge"))
    other = broker.folder / "other.crt"
    other.write_text(new_authority("ours", time.time()).certificate)
    said = turned.complaint(broker.account("vehicle-00", authorities=other))
    assert f"{at} is of an authority that {other} does not have; compare" in said
    plain = BrokerAccount("127.0.0.1", broker.port, "vehicle-00", password("vehicle-00"))
    assert turned.complaint(plain) == f"asking: {CLOSED}"
    broker.renewed(60, began=120)
    assert f"{at} has expired; have it renewed" in turned.complaint(broker.account("vehicle-00"))


def test_everybody_else_who_connects_verifies_it_as_well(broker: EncryptedBroker) -> None:
    """The task gateway and the observer of suites; bridges and detectors have the channel above."""
    taken = "refuses the subscription of everything"  # to which it has no right here: after the handshake
    for name, said in ((NAME, taken), ("x", "its certificate is not for the name x")):
        with pytest.raises(UnavailableError, match=f"broker 127.0.0.1:{broker.port}: {said}"):
            PahoObserver(broker.account("observer", name), "observing")
        assert [one.name for one in threading.enumerate() if "observing" in one.name] == []
    for name, complaint in ((NAME, ""), ("x", "no encrypted connection to the broker")):
        account = broker.account("manager", name)
        gateway = PahoGateway(account.host, account.port, account.username, account.password, "gateway", account.tls)
        gateway.start(["robotkube/tasks/vehicle-00"])
        until(lambda g=gateway, c=complaint: g.complaint == c or (c and c in g.complaint), "an answer")
        gateway.close()


def test_a_client_that_verifies_nothing_it_was_not_told_connects_to_nobody(broker: EncryptedBroker) -> None:
    """Without the file of authorities there is no connection, rather than one in clear text."""
    (broker.folder / "none.crt").write_text("")
    with pytest.raises(Exception, match="no authority can be read there"):
        client_context(ServerVerification(broker.folder / "none.crt", NAME))
    assert "no authority can be read there" in Turned().complaint(
        broker.account("vehicle-00", authorities=broker.folder / "none.crt")
    )


def test_probes_leave_no_words_in_the_log(broker: EncryptedBroker) -> None:
    """A kubelet's TCP probe connects and goes."""
    for _ in range(5):
        socket.create_connection(("127.0.0.1", broker.port), 5).close()
    time.sleep(0.2)
    log = (broker.folder / "log").read_text()
    assert [line for line in log.splitlines() if "OpenSSL" in line or "Client" in line] == []


def test_the_container_ends_at_once_with_its_program(broker: EncryptedBroker, turned: Turned) -> None:
    """The program is mosquitto itself, so a kubelet's signal reaches it, and its end is the container's. Who answers a
    client has begun to take signals, too."""
    vehicle, _ = turned.add(broker.account("vehicle-00"), "vehicle-00-telemetry")
    turned.until(lambda: vehicle.complaint is None, "connected")
    assert Path(f"/proc/{broker.process.pid}/comm").read_text().strip() == "mosquitto"
    assert broker.children()
    assert broker.stop() == 0


def _parent(process: Path) -> int:
    try:
        return int(process.joinpath("stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0
