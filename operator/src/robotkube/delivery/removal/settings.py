"""Settings of the remover (docs/reference/settings.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.removal.core.targets import RemovalPolicy
from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file as files

PER_MINUTE_MAX = 1000


@dataclass(frozen=True)
class RemoverConfiguration:
    """Everything the process needs; Inspections stand in `namespace`."""

    listen: files.Listen
    log_level: str
    namespace: str
    policy: RemovalPolicy


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> RemoverConfiguration:
    """The settings document of the remover."""
    keys = ["listen", "log_level", "namespace", "agents", "pods", "workloads", "per_minute"]
    root = reader.mapping(document, "", keys)
    agents = reader.sequence(root.get("agents"), "agents")
    return RemoverConfiguration(
        listen=files.listen(reader, root.get("listen")),
        log_level=files.log_level(reader, root.get("log_level")),
        namespace=reader.word(root.get("namespace"), "namespace", NAME),
        policy=RemovalPolicy(
            frozenset(reader.word(name, f"agents[{index}]", NAME) for index, name in enumerate(agents)) - {""},
            pods=reader.truth(root.get("pods"), "pods"),
            workloads=reader.truth(root.get("workloads"), "workloads"),
            per_minute=_per_minute(reader, root),
        ),
    )


def _per_minute(reader: Reader, root: Mapping[str, Any]) -> int:
    value = root.get("per_minute")
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= PER_MINUTE_MAX:
        return value
    reader.problems.append(f"per_minute: must be a whole number from 1 to {PER_MINUTE_MAX}")
    return 1
