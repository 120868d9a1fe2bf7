"""Files that a node's network plug-ins leave for each pod, in the form that containerd's libcni wrote on a node."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path
from typing import Any

from ci.cluster.embedded.network.pod_links import PodLink


def result(link: PodLink) -> dict[str, Any]:
    """What the plug-in `bridge` says of a pod."""
    sandbox = "/run/containerd/io.containerd.grpc.v1.cri/netns/cni-b6b5b0c4-6e39-0f29-b6ec-3ba5d01d764c"
    return {
        "kind": "cniCacheV1",
        "containerId": _sandbox(link),
        "config": "",
        "ifName": "eth0",
        "networkName": "robotkube",
        "netns": sandbox,
        "cniArgs": [
            ["K8S_POD_UID", link.uid],
            ["IgnoreUnknown", "1"],
            ["K8S_POD_NAMESPACE", link.namespace],
            ["K8S_POD_NAME", link.name],
            ["K8S_POD_INFRA_CONTAINER_ID", _sandbox(link)],
        ],
        "result": {
            "cniVersion": "1.0.0",
            "interfaces": [
                {"mac": "2a:17:e4:53:2a:7a", "name": "cni0"},
                {"mac": "16:fb:8d:56:63:82", "name": link.port},
                {"mac": "02:74:5b:53:ed:3e", "name": "eth0", "sandbox": sandbox},
            ],
            "ips": [{"address": f"{link.address}/24", "gateway": "10.245.1.1", "interface": 2}],
            "routes": [{"dst": "0.0.0.0/0"}],
        },
    }


def write_result(folder: Path, link: PodLink) -> Path:
    """Give out the address of a pod; returns the file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"robotkube-{_sandbox(link)}-eth0"
    path.write_text(json.dumps(result(link)), encoding="utf-8")
    return path


def _sandbox(link: PodLink) -> str:
    return sha256(f"{link.uid} {link.address}".encode()).hexdigest()
