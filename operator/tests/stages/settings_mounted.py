"""A process's settings as the platform chart mounts them, on the disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

KEY_BODY = "MC4CAQAwBQYDK2VwBCIEIAABAgMEBQYHCAkKCwwNDg8QERITFBUWFxgZGhscHR4f"
KEY = f"-----BEGIN PRIVATE KEY-----\n{KEY_BODY}\n-----END PRIVATE KEY-----\n"


def mounted(rendered: Any, process: str, folder: Path) -> Path:
    """The process's volumes as files below `folder`; the path of its settings, which name them there."""
    workload = "Job" if process in {"bootstrap", "teardown"} else "Deployment"
    for volume in dict(rendered.pods)[f"{workload}/{process}"]["volumes"]:
        for source in volume.get("projected", {}).get("sources", []):
            name = source["secret"]["name"]
            data = {"key.pem": KEY} if name == "kept-gate-key" else rendered.one("Secret", name)["stringData"]
            for item in source["secret"]["items"]:
                write(folder / "secrets" / item["path"], data[item["key"]])
        if volume["name"] == "keys":
            for name, data in rendered.one("ConfigMap", "evidence-keys")["data"].items():
                write(folder / "keys" / name, data)
        if volume["name"] == "seed":
            data = rendered.one("ConfigMap", volume["configMap"]["name"])["data"]
            for item in volume["configMap"]["items"]:
                write(folder / "seed" / item["path"], data[item["key"]])
    text = rendered.one("ConfigMap", process)["data"]["config.yaml"]
    text = text.replace("/var/run/secrets/robotkube", str(folder / "secrets"))
    text = text.replace("/etc/robotkube/keys", str(folder / "keys"))
    return write(folder / "config.yaml", text.replace("/etc/robotkube/seed", str(folder / "seed")))


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path
