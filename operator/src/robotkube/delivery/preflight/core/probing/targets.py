"""What a probe is about, taken from the chart as it is rendered with the values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.delivery.preflight.core.probing.objects import ProbeTarget
from robotkube.delivery.preflight.core.renderings import RenderedChart, name_of
from robotkube.errors import InputError
from robotkube.foundation.kubernetes.core.service_names import service_of
from robotkube.registry.suites.core.pod_security import items, mapping


def probe_target(rendering: RenderedChart, settings: Mapping[str, Any], namespace: str, installed: bool) -> ProbeTarget:
    """The platform's image, the API server's name, and the broker with its name, where it is there: a broker of the
    chart's own is from the installation on. InputError when the chart renders no image."""
    image = _image(rendering)
    if not image:
        raise InputError("the chart renders no gate, whose image the probe's pods run")
    names = [f"kubernetes.default.svc.{settings.get('clusterDomain') or 'cluster.local'}"]
    host, port = _broker(rendering)
    if not host or (service_of(host) and not installed):
        return ProbeTarget(namespace, image, names, ("", 0))
    return ProbeTarget(namespace, image, [*names, host], (host, port))


def _image(rendering: RenderedChart) -> str:
    """The platform's image, which has the probe's program."""
    workload = next((one for one in rendering.workloads if one.name == "gate"), None)
    containers = items(mapping(mapping(workload.template if workload else {}).get("spec")).get("containers"))
    return str(containers[0].get("image", "")) if containers else ""


def _broker(rendering: RenderedChart) -> tuple[str, int]:
    """Host and port of the broker, as agents are told them."""
    for item in rendering.of_kind("Secret"):
        account = mapping(item.get("stringData"))
        if name_of(item) == "broker-account" and str(account.get("port", "")).isdecimal():
            return str(account.get("host", "")), int(str(account["port"]))
    return "", 0
