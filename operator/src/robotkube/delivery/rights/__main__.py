"""The process that owns the broker's rights: it reads main, and gives every account what main's links say.

Started by `robotkube-rights` or `python3 -m robotkube.delivery.rights`. Settings: docs/reference/settings.md. Ends with
0 on SIGTERM, 2 when the settings are wrong. The clone is below ROBOTKUBE_WORK (default /tmp/rights) and can be lost at
any time: what stands at the broker stays until main was read.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from robotkube.delivery.rights.adapters.dynamic_security import DynamicSecurity
from robotkube.delivery.rights.loops.keeper import Keeper
from robotkube.delivery.rights.loops.main_follower import MainFollower
from robotkube.delivery.rights.settings import RightsConfiguration, read_configuration
from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.forge.ports.repositories import MainHistory
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery
from robotkube.foundation.runtime.process import Process, run

GRACE_SECONDS = 5.0


class RightsProcess:
    """The process's parts on their adapters; nothing is asked or written before `run`."""

    def __init__(self, configuration: RightsConfiguration, repository: MainHistory) -> None:
        self._configuration = configuration
        accounts = configuration.accounts
        control = DynamicSecurity(lambda: configuration.broker)
        self.keeper = Keeper(control, lambda: self.follower, accounts, time.monotonic)
        self.follower = MainFollower(repository, accounts, self.keeper.wake, time.monotonic)
        self.server = WebServer(
            configuration.listen.address,
            configuration.listen.port,
            self.keeper.reasons_not_ready,
            MetricsPage(self.keeper.metrics).text,
            configuration.webhook_secret.encode(),
            self._deliver,
            pages={"/accounts": self.keeper.accounts_page},
            health_port=configuration.listen.health_port,
            certificate=configuration.listen.certificate,
        )

    def run(self, stopping: threading.Event) -> None:
        """Serve, follow main and keep the rights until `stopping` is set."""
        self.server.start()
        following = threading.Thread(target=self.follower.run, args=(stopping,), name="main", daemon=True)
        following.start()
        self.keeper.run(stopping)
        self.follower.wake()
        following.join(GRACE_SECONDS)
        self.server.stop()

    def _deliver(self, delivery: WebhookDelivery) -> None:
        forge = self._configuration.forge
        tip = delivery.moved_to(forge.deployment, forge.branch)
        if tip is not None:
            self.follower.wake(tip)


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Keep the rights until the process shall end."""
    configuration = files.start_with_settings(process, read_configuration, environment)
    trust(configuration.forge.address.authorities)
    work = Path(environment.get("ROBOTKUBE_WORK", "/tmp/rights"))  # noqa: S108 - the pod's own volume
    work.mkdir(parents=True, exist_ok=True)
    forge = configuration.forge
    rights = RightsProcess(configuration, forge.clone(forge.deployment, work / "deployment"))
    process.log("started", **rights.server.ports, agents=len(configuration.accounts.agents))
    rights.run(process.stopping)


def main() -> None:
    """Run until SIGTERM; exit codes as in `foundation.runtime.process`."""
    run("rights", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
