"""Settings of the suite-runner (docs/reference/settings.md), read by the runner and by every suite's process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.patterns import CHARTS_URL, HTTP_URL, IMAGE, NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file as files
from robotkube.registry.suites.loops.test_namespace import SuiteNamespaceSettings

ROOMS_MAX = 16
DOMAIN_ID_MAX = 101  # above, ports of DDS collide with those that systems give away
DATABASES = ("mongo", "ferretdb", "")


@dataclass(frozen=True)
class RunnerConfiguration:
    """Everything the process needs, secrets included; `staging`, `verified`, `images_registry` are oci:// URLs."""

    listen: files.Listen
    log_level: str
    forge_url: str
    account: files.Credentials
    staging: str
    verified: str
    images_registry: str
    token: str
    rooms: tuple[SuiteNamespaceSettings, ...]
    observer_image: str


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> RunnerConfiguration:
    """The settings document of the suite-runner."""
    keys = ["listen", "log_level", "forge", "registry", "token", "rooms", "agent", "images", "database"]
    root = reader.mapping(document, "", [*keys, "platform_namespace"])
    forge = reader.mapping(root.get("forge") or {}, "forge", ["url", "credentials"])
    registry = reader.mapping(root.get("registry") or {}, "registry", ["staging", "verified", "images"])
    images = reader.mapping(root.get("images") or {}, "images", ["observer", "broker", "database"])
    return RunnerConfiguration(
        listen=files.listen(reader, root.get("listen")),
        log_level=files.log_level(reader, root.get("log_level")),
        forge_url=reader.word(forge.get("url"), "forge.url", HTTP_URL),
        account=files.credentials(reader, forge.get("credentials"), "forge.credentials"),
        staging=reader.word(registry.get("staging"), "registry.staging", CHARTS_URL),
        verified=reader.word(registry.get("verified"), "registry.verified", CHARTS_URL),
        images_registry=reader.word(registry.get("images"), "registry.images", CHARTS_URL),
        token=files.secret(reader, root.get("token"), "token"),
        rooms=_rooms(reader, root, images),
        observer_image=reader.word(images.get("observer"), "images.observer", IMAGE),
    )


def _rooms(reader: Reader, root: Mapping[str, Any], images: Mapping[str, Any]) -> tuple[SuiteNamespaceSettings, ...]:
    agent = reader.word(root.get("agent"), "agent", NAME)
    database = reader.mapping(root.get("database") or {}, "database", ["kind", "arguments"])
    kind = database.get("kind")
    if kind not in DATABASES:
        reader.problems.append("database.kind: must be mongo, ferretdb or empty")
    arguments = tuple(str(word) for word in reader.sequence(database.get("arguments"), "database.arguments"))
    items = reader.sequence(root.get("rooms"), "rooms")
    if len(items) > ROOMS_MAX:
        reader.problems.append(f"rooms: more than {ROOMS_MAX}")
    return tuple(
        SuiteNamespaceSettings(
            *_room(reader, item, f"rooms[{index}]"),
            agent=agent,
            observer_image=str(images.get("observer") or ""),
            broker_image=reader.word(images.get("broker"), "images.broker", IMAGE),
            database_kind=str(kind or ""),
            database_image=reader.word(images.get("database") or None, "images.database", IMAGE, default=""),
            database_arguments=arguments,
        )
        for index, item in enumerate(items[:ROOMS_MAX])
    )


def _room(reader: Reader, value: Any, path: str) -> tuple[str, int]:
    room = reader.mapping(value, path, ["namespace", "domain_id"])
    domain_id = room.get("domain_id")
    if not isinstance(domain_id, int) or isinstance(domain_id, bool) or not 0 <= domain_id <= DOMAIN_ID_MAX:
        reader.problems.append(f"{path}.domain_id: must be a whole number from 0 to {DOMAIN_ID_MAX}")
        domain_id = 0
    return reader.word(room.get("namespace"), f"{path}.namespace", NAME), domain_id
