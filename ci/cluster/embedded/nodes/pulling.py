"""From where every node pulls images that were not imported: the platform's OCI registry, which references name by a
Service that nodes cannot resolve.

    <cluster>/certs.d/<host>_<port>_/hosts.toml    read at each pull, so it may come and change while nodes run
    <cluster>/certs.d/<host>_<port>_/ca.crt        who may have signed the registry's certificate, where it speaks TLS
"""

from __future__ import annotations

import base64
from pathlib import Path

REGISTRY = "forge.robotkube.svc.cluster.local:3000"  # as charts/robotkube has it
AUTHORITIES = "ca.crt"


def allow(folder: Path, url: str, username: str, password: str, authorities: str = "", host: str = REGISTRY) -> Path:
    """Have images of `host` pulled from the OCI registry at `url` with this account; `folder` is that of all hosts,
    `authorities` (PEM) are who may have signed its certificate. The file that says so, which only root can read."""
    place = folder / host_folder(host)
    place.mkdir(parents=True, exist_ok=True)
    part, path = place / ".part", place / "hosts.toml"
    if authorities:
        (place / AUTHORITIES).write_text(authorities, encoding="ascii")
    part.touch(mode=0o600)
    part.write_text(hosts_toml(url, username, password, bool(authorities)), encoding="utf-8")
    part.replace(path)
    return path


def host_folder(host: str) -> str:
    """The folder of a host as containerd names it: `host:3000` is `host_3000_`."""
    name, colon, port = host.partition(":")
    return f"{name}_{port}_" if colon else name


def hosts_toml(url: str, username: str, password: str, verified: bool = False) -> str:
    """What containerd reads: pull only, with basic authentication; `verified` by the authorities beside it."""
    account = base64.b64encode(f"{username}:{password}".encode()).decode()
    ca = f'ca = "{AUTHORITIES}"\n' if verified else ""
    return f"""server = "{url}"
[host."{url}"]
capabilities = ["pull", "resolve"]
{ca}[host."{url}".header]
Authorization = ["Basic {account}"]
"""
