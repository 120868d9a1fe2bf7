"""Following main of the deployment repository: its releases become the table of rights."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from robotkube.delivery.deployment.core.releases import read_tree
from robotkube.delivery.deployment.loops.main_history import policy_files, release_files
from robotkube.delivery.rights.core.accounts import Accounts
from robotkube.delivery.rights.core.grants import MainTable, main_table
from robotkube.errors import RobotKubeError
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS
from robotkube.foundation.forge.ports.repositories import MainHistory
from robotkube.foundation.runtime.loops.wakeups import step_when_woken

RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 1.0, 2.0

log = logging.getLogger(__name__)


class MainFollower:
    """Main's table of rights, on one thread; `wake` from any. `changed` is called when there is another one. A forge
    that does not answer leaves the table as it is."""

    def __init__(
        self,
        repository: MainHistory,
        accounts: Accounts,
        changed: Callable[[], None],
        monotonic: Callable[[], float],
    ) -> None:
        self._repository = repository
        self._accounts = accounts
        self._changed = changed
        self._monotonic = monotonic
        self._woken = threading.Event()
        self._announced = ""
        self._confirmed_at = monotonic()
        self.announced_at = 0.0
        self.table: MainTable | None = None
        self.problem = ""
        self.failed = 0

    def wake(self, tip: str = "") -> None:
        """Something changed: main is read now. `tip`: of main, where it was told."""
        if tip:
            self._announced = tip
            self.announced_at = self._monotonic()
        self._woken.set()

    @property
    def tip(self) -> str:
        """Main's tip as it was announced or seen last; empty before that."""
        return self._announced or (self.table.commit if self.table else "")

    @property
    def unconfirmed_seconds(self) -> float:
        """How long ago the table was last known to be that of main."""
        return self._monotonic() - self._confirmed_at

    def step(self) -> bool:
        """Read main; False when that failed. A problem is logged when it comes and when it is another one."""
        announced = self._announced
        try:
            self._read()
        except RobotKubeError as error:
            self.failed += 1
            if str(error) != self.problem:
                log.warning("rights: main cannot be read, they stay as they are: %s", error)
            self.problem = str(error)
            return False
        if self.problem:
            log.info("rights: main is followed again after_seconds=%d", self.unconfirmed_seconds)
        self.problem = ""
        if self._announced == announced:
            self._announced = ""
        self._confirmed_at = self._monotonic()
        return True

    def _read(self) -> None:
        tip = self._repository.fetch()
        if not tip or (self.table is not None and self.table.commit == tip):
            return
        before = self.table
        tree = read_tree(release_files(self._repository, tip))
        table = main_table(tip, tree, self._accounts, before, policy_files(self._repository, tip))
        for problem in table.problems:
            if before is None or problem not in before.problems:
                log.warning("rights: %s", problem)
        self.table = table
        self._changed()

    def run(self, stopping: threading.Event) -> None:
        """Read when woken, and now and then without, until `stopping` is set (and `wake` called)."""
        retry_seconds = (RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX)
        step_when_woken(self.step, self._woken, stopping, RESYNC_SECONDS, retry_seconds)
