"""Process of a bag player: `python3 -m robotkube.robots.bags` (variables: docs/reference/robot-processes.md)."""

from __future__ import annotations

import gc
import os
import time
from pathlib import Path

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer, ConfigMapData, ConfigMapWatch, split_name
from robotkube.foundation.runtime.adapters.health_server import HealthServer
from robotkube.foundation.runtime.process import PodSettings, Process, read_text, run
from robotkube.robots.bags.adapters.ledger_files import LedgerFiles
from robotkube.robots.bags.adapters.reading import open_bag
from robotkube.robots.bags.core.playback import read_player_settings, read_run
from robotkube.robots.bags.loops.player import Player
from robotkube.robots.ros.adapters.rclpy_node import RosNode

GRACE_SECONDS = 2.0
SIMULATION = "simulation"


class WallClock:
    """The machine's wall clock."""

    def now(self) -> int:
        """Time in ns since 1970."""
        return time.time_ns()

    def sleep(self, nanoseconds: int) -> None:
        """Return after that time."""
        time.sleep(nanoseconds / 1e9)


def body(process: Process) -> None:
    """Wire the adapters to the service and serve until the process shall end."""
    pod = PodSettings.from_environment()
    where = str(pod.config_file)
    settings = read_player_settings(read_mapping(read_text(pod.config_file, "the player's settings"), where), where)
    if pod.config_map is None:
        raise InputError("ROBOTKUBE_CONFIGMAP is not set; without it the player cannot find ConfigMap simulation")
    player = Player(
        network=RosNode("bag_player"),
        bag=open_bag(Path(settings.bag)),
        ledgers=LedgerFiles(Path(settings.ledger)),
        clock=WallClock(),
        log=process.log,
        stopped=process.stopping.is_set,
    )
    watch = watch_run(player, process, split_name(pod.config_map)[0])
    HealthServer(ready=lambda: watch.complaint, metrics=player.metrics, port=pod.health_port).start()
    gc.freeze()
    player.serve()


def watch_run(player: Player, process: Process, namespace: str) -> ConfigMapWatch:
    """Watch ConfigMap `simulation` of the namespace and order its runs from the player."""
    where = f"ConfigMap {namespace}/{SIMULATION}"

    def changed(data: ConfigMapData | None) -> None:
        try:
            player.order(read_run(data, where))
        except DocumentError as error:
            process.log("order refused", error=str(error))

    def failed(sentence: str) -> None:
        process.log("watch interrupted", error=sentence)

    watch = ConfigMapWatch(ApiServer.from_environment(os.environ), namespace, SIMULATION, changed, failed)
    watch.start()
    return watch


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("bag-player", body, GRACE_SECONDS)


if __name__ == "__main__":
    main()
