"""Archives of images (OCI layout in a tar) as buildah and docker write them, made in memory."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Sequence
from pathlib import Path

from tests.stages.registry.made_layers import digest_of

LABELS = {"org.opencontainers.image.title": "own", "org.opencontainers.image.version": "0.2.0"}
SETTINGS = {"User": "10001:10001", "Entrypoint": ["/usr/bin/tool"], "Labels": LABELS}


def write_archive(path: Path, layers: Sequence[bytes]) -> str:
    """Write an image of these layers, as they are stored; its digest."""
    files: dict[str, bytes] = {"oci-layout": b'{"imageLayoutVersion": "1.0.0"}'}

    def put(data: bytes, kind: str) -> dict[str, object]:
        files["blobs/" + digest_of(data).replace(":", "/")] = data
        return {"mediaType": f"application/vnd.oci.image.{kind}", "digest": digest_of(data), "size": len(data)}

    config = {"os": "linux", "architecture": "amd64", "config": SETTINGS, "rootfs": {"type": "layers", "diff_ids": []}}
    manifest = {
        "schemaVersion": 2,
        "mediaType": "application/vnd.oci.image.manifest.v1+json",
        "config": put(json.dumps(config).encode(), "config.v1+json"),
        "layers": [put(layer, "layer.v1.tar+gzip") for layer in layers],
    }
    described = put(json.dumps(manifest).encode(), "manifest.v1+json")
    files["index.json"] = json.dumps({"schemaVersion": 2, "manifests": [described]}).encode()
    with tarfile.open(path, "w") as tar:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return str(described["digest"])
