"""The process that keeps the platform's certificates: an authority made once, those of servers and, where they are
asked for, of accounts at the broker, and whom to trust.

Started by `robotkube-certificates` or `python3 -m robotkube.delivery.certificates`. Settings:
docs/reference/settings.md. Ends with 0 on SIGTERM, 2 when the settings are wrong. Nothing is kept here: all of it
stands in Secrets and ConfigMaps.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping

from robotkube.delivery.certificates.adapters.certificate_objects import KubernetesCertificates
from robotkube.delivery.certificates.adapters.shut_accounts import ShutAccountsPage
from robotkube.delivery.certificates.loops.account_keeper import AccountKeeper
from robotkube.delivery.certificates.loops.keeper import CertificateKeeper
from robotkube.delivery.certificates.settings import FORMER_KEYS, CertificatesConfiguration, read_configuration
from robotkube.foundation.certificates.adapters import issuing
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from robotkube.foundation.pages.adapters.http_pages import HttpPages
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.process import Process, run

GRACE_SECONDS = 12.0  # of which one request may take 10
PAGE_BYTES_MAX = 1024 * 1024  # of the names of accounts


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Keep certificates, and say how long they hold, until the process shall end."""
    settings = files.start_with_settings(process, read_configuration, environment, FORMER_KEYS)
    objects = KubernetesCertificates(ApiServer.from_environment(environment), settings.issuance)
    keeper = CertificateKeeper(objects, issuing, settings.issuance, time.time, _accounts(objects, settings))
    listen = settings.listen
    server = WebServer(
        listen.address,
        listen.port,
        keeper.reasons_not_ready,
        MetricsPage(keeper.metrics).text,
        pages={"/accounts": keeper.accounts_page},
    )
    server.start()
    process.log("started", **server.ports, namespaces=len(settings.issuance.namespaces))
    keeper.run(process.stopping)
    server.stop()


def _accounts(objects: KubernetesCertificates, settings: CertificatesConfiguration) -> AccountKeeper | None:
    """The keeper of accounts' certificates, where accounts are proved by them."""
    issuance = settings.issuance.accounts
    if issuance is None:
        return None
    shut = ShutAccountsPage(HttpPages(PAGE_BYTES_MAX), issuance.shut)
    return AccountKeeper(objects, issuing, issuance, shut, time.time)


def main() -> None:
    """Run until SIGTERM; exit codes as in `foundation.runtime.process`."""
    run("certificates", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
