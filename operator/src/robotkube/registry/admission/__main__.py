"""The process that writes the admission policies and their list, on clusters whose API server reads no files.

Started by `robotkube-admission` or `python3 -m robotkube.registry.admission`. Settings: docs/reference/settings.md.
Ends with 0 on SIGTERM, 2 when the settings are wrong. The clone of the catalogue is below ROBOTKUBE_WORK (default
/tmp/admission); it can be lost at any time: the last list stands in the cluster.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kubernetes.client import ApiClient

from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.documents.core.patterns import CHARTS_URL, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.forge.connect import ForgeSettings, read_forge
from robotkube.foundation.kubernetes.adapters.client import api_client
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery
from robotkube.foundation.runtime.ports import Series
from robotkube.foundation.runtime.process import Process, run
from robotkube.registry.admission.adapters.policy_objects import ListMemory, PolicyObjects
from robotkube.registry.admission.core.domain import REMOVER, Domain
from robotkube.registry.admission.loops.follower import Follower
from robotkube.registry.admission.loops.policy_reconciler import (
    CatalogueListing,
    PolicyReconciler,
    Surroundings,
    form_of_objects,
)
from robotkube.registry.evidence.adapters.dsse import TrustedKeys

GRACE_SECONDS = 5.0


@dataclass(frozen=True)
class AdmissionConfiguration:
    """The settings of the process, secrets included."""

    listen: files.Listen
    log_level: str
    forge: ForgeSettings
    webhook_secret: str
    evidence_keys: Path
    domain: Domain


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> AdmissionConfiguration:
    """Read the settings document of the process."""
    keys = ["listen", "log_level", "forge", "oci_registry", "evidence", "webhook"]
    keys += ["platform_namespace", "gate_namespace", "argocd", "agents", "test_namespaces", "remover"]
    root = reader.mapping(document, "", keys)
    evidence = reader.mapping(root.get("evidence") or {}, "evidence", ["keys"])
    webhook = reader.mapping(root.get("webhook") or {}, "webhook", ["secret"])
    return AdmissionConfiguration(
        listen=files.listen(reader, root.get("listen"), encrypts=True),
        log_level=files.log_level(reader, root.get("log_level")),
        forge=read_forge(reader, root.get("forge"), deployment=False),
        webhook_secret=files.secret(reader, webhook.get("secret"), "webhook.secret"),
        evidence_keys=Path(reader.word(evidence.get("keys"), "evidence.keys", files.PATH)),
        domain=_domain(reader, root),
    )


def _domain(reader: Reader, root: Mapping[str, Any]) -> Domain:
    registry = reader.mapping(root.get("oci_registry") or {}, "oci_registry", ["charts"])
    argocd = reader.mapping(root.get("argocd") or {}, "argocd", ["namespace"])
    return Domain(
        agents=_words(reader, root.get("agents"), "agents"),
        tests=_words(reader, root.get("test_namespaces"), "test_namespaces"),
        charts=reader.word(registry.get("charts"), "oci_registry.charts", CHARTS_URL),
        platform=reader.word(root.get("platform_namespace"), "platform_namespace", WORD),
        gate=reader.word(root.get("gate_namespace"), "gate_namespace", WORD),
        argocd=reader.word(argocd.get("namespace"), "argocd.namespace", WORD),
        remover=REMOVER if reader.truth(root.get("remover"), "remover") else "",
    )


def _words(reader: Reader, value: Any, path: str) -> tuple[str, ...]:
    items = enumerate(reader.sequence(value, path))
    return tuple(sorted(reader.word(item, f"{path}[{index}]", WORD) for index, item in items))


class AdmissionWriter:
    """The process's parts on their adapters; nothing is asked or written before `run`."""

    def __init__(self, configuration: AdmissionConfiguration, api: ApiClient, work: Path) -> None:
        work.mkdir(parents=True, exist_ok=True)
        self._configuration = configuration
        clone = configuration.forge.clone(configuration.forge.catalogue, work / "catalogue")
        listing = CatalogueListing(clone, TrustedKeys(configuration.evidence_keys))
        self.place = PolicyObjects(api, configuration.domain.platform, self._touched)
        around = Surroundings(configuration.domain, ())
        reconciler = PolicyReconciler(listing, self.place, lambda: around, ListMemory(self.place), form_of_objects)
        self.follower = Follower(reconciler, time.monotonic)
        self.server = WebServer(
            configuration.listen.address,
            configuration.listen.port,
            lambda: [*self.follower.reasons_not_ready(), *self.place.complaints()],
            MetricsPage(self.follower.metrics, self._metrics).text,
            configuration.webhook_secret.encode(),
            self._deliver,
            health_port=configuration.listen.health_port,
            certificate=configuration.listen.certificate,
        )

    def run(self, stopping: threading.Event) -> None:
        """Serve, watch and follow until `stopping` is set."""
        self.server.start()
        self.place.start()
        threading.Thread(target=self._wake_with, args=(stopping,), daemon=True).start()
        self.follower.run(stopping)
        self.place.stop()
        self.server.stop()

    def _wake_with(self, stopping: threading.Event) -> None:
        stopping.wait()
        self.follower.wake()

    def _touched(self) -> None:
        self.follower.wake()

    def _deliver(self, delivery: WebhookDelivery) -> None:
        forge = self._configuration.forge
        tip = delivery.moved_to(forge.catalogue, forge.branch)
        if tip is not None:
            self.follower.wake(tip)

    def _metrics(self) -> Sequence[Series]:
        text = "Objects that somebody else had changed or deleted, written again."
        return (Series("robotkube_admission_restored_total", "counter", text, {(): self.place.restored}),)


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Follow the catalogue until the process shall end."""
    configuration = files.start_with_settings(process, read_configuration, environment)
    trust(configuration.forge.address.authorities)
    kubeconfig = environment.get("KUBECONFIG")
    api = api_client(kubeconfig, in_cluster=kubeconfig is None)
    work = Path(environment.get("ROBOTKUBE_WORK", "/tmp/admission"))  # noqa: S108 - the pod's own volume
    writer = AdmissionWriter(configuration, api, work)
    process.log("started", **writer.server.ports, agents=len(configuration.domain.agents))
    writer.run(process.stopping)


def main() -> None:
    """Run until SIGTERM; exit codes as in `foundation.runtime.process`."""
    run("admission", body, grace_seconds=GRACE_SECONDS)


if __name__ == "__main__":
    main()
