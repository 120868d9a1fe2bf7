"""The process of the interface suite's second pod, `robotkube-suite-observer`.

Reads /suite/config.json (variable ROBOTKUBE_SUITE_CONFIG: another file), observes the ROS network of ROS_DOMAIN_ID, the
broker of the mounted Secret when `broker` is true, and the database of `database` (its certificate is for the
`server_name` there, of the authority in database-ca.crt beside the settings). Its last line on stdout is
`{"observation": {...}}` (core/interface_observations.py). With `clear` it only empties the database; with
`load_seconds` it sends to all inputs for that long instead of observing each.
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

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.database.adapters.connection import DatabaseLogin, connect
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.runtime.process import PodSettings, Process, read_text, run
from robotkube.registry.catalogue.core.expected_topics import MQTT, TEXT, ExpectedTopic
from robotkube.registry.suites.adapters.broker_observer import PahoObserver
from robotkube.registry.suites.adapters.database_observer import PymongoCollections
from robotkube.registry.suites.core.interface_observations import Observation
from robotkube.registry.suites.loops.interface_observer import InterfaceObserver, ObserverPorts, ObserverTimeouts
from robotkube.robots.bags.core.playback import restamped
from robotkube.robots.mqtt.adapters.broker_account import read_broker_account
from robotkube.robots.mqtt.core.batches import encode_batch
from robotkube.robots.ros.adapters.message_classes import default_message, type_mismatch
from robotkube.robots.ros.adapters.rclpy_node import RosNode
from robotkube.robots.ros.core.common_messages import STAMPED_TYPES

GRACE_SECONDS = 2.0
CONFIG_FILE, DATABASE_AUTHORITY = "/suite/config.json", "database-ca.crt"
CONFIG_VARIABLE = "ROBOTKUBE_SUITE_CONFIG"
TEXT_PAYLOAD = b"{}"


class DefaultMessages:
    """Default messages of the installed types, stamped with the present time where a type has a header."""

    def __init__(self) -> None:
        self._session = int.from_bytes(os.urandom(8), "little")
        self._sequence = 0

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
        return encode_batch(self._session, self._sequence - 1, [data])

    def type_mismatch(self, type_name: str, data: bytes) -> str:
        """See the port."""
        return type_mismatch(type_name, data)


def body(process: Process) -> None:
    """Observe, and print the observation."""
    path = Path(os.environ.get(CONFIG_VARIABLE, CONFIG_FILE))
    config = read_config(read_text(path, "the observer's settings"), str(path))
    database = PymongoCollections(connect(login(config["database"], path.parent))) if config["database"] else None
    if config["clear"]:
        if database is not None:
            database.clear()
        write(Observation())
        return
    ports = ObserverPorts(
        network=RosNode(config["node"]),
        messages=DefaultMessages(),
        monotonic=time.monotonic,
        sleep=time.sleep,
        stopped=process.stopping.is_set,
        broker=broker(config["client"]) if config["broker"] else None,
        database=database,
    )
    expected = [ExpectedTopic(**topic) for topic in config["topics"]]
    bounds = ObserverTimeouts(**config["bounds"])
    process.log("observing", topics=len(expected), broker=config["broker"], database=database is not None)
    observer = InterfaceObserver(expected, ports, float(config["seconds_max"]), bounds)
    write(observer.load(float(config["load_seconds"])) if config["load_seconds"] else observer.run())


def read_config(text: str, where: str) -> Mapping[str, Any]:
    """The settings as `loops/interface.py` writes them; InputError when they are not."""
    try:
        config = read_json(text)
        for key in ("topics", "node", "client", "broker", "database", "clear", "load_seconds", "seconds_max", "bounds"):
            config[key]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{where}: is no configuration of an observer: {error!r}") from error
    return dict(config)


def login(account: Mapping[str, Any], folder: Path) -> DatabaseLogin:
    """The account of the database, and how that proves who it is."""
    values = dict(account)
    name = values.pop("server_name", "")  # a suite-runner of an earlier version says none
    tls = ServerVerification(folder / DATABASE_AUTHORITY, name) if name else None
    return DatabaseLogin(**values, tls=tls)


def broker(name: str) -> PahoObserver:
    """Connected to the broker of the mounted Secret."""
    return PahoObserver(read_broker_account(PodSettings.from_environment().broker_folder), name)


def write(observation: Observation) -> None:
    """One line on stdout."""
    document = asdict(observation)
    del document["subscriptions"]  # the broker's log has those
    sys.stdout.write(json.dumps({"observation": document}) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("suite-observer", body, GRACE_SECONDS)


if __name__ == "__main__":
    main()
