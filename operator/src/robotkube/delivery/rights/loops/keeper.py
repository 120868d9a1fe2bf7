"""Keeping the broker's rights to main's table: what differs is changed, and what somebody else changed is told."""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.backoffs import Random, backoff
from robotkube.delivery.rights.core.accounts import Accounts, fixed_rights
from robotkube.delivery.rights.core.control import STATE, Entry, Standing, read_standing, role_pages, wanted_roles
from robotkube.delivery.rights.core.differences import (
    RightsChange,
    access_changes,
    endings,
    foreign_changes,
    missing,
    never_given,
    role_changes,
)
from robotkube.delivery.rights.core.grants import MainTable
from robotkube.delivery.rights.loops.main_follower import MainFollower
from robotkube.delivery.rights.ports import BrokerControl
from robotkube.errors import RobotKubeError, UnavailableError
from robotkube.foundation.runtime.ports import Series

TURN_SECONDS = 0.2
CHECK_SECONDS = 5.0
RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 1.0, 2.0

log = logging.getLogger(__name__)

Roles = Mapping[str, frozenset[Entry]]


class Keeper:
    """The rights at one broker, on one thread; `wake` from any. Nothing is changed before main was read once: until
    then what stands at the broker stays."""

    def __init__(
        self,
        control: BrokerControl,
        follower: Callable[[], MainFollower],
        accounts: Accounts,
        monotonic: Callable[[], float],
        jitter: Random = random.random,
    ) -> None:
        self._control = control
        self._follower = follower
        self._first = wanted_roles(fixed_rights(accounts))
        self._monotonic = monotonic
        self._jitter = jitter
        self._woken = threading.Event()
        self._due = 0.0
        self._failures = 0  # since the broker had main's table last
        self._connections = 0
        self._written: Roles = {}  # what this process gave the broker, empty before that
        self._shut: frozenset[str] | None = None  # whom it shut out, as main said then
        self._revoked: Mapping[str, str] = {}
        self._enrolled: Mapping[str, str] = {}
        self.applied = ""  # the commit whose table stands at the broker
        self.problem = ""
        self.applied_seconds = 0.0
        self.writes = self.restored = self.failed = 0

    def wake(self) -> None:
        """The table changed: the broker gets it now."""
        self._due = 0.0
        self._woken.set()

    def run(self, stopping: threading.Event) -> None:
        """Keep the rights until `stopping` is set (and `wake` called), then leave the broker."""
        while not stopping.is_set():
            self._woken.clear()
            self.step()
            self._woken.wait(TURN_SECONDS)
        self._control.close()

    def step(self) -> None:
        """Keep the connection; where that is due, compare and change. A problem is logged when it is another one."""
        self._control.turn()
        now = self._monotonic()
        again = self._control.connections != self._connections
        if self._control.complaint is not None or self._follower().table is None or not (again or now >= self._due):
            return
        self._due = now + CHECK_SECONDS
        try:
            self._keep(again)
        except RobotKubeError as error:
            self._failed(str(error), now)
            return
        if self.problem:
            log.info("rights: the broker has main's table again")
        self.problem = ""
        self._failures = 0

    def _failed(self, problem: str, now: float) -> None:
        self.failed += 1
        self._due = now + backoff(self._failures, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter)
        self._failures += 1
        self.applied = ""
        if problem != self.problem:
            log.warning("rights: the broker does not have main's table: %s", problem)
        self.problem = problem

    def _keep(self, again: bool) -> None:
        """One comparison, and the changes that it asks for."""
        main = self._follower().table
        assert main is not None
        wanted = wanted_roles(main.table)
        connections = self._control.connections
        standing = self._standing()
        lists = role_changes(standing, wanted)
        foreign = list(foreign_changes(standing, wanted))
        access = access_changes(standing, wanted, main.shut)
        self._tell(standing, wanted, foreign, again)
        requests = [change.request for change in (*foreign, *lists, *access)]
        again_and_again = endings(standing, main.revoked)
        if requests or again_and_again:
            self._control.ask([*requests, *again_and_again])
        self.writes += bool(requests)
        self._connections = connections
        self._written = wanted
        self._note_access(main)
        absent = missing(standing, wanted)
        if absent:
            raise UnavailableError(
                f"the broker lacks the account {', '.join(absent)}. Its pod makes accounts when it starts: "
                "let it start again (kubectl rollout restart deployment broker)"
            )
        self._note(main.commit, lists)

    def _note(self, commit: str, lists: Sequence[RightsChange]) -> None:
        if commit == self.applied:
            return
        follower = self._follower()
        if self.applied and follower.announced_at:
            self.applied_seconds = self._monotonic() - follower.announced_at
        follower.announced_at = 0.0
        self.applied = commit
        log.info("rights applied commit=%s accounts=%d", commit[:12], len(lists))

    def _note_access(self, main: MainTable) -> None:
        """Say who is shut out from now on, and who no more, and who is enrolled."""
        before = self._revoked
        now = main.revoked or {}
        for agent in sorted(now.keys() - before.keys()):
            log.warning("account revoked agent=%s commit=%s reason=%r", agent, main.commit[:12], now[agent])
        for agent in sorted(before.keys() - now.keys()):
            log.info("account restored agent=%s commit=%s", agent, main.commit[:12])
        for agent in sorted(main.enrolled.keys() - self._enrolled.keys()):
            log.info("agent enrolled agent=%s role=%s commit=%s", agent, main.enrolled[agent], main.commit[:12])
        for agent in sorted(self._enrolled.keys() - main.enrolled.keys()):
            log.warning("agent withdrawn agent=%s commit=%s", agent, main.commit[:12])
        self._shut = main.shut
        self._revoked = now
        self._enrolled = main.enrolled

    def _standing(self) -> Standing:
        state = self._control.ask(STATE)
        count = len(state[0].get("data", {}).get("roles", ()))
        pages = [self._control.ask([page])[0] for page in role_pages(count)]
        try:
            return read_standing(state, pages)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise UnavailableError(f"an answer of the broker cannot be read ({error!r})") from error

    def _tell(self, standing: Standing, wanted: Roles, foreign: Sequence[RightsChange], again: bool) -> None:
        """Say and count what somebody else changed. A broker that began anew has its first table, which nobody
        changed."""
        begun_anew = again and all(standing.roles.get(name) == listed for name, listed in self._first.items())
        lists: Sequence[RightsChange] = ()
        if self._written and not begun_anew:
            lists = (*role_changes(standing, self._written), *access_changes(standing, self._written, self._shut))
        elif not begun_anew:  # main may have moved while this process was away
            lists = never_given(standing, wanted)
        for change in (*foreign, *lists):
            self.restored += 1
            log.warning("rights restored about=%s was=%r by=%s", change.about, change.was, "another hand")

    def reasons_not_ready(self) -> Sequence[str]:
        """Why this is not ready: the broker does not have main's table as main was seen or announced last. Main that
        cannot be read is no reason: the last table stays, and is the right one as far as is known."""
        follower = self._follower()
        if self._control.complaint is not None:
            return [self._control.complaint]
        if follower.table is None:
            return [f"main was not read yet{f': {follower.problem}' if follower.problem else ''}"]
        if self.problem:
            return [self.problem]
        if self.applied != follower.tip or self._control.connections != self._connections:
            return [
                f"the broker's rights are those of {self.applied[:12] or 'no commit'}, main is at {follower.tip[:12]}"
            ]
        return []

    def accounts_page(self) -> Mapping[str, Any]:
        """Who may not be at the broker, as main says it: `shut` is null while nobody has read that yet."""
        main = self._follower().table
        shut = None if main is None or main.shut is None else sorted(main.shut)
        return {"commit": main.commit if main else "", "shut": shut}

    def metrics(self) -> Sequence[Series]:
        """What Prometheus reads."""
        follower = self._follower()
        prefix = "robotkube_rights_"
        main = follower.table
        listed = sum(len(one.grants) for one in main.granted.values()) if main else 0
        behind = "1 while the broker does not have main's table as main was seen or announced last, else 0."
        unconfirmed = "Seconds since the table was last known to be that of main."
        applied = "Seconds from main's last announcement until the broker had its table."
        shut = "Agents that main says may not be at the broker."
        enrolled = "Reserved agents that main enrolls."
        revoked = float(len(main.revoked or ())) if main else 0.0
        restored = "Rights, accounts and roles that somebody else had changed, put right."
        counts: dict[tuple[str, ...], float] = {("main",): float(follower.failed), ("broker",): float(self.failed)}
        return (
            Series(f"{prefix}granted", "gauge", "Topics that releases on main give to read.", {(): float(listed)}),
            Series(f"{prefix}revoked", "gauge", shut, {(): revoked}),
            Series(f"{prefix}enrolled", "gauge", enrolled, {(): float(len(main.enrolled)) if main else 0.0}),
            Series(f"{prefix}behind", "gauge", behind, {(): float(bool(self.reasons_not_ready()))}),
            Series(f"{prefix}unconfirmed_seconds", "gauge", unconfirmed, {(): follower.unconfirmed_seconds}),
            Series(f"{prefix}applied_seconds", "gauge", applied, {(): self.applied_seconds}),
            Series(f"{prefix}writes_total", "counter", "Changes of the broker's table.", {(): float(self.writes)}),
            Series(f"{prefix}restored_total", "counter", restored, {(): float(self.restored)}),
            Series(f"{prefix}failures_total", "counter", "Steps that failed.", counts, ("with",)),
        )
