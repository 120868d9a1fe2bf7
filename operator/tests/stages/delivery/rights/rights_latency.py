"""How soon a merged link is a right at the broker, and a withdrawn one none any more, N times each: prints milliseconds
as JSON.

    ci/python -m tests.stages.delivery.rights.rights_latency N

A real forge, the process that keeps rights behind its webhook, and a real broker that speaks TLS. All times are from
the beginning of the push that moves main. `applied`: until a message of the other vehicle arrives where the right was
missing before. `ended`: until the last message that arrives after the link was withdrawn. `announced`: until the
forge's webhook has reached the process, which is the forge's part of each; `own`: the rest of it.
"""

from __future__ import annotations

import json
import secrets
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from robotkube.delivery.rights import __main__ as process
from robotkube.delivery.rights.loops import main_follower
from robotkube.delivery.rights.settings import RightsConfiguration
from robotkube.foundation.forge.connect import ForgeAddress, ForgeSettings
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery
from robotkube.foundation.runtime.settings_file import Credentials, Listen
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap, ForgeSetup, Webhook
from tests.stages.delivery.rights.main_of_links import POSE_01, bridge, texts
from tests.stages.delivery.rights.rights_broker import RightsBroker, password
from tests.stages.delivery.tasks.mqtt_connection import Connection
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import ACCOUNTS, Clone, forge_setup
from tests.stages.programs import free_port

WARMING_UP = 2
WAIT_SECONDS_MAX = 60.0
POLL_SECONDS = 0.002
SPEAKING_SECONDS = 0.005
"""Between two messages of the other vehicle: what is measured is known so closely."""
QUIET_SECONDS = 0.2
NO_RESYNC_SECONDS = 3600.0
REPOSITORY = "robotkube/deployment"
TOPIC = f"mqtt{POSE_01}"
SPEAKER, LISTENER = "vehicle-01", "vehicle-00"
LINK = texts(bridge(LISTENER, POSE_01))


def until(condition: Callable[[], object], what: str) -> None:
    """Wait until it is true; polls often, since what it waits for is being measured."""
    end = time.monotonic() + WAIT_SECONDS_MAX
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {WAIT_SECONDS_MAX:.0f} s: {what}")
        time.sleep(POLL_SECONDS)


def forge_of_rights(forge: ForgeProcess, passwords: dict[str, str], webhook: str, secret: str) -> None:
    """Accounts and the deployment repository, whose pushes are announced to the process that keeps rights."""
    made: ForgeSetup = forge_setup(passwords, webhook)
    deployment = next(repository for repository in made.repositories if repository.name == REPOSITORY)
    readable = replace(deployment, access={**deployment.access, "rights": "read"})
    setup = replace(made, repositories=(readable,), webhooks=(Webhook(REPOSITORY, webhook, ("push",), secret),))
    administration = GiteaAdministration(forge.url, forge.administrator, forge.administrator_password)
    Bootstrap(30, time.monotonic, time.sleep).forge(setup, administration)
    administration.disconnect()


class Speaker:
    """A vehicle that says something all the time, heard or not."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._speak, daemon=True)
        self._thread.start()

    def _speak(self) -> None:
        while not self._stopping.wait(SPEAKING_SECONDS):
            self._connection.say(TOPIC)

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join(WAIT_SECONDS_MAX)


class Listener:
    """A vehicle that wants to hear it, and when it did last."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def hears(self) -> float:
        """Ask until it may, and wait for the next message; when that came."""
        until(lambda: self._connection.subscribe(TOPIC) < 128, "the right")
        known = len(self._connection.received)
        until(lambda: len(self._connection.received) > known, "a message")
        return time.monotonic()

    def last_heard(self, applied: Callable[[], bool]) -> float:
        """The time of the last message: nothing comes any more once the broker has the table."""
        known = len(self._connection.received)
        at = time.monotonic()
        end = at + WAIT_SECONDS_MAX
        while not applied() or time.monotonic() - at < QUIET_SECONDS:
            if time.monotonic() > end:
                raise TimeoutError("the right does not end")
            if len(self._connection.received) > known:
                known = len(self._connection.received)
                at = time.monotonic()
            time.sleep(POLL_SECONDS)
        return at


class AnnouncedRights(process.RightsProcess):
    """The process that keeps rights; `announced` is when the forge's webhook reached it last."""

    announced = 0.0

    def _deliver(self, delivery: WebhookDelivery) -> None:
        self.announced = time.monotonic()
        super()._deliver(delivery)

    def applied(self, commit: str) -> bool:
        """Return whether the broker has the table of that commit."""
        return self.keeper.applied == commit


class Rounds:
    """Merges and withdrawals of one link; milliseconds of each by what was measured."""

    def __init__(self, gate: Clone, rights: AnnouncedRights, listener: Listener) -> None:
        self._gate, self._rights, self._listener = gate, rights, listener
        self.milliseconds: dict[str, list[float]] = {name: [] for name in ("applied", "ended", "announced", "own")}

    def run(self, count: int) -> dict[str, list[float]]:
        """So many of both, besides the first few, which do not count."""
        for _ in range(WARMING_UP + count):
            self._moved("applied", LINK, lambda _: self._listener.hears())
            self._moved("ended", dict.fromkeys(LINK), lambda gone: self._listener.last_heard(gone))
        rounds = WARMING_UP + count
        return {name: values[len(values) * WARMING_UP // rounds :] for name, values in self.milliseconds.items()}

    def _moved(self, name: str, changes: Mapping[str, str | None], seen: Callable[[Callable[[], bool]], float]) -> None:
        """Main is moved by these changes; `seen` gives when that was to be seen, by whether the table is there."""
        commit = self._gate.commit(changes, f"deploy: {name}", [self._gate.tip()])
        began = time.monotonic()
        refusal = self._gate.push(commit, "refs/heads/main")
        assert refusal == "", refusal
        moment = seen(lambda: self._rights.applied(commit))
        until(lambda: self._rights.applied(commit), "the table")
        self.milliseconds[name].append(1000 * (moment - began))
        self.milliseconds["announced"].append(1000 * (self._rights.announced - began))
        self.milliseconds["own"].append(1000 * (moment - self._rights.announced))


def measure(folder: Path, count: int) -> dict[str, list[float]]:
    """On a forge and a broker of their own."""
    main_follower.RESYNC_SECONDS = NO_RESYNC_SECONDS  # the webhook alone is what brings it
    passwords = {account: secrets.token_hex(12) for account in ACCOUNTS}
    webhook = secrets.token_hex(12)
    port = free_port()
    broker = RightsBroker(folder / "broker", encrypted=True)
    forge = ForgeProcess(folder / "forge")
    stopping = threading.Event()
    broker.start()
    forge.start()
    try:
        forge_of_rights(forge, passwords, f"http://127.0.0.1:{port}/webhook", webhook)
        account = Credentials("rights", passwords["rights"])
        settings = ForgeSettings(ForgeAddress(forge.url), account, "main", deployment=REPOSITORY)
        listen = Listen("127.0.0.1", port)
        owner = broker.account("rights")
        configuration = RightsConfiguration(listen, "INFO", settings, webhook, owner, broker.accounts)
        rights = AnnouncedRights(configuration, settings.clone(REPOSITORY, folder / "work"))
        running = threading.Thread(target=rights.run, args=(stopping,), daemon=True)
        running.start()
        until(lambda: rights.keeper.reasons_not_ready() == [], "ready")
        names = (SPEAKER, LISTENER)
        speaking, listening = (Connection(broker.port, name, password(name), tls=broker.tls) for name in names)
        speaker = Speaker(speaking)
        gate = Clone(forge.url, REPOSITORY, "gate", passwords["gate"], folder / "clone")
        milliseconds = Rounds(gate, rights, Listener(listening)).run(count)
        speaker.stop()
        for connection in (speaking, listening):
            connection.close()
        stopping.set()
        rights.keeper.wake()
        running.join(WAIT_SECONDS_MAX)
    finally:
        stopping.set()
        forge.remove()
        broker.stop()
    return milliseconds


def main(count: int) -> None:
    """Measure, and print."""
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(measure(Path(folder), count)))


if __name__ == "__main__":
    main(int(sys.argv[1]))
