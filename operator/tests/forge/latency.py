"""Times of a plan's way into main over N proposals: `python tests/forge/latency.py [N]` prints p50 and p95 in ms."""

import logging
import secrets
import sys
import tempfile
import time
from pathlib import Path

from forge_process import ForgeProcess
from installation import (
    ACCOUNTS,
    ApplicationSetController,
    Installation,
    forge_setup,
    message,
    release_files,
    start_gate,
)
from programs import free_port
from waiting import until

from robotkube.adapters.gitea_administration import GiteaAdministration
from robotkube.services.bootstrapping import Bootstrap


def main(count: int) -> None:
    """Start a forge, bootstrap it, run a gate, propose `count` times."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        process = ForgeProcess(folder / "forge")
        process.start()
        controller = ApplicationSetController()
        passwords = {account: secrets.token_hex(12) for account in ACCOUNTS}
        port = free_port()
        setup = forge_setup(passwords, f"http://127.0.0.1:{port}/webhook")
        administration = GiteaAdministration(process.url, process.administrator, process.administrator_password)
        Bootstrap(30, time.monotonic, time.sleep).forge(setup, administration)
        installation = Installation(process.url, passwords, port, folder, setup)
        gate = start_gate(installation, controller.url, folder / "gate")
        try:
            until(lambda: not gate.gate.reasons_not_ready(), "gate ready")
            report([cycle(installation, controller) for _ in range(count)])
        finally:
            gate.stop()
            controller.stop()
            process.remove()


def cycle(installation: Installation, controller: ApplicationSetController) -> dict[str, float]:
    """One proposal; seconds from the push's begin to each step."""
    manager, plan = installation.clone("manager"), installation.plan()
    commit = manager.commit(release_files(plan, f"r{installation.plans}"), message(plan), [manager.tip()])
    started = time.monotonic()
    manager.push(commit, "refs/for/main", [f"topic={plan}", "title=a plan"])
    proposed = time.monotonic()
    until(lambda: controller.announced(commit), "announced")
    announced = next(at for at, event in controller.accepted if event["after"] == commit)
    assert manager.tip() == commit
    query = {"state": "all", "sort": "recentupdate", "limit": 5}

    def marked() -> bool:
        found = installation.client("gate").get("/pulls", params=query).json()
        return any(item["head"]["sha"] == commit and item["merged"] for item in found)

    until(marked, "marked as merged")
    return {
        "proposed": proposed - started,
        "opened to announced": announced - proposed,
        "start to announced": announced - started,
        "start to marked merged": time.monotonic() - started,
    }


def report(rows: list[dict[str, float]]) -> None:
    """p50 and p95 of each column."""
    for name in rows[0]:
        values = sorted(1000 * row[name] for row in rows)
        p50, p95 = values[len(values) // 2], values[round(0.95 * (len(values) - 1))]
        print(f"{name:24s} n {len(values)} p50 {p50:5.0f} ms  p95 {p95:5.0f} ms  max {values[-1]:5.0f} ms")


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(relativeCreated)d %(name)s %(message)s")
    logging.getLogger("httpx").setLevel(logging.WARNING)
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
