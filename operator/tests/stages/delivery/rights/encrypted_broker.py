"""The broker of the chart as a process: the program that the chart renders, on its files, with Debian's mosquitto; and
channels that a test turns."""

from __future__ import annotations

import itertools
import signal
import socket
import ssl
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robotkube.delivery.rights import first_file
from robotkube.foundation.certificates.adapters.issuing import issue, issue_account, new_authority, revocation_list
from robotkube.foundation.certificates.adapters.verification import ClientCertificate, ServerVerification
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from tests.stages.delivery.rights.rights_broker import ACCOUNTS, PLUGIN, answers, open_accounts, password, plugin
from tests.stages.programs import free_port
from tests.stages.waiting import until

NAME = "broker.robotkube.svc.cluster.local"
PERIOD_SECONDS = 0.01


class Events:
    """What a channel tells its owner."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []
        self.heard = self.ups = self.lost = 0

    def connected(self, session_kept: bool) -> None:
        self.ups += 1

    def disconnected(self) -> None:
        self.lost += 1

    def acknowledged(self, token: int, heard: bool) -> None:
        self.heard += heard

    def rejected(self, token: int, reason: str) -> None: ...

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        self.messages.append(payload)

    def refused(self, topic: str, reason: str) -> None: ...

    def granted(self, topic: str) -> None: ...


class SendingBoth(BrokerAccount):
    """An account that sends name and password although a certificate says another one."""

    @property
    def login(self) -> tuple[str, str] | None:
        return self.username, self.password


@dataclass
class EncryptedBroker:
    """The container of the broker's pod, as a process: the program that the chart renders, on its files."""

    folder: Path
    files: dict[str, str]
    port: int = field(default_factory=free_port)
    authority: Pair = field(default_factory=lambda: new_authority("ours", time.time()))
    _folders: Iterator[int] = field(default_factory=itertools.count)

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
        self.revoke()
        places = {"/run/mosquitto": str(run), "/etc/mosquitto-accounts": str(self.folder)}
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

    def revoke(self, *serials: int, authority: Pair | None = None) -> None:
        """Another list of revoked certificates of accounts, in the mounted file."""
        text = revocation_list(authority or self.authority, dict.fromkeys(serials, time.time()), time.time())
        (self.folder / "revoked.new").write_text(text)
        (self.folder / "revoked.new").replace(self.folder / "revoked.crl")

    def proved(self, name: str, pair: Pair | None = None, says: str = "") -> BrokerAccount:
        """An account that a certificate proves, by default a good one; its files are in a folder of their own. `says`:
        the name of another account, which is sent with that one's password."""
        pair = pair or issue_account(self.authority, name, time.time(), 3600)
        folder = self.folder / f"account-{next(self._folders)}"
        folder.mkdir()
        (folder / "tls.crt").write_text(pair.certificate)
        (folder / "tls.key").write_text(pair.key)
        tls = ServerVerification(self.folder / "ca.crt", NAME)
        own = ClientCertificate(folder)
        sent = SendingBoth if says else BrokerAccount
        return sent("127.0.0.1", self.port, says or name, password(says or name), tls, own)

    def shown(self) -> bytes:
        """The certificate that a client sees now, valid or not."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
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
        until(lambda: all(map(_ended, beside)), "the end of what ran beside the broker")
        return code


@contextmanager
def running(folder: Path, files: dict[str, str]) -> Iterator[EncryptedBroker]:
    """A broker on the files of the chart's ConfigMap; it has to end well, unless a test has ended it."""
    broker = EncryptedBroker(folder, files)
    broker.start()
    yield broker
    if broker.process.poll() is None:
        assert broker.stop() == 0


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


def _parent(process: Path) -> int:
    facts = _facts(process)
    return int(facts[1]) if facts else 0


def _ended(process: Path) -> bool:
    """Also when whoever has become its parent has not asked how: some look for that every two seconds."""
    facts = _facts(process)
    return not facts or facts[0] == "Z"


def _facts(process: Path) -> list[str]:
    """Its state, its parent and more; none of a process that is not there."""
    try:
        return process.joinpath("stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []
