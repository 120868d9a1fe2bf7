"""Charts, entries and keys as publication tests submit them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.charts.core.packing import PackedChart, pack_chart
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys

IMAGE = "forge.invalid/robotkube/ros@sha256:" + "1" * 64
SUITES = ("static", "images", "interface", "install")
POLICY = {
    "apiVersion": "registry.robotkube.io/v1alpha1",
    "kind": "VerificationPolicy",
    "metadata": {"name": "default"},
    "spec": {"suites": [{"name": name, "version": "1", "seconds": 60} for name in SUITES]},
}
CATALOGUE = {
    "README.md": "catalogue\n",
    "policies/release.yaml": "assurance: verified\n",
    "policies/verification.yaml": write_mapping(POLICY),
}
SCHEMA = {"type": "object", "properties": {"rate": {"type": "integer"}}, "required": ["rate"]}


def specification(version: str = "0.1.0", **changes: Any) -> dict[str, Any]:
    """The spec of a chart version."""
    return {
        "version": version,
        "description": "A chart of a test",
        "channel": "stable",
        "platforms": ["linux/amd64"],
        "images": ["ros"],
        **changes,
    }


def chart(
    name: str = "relay",
    version: str = "0.1.0",
    text: str = "kind: ConfigMap\n",
    image: str = IMAGE,
    **changes: Any,
) -> tuple[PackedChart, dict[str, Any]]:
    """A packed chart and the spec of its entry; another `text` is another digest."""
    spec = specification(version, **changes)
    metadata = {"apiVersion": "v2", "name": name, "version": version}
    files = {
        "Chart.yaml": json.dumps(metadata).encode(),
        "values.yaml": b"rate: 10\n",
        "values.schema.json": json.dumps(SCHEMA).encode(),
        "templates/object.yaml": text.encode(),
        "images.yaml": f"ros: {image}\n".encode(),
    }
    return pack_chart(name, metadata, files, spec), spec


def entry_path(packed: PackedChart) -> str:
    """The path of its entry."""
    return f"charts/{packed.name}/{packed.version}.yaml"


def entry(packed: PackedChart, spec: Mapping[str, Any], **status: Any) -> str:
    """The entry as submitted."""
    return write_mapping(
        {
            "apiVersion": "registry.robotkube.io/v1alpha1",
            "kind": "ChartVersion",
            "metadata": {"name": packed.name},
            "spec": spec,
            "status": {"state": "staged", "digest": packed.digest, "images": [IMAGE], **status},
        }
    )


def application(name: str = "relaying", chart_name: str = "relay", **changes: Any) -> str:
    """An application with one service; `changes` of its spec."""
    service = {
        "name": "relay",
        "release": "relay",
        "chart": {"name": chart_name, "version": ">=0.1.0"},
        "placement": {"role": "cloud"},
        "values": {"rate": 5},
    }
    return write_mapping(
        {
            "apiVersion": "registry.robotkube.io/v1alpha1",
            "kind": "Application",
            "metadata": {"name": name},
            "spec": {
                "description": "Relays",
                "provides": ["relaying"],
                "parameters": {"type": "object", "additionalProperties": False, "properties": {}},
                "services": [service],
                **changes,
            },
        }
    )


def key(folder: Path, name: str = "gate") -> KeyFile:
    """A new signing key."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.key"
    private = Ed25519PrivateKey.generate()
    path.write_bytes(private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return KeyFile(path)


def trusted(folder: Path, *keys: KeyFile) -> TrustedKeys:
    """The keys that count."""
    folder.mkdir(parents=True, exist_ok=True)
    for one in keys:
        (folder / f"{one.key_id}.pem").write_text(one.public_key)
    return TrustedKeys(folder)
