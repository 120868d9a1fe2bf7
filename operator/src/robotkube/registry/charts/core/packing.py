"""Charts as reproducible OCI artifacts: the same files always give the same archive, manifest and digest.

`helm package` stamps the present time into an archive, so packing twice gives two digests; evidence and the deployment
repository name charts by digest, hence an own packing: order, times, owner, modes and the gzip header are fixed. Media
types are those of Helm's OCI support (HIP 6); "digest" always means that of the OCI manifest.
"""

from __future__ import annotations

import gzip
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.foundation.documents.core.patterns import CHART_NAME, CHART_VERSION

CHART_CONFIG_TYPE = "application/vnd.cncf.helm.config.v1+json"
CHART_LAYER_TYPE = "application/vnd.cncf.helm.chart.content.v1.tar+gzip"
MANIFEST_TYPE = "application/vnd.oci.image.manifest.v1+json"
ENTRY_ANNOTATION = "robotkube.io/entry"  # of the manifest: digest of the catalogue entry's spec
DIGEST_DIGITS = 12
CHART_FILE = "Chart.yaml"
IMAGES_FILE = "images.yaml"
PATH_BYTES_MAX = 100  # of the ustar format, which has no extended headers


@dataclass(frozen=True)
class PackedChart:
    """A chart ready to be pushed; `digest` is that of `manifest`, which names `config` and `archive` by theirs."""

    name: str
    version: str
    archive: bytes
    config: bytes
    manifest: bytes

    @property
    def digest(self) -> str:
        """`sha256:<hex>` of the OCI manifest."""
        return sha256(self.manifest)

    @property
    def tag(self) -> str:
        """The version as a registry's tag, in which `+` is not allowed (Helm writes `_`)."""
        return self.version.replace("+", "_")


@dataclass(frozen=True)
class PulledChart:
    """A chart as it came from a registry: `metadata` is Chart.yaml, `files` path inside the chart -> content,
    `manifest` the bytes whose digest names it, `archive` the tgz that it was unpacked from."""

    metadata: Mapping[str, Any]
    files: Mapping[str, bytes]
    manifest: bytes
    archive: bytes

    @property
    def digest(self) -> str:
        """`sha256:<hex>` of the OCI manifest."""
        return sha256(self.manifest)


def build_tag(version: str, digest: str) -> str:
    """The tag of a submitted build, `0.1.0_1a2b3c4d5e6f`: it follows from the content, so no tag is ever written again
    with another one (docs/decisions/0002). A registry's tag cannot have `+`; Helm writes `_` for it."""
    return f"{version.replace('+', '_')}_{digest.removeprefix('sha256:')[:DIGEST_DIGITS]}"


def entry_digest(spec: Mapping[str, Any]) -> str:
    """Digest of a ChartVersion's spec. It stands in the manifest, so that the chart's digest covers what the entry
    declares and how it is tested: verified results are looked up by that digest alone."""
    return sha256(canonical_json(spec))


def published_digest(spec: Mapping[str, Any], images: Sequence[str]) -> str:
    """Digest of what a published entry says in addition to the chart's digest: its spec and the references of its
    images."""
    return sha256(canonical_json({"spec": spec, "images": list(images)}))


def pack_chart(
    where: str,
    metadata: Mapping[str, Any],
    files: Mapping[str, bytes],
    spec: Mapping[str, Any] | None = None,
) -> PackedChart:
    """Pack `files` (path inside the chart -> content; Chart.yaml among them) of the chart that `metadata` (parsed
    Chart.yaml) describes; `spec` is that of its catalogue entry.

    `where` names the chart's place in errors. Raises DocumentError for a name, version or path that cannot be packed.
    """
    _check(where, metadata, files)
    name, version = metadata["name"], metadata["version"]
    archive = gzip.compress(_tar(name, files), compresslevel=9, mtime=0)
    config = canonical_json(metadata)
    annotations = {"org.opencontainers.image.title": name, "org.opencontainers.image.version": version}
    if spec is not None:
        annotations[ENTRY_ANNOTATION] = entry_digest(spec)
    manifest = {
        "schemaVersion": 2,
        "mediaType": MANIFEST_TYPE,
        "config": _descriptor(CHART_CONFIG_TYPE, config),
        "layers": [_descriptor(CHART_LAYER_TYPE, archive)],
        "annotations": annotations,
    }
    return PackedChart(name, version, archive, config, canonical_json(manifest))


def _check(where: str, metadata: Mapping[str, Any], files: Mapping[str, bytes]) -> None:
    problems = []
    if not CHART_NAME.fullmatch(str(metadata.get("name", ""))):
        problems.append(
            f"name: {metadata.get('name')!r} is no chart name; write lower-case letters, digits and single hyphens"
        )
    if not CHART_VERSION.fullmatch(str(metadata.get("version", ""))):
        problems.append(f"version: {metadata.get('version')!r} is no semantic version; write for example 0.1.0")
    if CHART_FILE not in files:
        problems.append(f"{CHART_FILE} is missing")
    for path in sorted(files):
        if len(f"{metadata.get('name')}/{path}".encode()) > PATH_BYTES_MAX:
            problems.append(
                f"{path}: longer than {PATH_BYTES_MAX} bytes with the chart's name; use a shorter file name"
            )
    if problems:
        raise DocumentError(where, problems)


def _tar(name: str, files: Mapping[str, bytes]) -> bytes:
    """Chart.yaml first, as Helm writes it, then by path; every file 0644, owner 0, time 0."""
    parts = []
    for path in sorted(files, key=lambda path: (path != CHART_FILE, path)):
        info = tarfile.TarInfo(f"{name}/{path}")
        info.size = len(files[path])
        info.mode = 0o644
        info.mtime = 0
        padding = -len(files[path]) % tarfile.BLOCKSIZE
        parts += [info.tobuf(tarfile.USTAR_FORMAT), files[path], b"\0" * padding]
    parts.append(b"\0" * 2 * tarfile.BLOCKSIZE)
    return b"".join(parts)


def _descriptor(media_type: str, data: bytes) -> dict[str, Any]:
    return {"mediaType": media_type, "digest": sha256(data), "size": len(data)}
