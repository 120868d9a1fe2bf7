"""The settings of the processes that make and keep rights (docs/reference/settings.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.deployment.core.policies.agents import read_declared
from robotkube.delivery.rights.core.accounts import EVERYBODY, Accounts, AgentAccount, ManagerAccount
from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.forge.connect import ForgeSettings, read_forge
from robotkube.foundation.runtime import settings_file as files
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.broker_settings import read_broker

ACCOUNT_KEYS = ("agents", "managers")
_SCOPED = re.compile(f"{NAME.pattern}|{re.escape(EVERYBODY)}")


@dataclass(frozen=True)
class RightsConfiguration:
    """The settings of the process that keeps rights, secrets included."""

    listen: files.Listen
    log_level: str
    forge: ForgeSettings
    webhook_secret: str
    broker: BrokerAccount
    accounts: Accounts


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> RightsConfiguration:
    """Read the settings document of the process."""
    root = reader.mapping(document, "", ["listen", "log_level", "forge", "webhook", "broker", *ACCOUNT_KEYS])
    webhook = reader.mapping(root.get("webhook") or {}, "webhook", ["secret"])
    return RightsConfiguration(
        listen=files.listen(reader, root.get("listen"), encrypts=True),
        log_level=files.log_level(reader, root.get("log_level")),
        forge=read_forge(reader, root.get("forge"), catalogue=False),
        webhook_secret=files.secret(reader, webhook.get("secret"), "webhook.secret"),
        broker=read_broker(reader, root.get("broker")),
        accounts=read_accounts(reader, root),
    )


def read_accounts(reader: Reader, root: Mapping[str, Any]) -> Accounts:
    """The keys `agents` and `managers`."""
    agents = [
        AgentAccount(*read_declared(reader, item, f"agents[{i}]"))
        for i, item in enumerate(reader.sequence(root.get("agents"), "agents"))
    ]
    items = enumerate(reader.sequence(root.get("managers"), "managers"))
    return Accounts(tuple(agents), tuple(_manager(reader, item, f"managers[{i}]") for i, item in items))


def _manager(reader: Reader, value: Any, path: str) -> ManagerAccount:
    manager = reader.mapping(value, path, ["name", "agents"])
    names = enumerate(reader.sequence(manager.get("agents"), f"{path}.agents"))
    agents = tuple(reader.text(name, f"{path}.agents[{index}]", _SCOPED) for index, name in names)
    return ManagerAccount(reader.text(manager.get("name"), f"{path}.name", NAME), agents)
