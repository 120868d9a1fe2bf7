"""The file registries.yaml, by which the Nodes of a k3s find images of application charts in another registry than
their names say. Pure."""

from __future__ import annotations

from typing import Any

import yaml

from ci.images.built import REPOSITORY
from robotkube.registry.bundles.core.places import RegistryPlace

FILE = "/etc/rancher/k3s/registries.yaml"  # of each Node
AUTHORITY = "/etc/rancher/k3s/robotkube-registry-ca.pem"
HEAD = """\
# For {file} of each Node. k3s reads it when it starts: systemctl restart k3s, or k3s-agent.
# Where there is such a file already, add the entries below to it.
# Where {host} asks for an account, give it below configs: {host}: {{auth: {{username: ..., password: ...}}}}
"""


def registries(place: RegistryPlace, with_authority: bool) -> str:
    """The text for a registry that has what a bundle has. `with_authority`: who signed its certificate is none of the
    usual ones, and stands on each Node in the file AUTHORITY."""
    host, _, path = REPOSITORY.partition("/")
    mirror = {"endpoint": [f"https://{place.host}"], "rewrite": {f"^{path}/(.*)": f"{place.path}/$1"}}
    document: dict[str, Any] = {"mirrors": {host: mirror}}
    if with_authority:
        document["configs"] = {place.host: {"tls": {"ca_file": AUTHORITY}}}
    return HEAD.format(file=FILE, host=place.host) + yaml.safe_dump(document, sort_keys=False)
