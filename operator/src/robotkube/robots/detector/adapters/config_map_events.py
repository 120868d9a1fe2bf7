"""Kubernetes Events about a detector's ConfigMap, where the author of its settings sees them."""

from __future__ import annotations

import os

from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer, config_map_warning, event_path, split_name

COMPONENT = "event-detector"


def report_refused_settings(config_map: str, sentence: str, time: int) -> None:
    """Create the warning that the settings of `config_map` (namespace/name) were refused at `time` (ns); RobotKubeError
    when the API server does not take it."""
    namespace, name = split_name(config_map)
    message = f"{sentence}; the settings before go on"
    event = config_map_warning(namespace, name, "SettingsRefused", message, COMPONENT, time_text(time))
    ApiServer.from_environment(os.environ).create(event_path(namespace), event)
