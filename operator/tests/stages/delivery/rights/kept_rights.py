"""A broker whose rights are kept to a main, by the process's own loops."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.rights.adapters.dynamic_security import DynamicSecurity
from robotkube.delivery.rights.core.accounts import Accounts
from robotkube.delivery.rights.core.control import REQUESTS
from robotkube.delivery.rights.loops.keeper import Keeper
from robotkube.delivery.rights.loops.main_follower import MainFollower
from tests.stages.delivery.rights.main_of_links import Main
from tests.stages.delivery.rights.rights_broker import ACCOUNTS, RightsBroker, password
from tests.stages.delivery.tasks.mqtt_connection import Connection
from tests.stages.waiting import until


class KeptRights:
    """A broker, main, and the process's loops between them. `main`: in memory, unless there is another one."""

    def __init__(self, folder: Path, main: Any = None, accounts: Accounts = ACCOUNTS) -> None:
        self.broker = RightsBroker(folder, accounts)
        self.main = main or Main()
        self.made: list[Connection] = []
        self.broker.start()
        self.begin()

    def begin(self) -> None:
        """The process starts."""
        self.control = DynamicSecurity(lambda: self.broker.account("rights"))
        self.keeper = Keeper(self.control, lambda: self.follower, self.broker.accounts, time.monotonic)
        self.follower = MainFollower(self.main, self.broker.accounts, self.keeper.wake, time.monotonic)
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=one.run, args=(self._stopping,)) for one in (self.keeper, self.follower)
        ]
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """The process ends."""
        self._stopping.set()
        self.keeper.wake()
        self.follower.wake()
        for thread in self._threads:
            thread.join(10)

    def merge(
        self, *releases: Release, revoked: Mapping[str, str] | None = None, policies: Mapping[str, str] | None = None
    ) -> float:
        """Main has these releases and no others, revokes these agents, and has these policies besides; the seconds
        until the broker had its table."""
        tip = self.main.put(*releases, revoked=revoked, policies=policies)
        begun = time.monotonic()
        self.follower.wake(tip)
        until(lambda: self.keeper.applied == tip, "the table", state=lambda: self.keeper.reasons_not_ready())
        return time.monotonic() - begun

    def ready(self) -> None:
        until(lambda: self.keeper.reasons_not_ready() == [], "ready", state=lambda: self.keeper.reasons_not_ready())

    def connect(self, name: str, will: str = "", client_id: str = "") -> Connection:
        self.made.append(Connection(self.broker.port, name, password(name), will, client_id=client_id))
        return self.made[-1]

    def tamper(self, *commands: Mapping[str, Any]) -> None:
        """Somebody else who has the owner's password, while the process is at work."""
        self.connect("rights").say(REQUESTS, json.dumps({"commands": commands}).encode())

    @contextmanager
    def other_hand(self) -> Iterator[DynamicSecurity]:
        """Somebody else who has the owner's password."""
        self.end()
        hand = DynamicSecurity(lambda: self.broker.account("rights"))
        until(lambda: (hand.turn(), hand.complaint is None)[1], "a connection")
        yield hand
        hand.close()
        self.begin()
        self.ready()
