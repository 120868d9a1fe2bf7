"""Names by which pods reach Services of their cluster."""

from __future__ import annotations

OF_THE_CLUSTER = ".svc"
PORTS = {"https": 443, "http": 80}


def service_of(host: str) -> tuple[str, str] | None:
    """Namespace and name of the Service that a host of the cluster's own names stands for, with or without a port; None
    of a host elsewhere."""
    name, _, rest = host.partition(":")[0].partition(".")
    namespace, _, domain = rest.partition(".")
    return (namespace, name) if f".{domain}.".startswith(f"{OF_THE_CLUSTER}.") else None


def port_of(url: str) -> int:
    """The port of a URL, that of its scheme where it names none."""
    scheme, _, rest = url.partition("://")
    port = rest.partition("/")[0].rpartition(":")[2]
    return int(port) if port.isdecimal() else PORTS.get(scheme, 0)
