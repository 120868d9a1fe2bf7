"""A real mosquitto with the dynamic security plugin, begun as the chart's pod begins it."""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import socket
import subprocess
from pathlib import Path

from robotkube.delivery.rights import first_file
from robotkube.delivery.rights.core.accounts import OBSERVER, OWNER, Accounts, AgentAccount, ManagerAccount
from robotkube.foundation.certificates.adapters.issuing import throw_away
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from tests.stages.programs import free_port
from tests.stages.waiting import until

PLUGIN = "mosquitto_dynamic_security.so"
SETTINGS = """
listener {port} 127.0.0.1
{certificate}user root
allow_anonymous false
plugin {plugin}
plugin_opt_config_file {file}
persistence false
max_queued_messages 50000
sys_interval 0
connection_messages false
log_dest stdout
log_type error
log_type warning
"""
NAMES = [("vehicle-00", "vehicle"), ("vehicle-01", "vehicle"), ("roadside-0", "roadside"), ("cloud-0", "cloud")]
ACCOUNTS = Accounts(tuple(AgentAccount(name, role, name) for name, role in NAMES), (ManagerAccount("manager", ("*",)),))


def plugin() -> Path:
    """The plugin that came with the mosquitto in the path."""
    program = shutil.which("mosquitto")
    assert program, "mosquitto is not installed"
    prefix = Path(program).resolve().parent.parent
    files = sorted([*prefix.glob(f"lib/{PLUGIN}"), *prefix.glob(f"lib/*/{PLUGIN}")])
    assert files, f"{prefix}/lib has no {PLUGIN}"
    return files[0]


class RightsBroker:
    """The broker in a folder; its passwords are `secret of <account>`. `restart` keeps the file, as a container that
    starts again does; `begin_anew` does not, as another pod. `tls`: how it proves who it is when it is `encrypted`."""

    def __init__(self, folder: Path, accounts: Accounts = ACCOUNTS, encrypted: bool = False) -> None:
        self.folder = folder
        self.accounts = accounts
        self.port = free_port()
        self.file = folder / "run" / "dynamic-security.json"
        self.passwords = folder / "passwords"
        self.log = folder / "log"
        self._process: subprocess.Popen[bytes] | None = None
        self.file.parent.mkdir(parents=True)
        names = [
            OWNER,
            OBSERVER,
            *(agent.name for agent in accounts.agents),
            *(manager.name for manager in accounts.managers),
        ]
        self.passwords.write_text("".join(f"{name}:{password(name)}\n" for name in names))
        self.tls = ServerVerification(folder / "ca.crt", "broker") if encrypted else None
        certificate = self._certify() if encrypted else ""
        settings = SETTINGS.format(port=self.port, plugin=plugin(), file=self.file, certificate=certificate)
        (folder / "mosquitto.conf").write_text(settings)

    def account(self, name: str) -> BrokerAccount:
        return BrokerAccount("127.0.0.1", self.port, name, password(name), self.tls)

    def _certify(self) -> str:
        """Files of a certificate for the name `broker`; the settings that name them."""
        issued = throw_away("broker")
        files = {"ca.crt": issued.authority, "tls.crt": issued.pair.certificate, "tls.key": issued.pair.key}
        for name, text in files.items():
            (self.folder / name).write_text(text)
        return f"certfile {self.folder}/tls.crt\nkeyfile {self.folder}/tls.key\n"

    def start(self, opened: bool = False) -> None:
        """Write the file as the init container does, and return when the broker takes connections. `opened`: agents are
        let in, though nobody keeps the rights."""
        first_file.write(self.accounts, self.passwords, self.file)
        if opened:
            open_accounts(self.file)
        self._process = run_mosquitto(self.folder / "mosquitto.conf", self.port, self.log)

    def stop(self) -> None:
        if self._process is not None:
            self._process.send_signal(signal.SIGTERM)
            self._process.wait(10)
            self._process = None

    def restart(self) -> None:
        self.stop()
        self._process = run_mosquitto(self.folder / "mosquitto.conf", self.port, self.log)

    def begin_anew(self) -> None:
        self.stop()
        self.file.unlink()
        self.start()


def open_accounts(file: Path) -> None:
    """Let everybody in who has an account in a file of the plugin."""
    document = json.loads(file.read_text())
    for client in document["clients"]:
        client.pop("disabled", None)
    file.write_text(json.dumps(document))


def password(account: str) -> str:
    return f"secret of {account}"


def run_mosquitto(configuration: Path, port: int, log: Path) -> subprocess.Popen[bytes]:
    """A mosquitto that takes connections."""
    with log.open("ab") as sink:
        process = subprocess.Popen(["mosquitto", "-c", str(configuration)], stdout=sink, stderr=sink)
    until(lambda: process.poll() is not None or answers(port), "the broker", state=log.read_text)
    assert process.poll() is None, log.read_text()
    return process


def answers(port: int) -> bool:
    """Return whether somebody takes connections there."""
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
        return True
    return False
