"""A process's settings as the platform chart mounts them, on the disk."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

KEY_BODY = "MC4CAQAwBQYDK2VwBCIEIAABAgMEBQYHCAkKCwwNDg8QERITFBUWFxgZGhscHR4f"
KEY = f"-----BEGIN PRIVATE KEY-----\n{KEY_BODY}\n-----END PRIVATE KEY-----\n"
PUBLIC_BODY = "MCowBQYDK2VwAyEAA6EHv/POEL4dcN0Y50vAmWfk1jCbpQ1fHdyGZBJVMbg="
PUBLIC = f"-----BEGIN PUBLIC KEY-----\n{PUBLIC_BODY}\n-----END PUBLIC KEY-----\n"
AUTHORITY = "the platform's authority"
GATE = "robotkube-gate"
JOBS = ("bootstrap", "teardown", "installation-test", "gate-key")
MADE = {"gate-public-key": {"gate-a050837d85070582.pem": PUBLIC}, "robotkube-ca": {"ca.crt": ""}}  # by processes
KEY_SECRETS = ("gate-key", "kept-gate-key")  # made by the Job, given by a person
ACCOUNTS = "broker-account"  # Secrets of accounts at the broker, into which the process puts certificates
CERTIFICATE = {"tls.crt": "a certificate", "tls.key": "its key"}  # made by the process `certificates`, or given


def pod_of(rendered: Any, process: str) -> Mapping[str, Any]:
    """The pod of a process; the Job gate-key has a hash in its name."""
    wanted = f"{'Job' if process in JOBS else 'Deployment'}/{process}"
    [pod] = [pod for name, pod in rendered.pods if re.sub("^Job/gate-key-[0-9a-f]{8}$", "Job/gate-key", name) == wanted]
    return dict(pod)


def mounted(rendered: Any, process: str, folder: Path) -> Path:
    """The process's volumes as files below `folder`; the path of its settings, which name them there."""
    namespace = GATE if process == "gate" else None
    for volume in pod_of(rendered, process)["volumes"]:
        for source in volume.get("projected", {}).get("sources", []):
            for path, text in _files(rendered, source, namespace):
                write(folder / ("keys" if volume["name"] == "keys" else "secrets") / path, text)
        if volume["name"] == "seed":
            data = rendered.one("ConfigMap", volume["configMap"]["name"])["data"]
            for item in volume["configMap"]["items"]:
                write(folder / "seed" / item["path"], data[item["key"]])
    text = rendered.one("ConfigMap", process, namespace)["data"]["config.yaml"]
    text = text.replace("/var/run/secrets/robotkube", str(folder / "secrets"))
    text = text.replace("/etc/robotkube/keys", str(folder / "keys"))
    write(folder / "authorities" / "ca.crt", AUTHORITY)
    text = text.replace("/etc/robotkube/authorities", str(folder / "authorities"))
    return write(folder / "config.yaml", text.replace("/etc/robotkube/seed", str(folder / "seed")))


def _files(rendered: Any, source: Mapping[str, Any], namespace: str | None) -> Iterator[tuple[str, str]]:
    """The files of a projected volume's source; what processes make is not in the rendering."""
    if "configMap" in source:
        name = source["configMap"]["name"]
        data = MADE[name] if name in MADE else rendered.one("ConfigMap", name, namespace)["data"]
        yield from data.items()
        return
    name = source["secret"]["name"]
    keys = [item["key"] for item in source["secret"]["items"]]
    if keys == list(CERTIFICATE):
        data = CERTIFICATE
    else:
        data = {"key.pem": KEY} if name in KEY_SECRETS else rendered.one("Secret", name, namespace)["stringData"]
        data = data | (CERTIFICATE if name.startswith(ACCOUNTS) else {})
    yield from ((item["path"], data[item["key"]]) for item in source["secret"]["items"])


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path
