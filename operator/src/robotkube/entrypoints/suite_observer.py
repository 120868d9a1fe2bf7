"""Process of the interface suite's second pod: `python3 -m robotkube.entrypoints.suite_observer`.

Reads /suite/config.json (variable ROBOTKUBE_SUITE_CONFIG: another file), looks at the ROS network of ROS_DOMAIN_ID, at
the broker of the mounted Secret when `broker` is true, and at the database of `database`. Its last line on stdout is
`{"observation": {...}}` (domain/interface_checks.py). With `clear` it only empties the database.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from robotkube.adapters.mongodb_pymongo import Account, PymongoCollections, connect
from robotkube.adapters.mqtt_observing import PahoObserver
from robotkube.adapters.ros_messages import default_message, misfit
from robotkube.adapters.ros_rclpy import RosNode
from robotkube.domain.bags import restamped
from robotkube.domain.errors import InputError
from robotkube.domain.frames import encode_frame
from robotkube.domain.interface_checks import Observation
from robotkube.domain.interfaces import MQTT, TEXT, ExpectedTopic
from robotkube.domain.messages import STAMPED_TYPES
from robotkube.entrypoints.processes import PodSettings, Process, read_secret, read_text, run
from robotkube.services.suite_observing import Bounds, InterfaceObserver, World

GRACE_SECONDS = 2.0
CONFIG_FILE = "/suite/config.json"
CONFIG_VARIABLE = "ROBOTKUBE_SUITE_CONFIG"
TEXT_PAYLOAD = b"{}"


class DefaultMessages:
    """Default messages of the installed types, stamped with the present time where a type has a header."""

    def __init__(self) -> None:
        self._session, self._sequence = int.from_bytes(os.urandom(8), "little"), 0

    def payload(self, topic: ExpectedTopic) -> bytes:
        """See the port."""
        if topic.medium == MQTT and topic.encoding == TEXT:
            return TEXT_PAYLOAD
        data = default_message(topic.type) if topic.type else b"\0\1\0\0"
        if topic.type in STAMPED_TYPES:
            data = restamped(data, time.time_ns())
        if topic.medium != MQTT:
            return data
        self._sequence += 1
        return encode_frame(self._session, self._sequence - 1, [data])

    def misfit(self, type_name: str, data: bytes) -> str:
        """See the port."""
        return misfit(type_name, data)


def body(process: Process) -> None:
    """Look, and print what was seen."""
    path = Path(os.environ.get(CONFIG_VARIABLE, CONFIG_FILE))
    config = read_config(read_text(path, "the observer's settings"), str(path))
    database = PymongoCollections(connect(Account(**config["database"]))) if config["database"] else None
    if config["clear"]:
        if database is not None:
            database.clear()
        write(Observation())
        return
    world = World(
        network=RosNode(config["node"]),
        messages=DefaultMessages(),
        monotonic=time.monotonic,
        sleep=time.sleep,
        stopped=process.stopping.is_set,
        broker=broker(config["client"]) if config["broker"] else None,
        database=database,
    )
    expected = [ExpectedTopic(**topic) for topic in config["topics"]]
    bounds = Bounds(**config["bounds"])
    process.log("looking", topics=len(expected), broker=config["broker"], database=database is not None)
    write(InterfaceObserver(expected, world, float(config["seconds_max"]), bounds).run())


def read_config(text: str, where: str) -> Mapping[str, Any]:
    """The settings as `services.suite_interface` writes them; InputError when they are not."""
    try:
        config = json.loads(text)
        for key in ("topics", "node", "client", "broker", "database", "clear", "seconds_max", "bounds"):
            config[key]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{where}: is no configuration of an observer: {error!r}") from error
    return dict(config)


def broker(client_id: str) -> PahoObserver:
    """Connected to the broker of the mounted Secret."""
    folder = PodSettings.from_environment().broker_folder
    host, port, username, password = (read_secret(folder, key) for key in ("host", "port", "username", "password"))
    return PahoObserver(host, int(port), username, password, client_id)


def write(observation: Observation) -> None:
    """One line on stdout."""
    document = asdict(observation)
    del document["subscriptions"]  # the broker's log tells those
    sys.stdout.write(json.dumps({"observation": document}) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    run("suite-observer", body, GRACE_SECONDS)
