"""The detector's account at the broker, read from the files of the mounted Secret `broker`."""

from __future__ import annotations

from pathlib import Path

from robotkube.errors import InputError
from robotkube.foundation.runtime.process import read_secret
from robotkube.robots.mqtt.adapters.paho_channel import BrokerAccount


def read_broker_account(folder: Path) -> BrokerAccount:
    """The account in the Secret mounted at `folder`; InputError names the file that is missing or wrong."""
    port = read_secret(folder, "port")
    if not port.isdecimal():
        raise InputError(f"{folder / 'port'}: {port!r} is no port number")
    return BrokerAccount(
        read_secret(folder, "host"), int(port), read_secret(folder, "username"), read_secret(folder, "password")
    )
