"""`python3 -m robotkube.entrypoints.gate`: the gate of the deployment repository.

Settings: docs/reference/settings.md. Ends with 0 on SIGTERM, 2 when the settings are wrong. The clones stand below
ROBOTKUBE_WORK (default /tmp/gate); they can be lost at any time.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.adapters.argocd import PushHook
from robotkube.adapters.git_clones import GitClone
from robotkube.adapters.gitea import GiteaForge
from robotkube.adapters.webhooks import WebServer
from robotkube.domain.documents import Reader
from robotkube.entrypoints import settings as files
from robotkube.entrypoints.processes import Process, run
from robotkube.services.gate import Gate, GateSettings, metrics_text

GRACE_SECONDS = 5.0
STOP_LOOK_SECONDS = 0.2


@dataclass(frozen=True)
class GateConfiguration:
    """Everything the process needs, secrets included."""

    listen: files.Listen
    log_level: str
    forge_url: str
    account: files.Credentials
    branch: str
    hook_url: str
    hook_secret: str
    webhook_secret: str
    gate: GateSettings


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> GateConfiguration:
    """The settings document of the gate."""
    keys = ["listen", "log_level", "forge", "registry", "hook", "webhook", "agents"]
    root = reader.mapping(document, "", keys)
    forge_keys = ["url", "credentials", "deployment", "catalogue", "branch", "proposer"]
    forge = reader.mapping(root.get("forge") or {}, "forge", forge_keys)
    registry = reader.mapping(root.get("registry") or {}, "registry", ["charts"])
    hook = reader.mapping(root.get("hook") or {}, "hook", ["url", "secret"])
    webhook = reader.mapping(root.get("webhook") or {}, "webhook", ["secret"])
    return GateConfiguration(
        listen=files.listen(reader, root.get("listen")),
        log_level=files.log_level(reader, root.get("log_level")),
        forge_url=reader.word(forge.get("url"), "forge.url", files.HTTP_URL),
        account=files.credentials(reader, forge.get("credentials"), "forge.credentials"),
        branch=reader.word(forge.get("branch"), "forge.branch", files.WORD),
        hook_url=reader.word(hook.get("url"), "hook.url", files.HTTP_URL),
        hook_secret=files.secret(reader, hook.get("secret"), "hook.secret"),
        webhook_secret=files.secret(reader, webhook.get("secret"), "webhook.secret"),
        gate=GateSettings(
            deployment=reader.word(forge.get("deployment"), "forge.deployment", files.REPOSITORY),
            catalogue=reader.word(forge.get("catalogue"), "forge.catalogue", files.REPOSITORY),
            proposer=reader.word(forge.get("proposer"), "forge.proposer", files.WORD),
            namespaces=files.agent_namespaces(reader, root.get("agents")),
            charts_url=reader.word(registry.get("charts"), "registry.charts", files.CHARTS_URL),
        ),
    )


def build_gate(found: GateConfiguration, work: Path) -> Gate:
    """The gate on its adapters; nothing is asked of the world yet."""
    url, account = found.forge_url, (found.account.username, found.account.password)
    work.mkdir(parents=True, exist_ok=True)
    return Gate(
        GiteaForge(url, found.gate.deployment, *account, branch=found.branch),
        GitClone(url, found.gate.deployment, *account, work / "deployment", branch=found.branch),
        GitClone(url, found.gate.catalogue, *account, work / "catalogue", branch=found.branch),
        PushHook(found.hook_url, found.hook_secret.encode(), f"{url}/{found.gate.deployment}", branch=found.branch),
        found.gate,
        time.monotonic,
    )


def body(process: Process, environment: Mapping[str, str] = os.environ) -> None:
    """Serve webhooks, health and metrics; run the gate's rounds on the main thread until the process shall end."""
    found = files.read_settings(files.settings_path(environment), read_configuration)
    files.send_logs(process, found.log_level)
    gate = build_gate(found, Path(environment.get("ROBOTKUBE_WORK", "/tmp/gate")))  # noqa: S108 - the pod's own volume
    server = WebServer(
        found.listen.address,
        found.listen.port,
        gate.reasons_not_ready,
        lambda: metrics_text(gate.statistics),
        found.webhook_secret.encode(),
        lambda delivery: gate.wake(delivery.event, delivery.payload),
    )
    server.start()
    process.log("started", port=server.port, namespaces=len(found.gate.namespaces))
    stopping = threading.Event()
    rounds = threading.Thread(target=gate.run, args=(stopping,), daemon=True)
    rounds.start()
    while rounds.is_alive() and not process.stopping.wait(STOP_LOOK_SECONDS):
        pass
    gate.stop(stopping)
    rounds.join(GRACE_SECONDS)
    server.stop()


if __name__ == "__main__":
    run("gate", body, grace_seconds=GRACE_SECONDS)
