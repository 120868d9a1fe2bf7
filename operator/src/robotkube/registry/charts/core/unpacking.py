"""A chart as a registry gives it, back to files: everything is bounded and nothing is believed but the digests.

Only what `packing` writes is accepted: plain files of one folder in a ustar archive. Links, other kinds of members,
hidden files, paths that leave the folder and archives that grow beyond a bound are refused before anything is made of
them. Argo CD lays what a hidden `.argocd-source.yaml` says over a release's values, which nobody would have checked.
"""

from __future__ import annotations

import tarfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import ARCHIVE_PART, CHART_NAME, CHART_VERSION, DIGEST
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.charts.core.packing import CHART_CONFIG_TYPE, CHART_FILE, CHART_LAYER_TYPE, PulledChart

MANIFEST_BYTES_MAX = 64 * 1024
CONFIG_BYTES_MAX = 64 * 1024
ARCHIVE_BYTES_MAX = 4 * 1024 * 1024
UNPACKED_BYTES_MAX = 16 * 1024 * 1024
FILES_MAX = 1000

_GZIP = 16 + zlib.MAX_WBITS
_TITLE = "org.opencontainers.image.title"
_VERSION = "org.opencontainers.image.version"


@dataclass(frozen=True)
class Descriptor:
    """A blob as a manifest names it; `size` in bytes."""

    media_type: str
    digest: str
    size: int


def read_json_object(data: bytes, where: str) -> dict[str, Any]:
    """The JSON object in `data`; DocumentError when it is anything else."""
    try:
        document = read_json(data.decode("utf-8"))
    except ValueError:
        raise DocumentError(where, ["not readable as JSON"]) from None
    if not isinstance(document, dict):
        raise DocumentError(where, ["must be a JSON object"])
    return document


def read_descriptor(value: Any, where: str, bytes_max: int) -> Descriptor:
    """A descriptor of at most `bytes_max` bytes; DocumentError otherwise."""
    descriptor = value if isinstance(value, Mapping) else {}
    kind, digest, size = descriptor.get("mediaType"), descriptor.get("digest"), descriptor.get("size")
    if not isinstance(kind, str) or not isinstance(digest, str) or not DIGEST.fullmatch(digest):
        raise DocumentError(where, ["a blob is not named by media type and sha256 digest"])
    if not isinstance(size, int) or isinstance(size, bool) or not 0 <= size <= bytes_max:
        raise DocumentError(where, [f"blob {digest} has {size!r} bytes; at most {bytes_max} are taken"])
    return Descriptor(kind, digest, size)


def read_chart_manifest(manifest: bytes, where: str) -> tuple[Descriptor, Descriptor]:
    """Configuration and archive of the chart in `manifest`; DocumentError when it is no chart."""
    document = read_json_object(manifest, where)
    layers = document.get("layers")
    if not isinstance(layers, list) or len(layers) != 1:
        raise DocumentError(where, ["a chart has exactly one layer"])
    config = read_descriptor(document.get("config"), where, CONFIG_BYTES_MAX)
    archive = read_descriptor(layers[0], where, ARCHIVE_BYTES_MAX)
    if (config.media_type, archive.media_type) != (CHART_CONFIG_TYPE, CHART_LAYER_TYPE):
        raise DocumentError(where, [f"no Helm chart: {config.media_type[:100]}, {archive.media_type[:100]}"])
    return config, archive


def unpack_chart(where: str, manifest: bytes, config: bytes, archive: bytes) -> PulledChart:
    """The chart whose blobs were fetched and have the digests that `manifest` names; `where` names it in errors.

    DocumentError unless configuration, Chart.yaml and the manifest's annotations say the same."""
    metadata = read_json_object(config, where)
    name, version = metadata.get("name"), metadata.get("version")
    if not CHART_NAME.fullmatch(str(name)) or not CHART_VERSION.fullmatch(str(version)):
        raise DocumentError(where, [f"name {str(name)[:64]!r}, version {str(version)[:64]!r}: no chart is called so"])
    files = _members(where, str(name), _inflated(where, archive))
    if CHART_FILE not in files:
        raise DocumentError(where, [f"{CHART_FILE} is missing"])
    try:
        own = read_mapping(files[CHART_FILE].decode("utf-8"), f"{where}: {CHART_FILE}")
    except UnicodeDecodeError:
        raise DocumentError(where, [f"{CHART_FILE} is not UTF-8"]) from None
    annotations = read_json_object(manifest, where).get("annotations")
    stated = annotations if isinstance(annotations, Mapping) else {}
    if own != metadata or (stated.get(_TITLE), stated.get(_VERSION)) != (name, version):
        raise DocumentError(where, [f"{CHART_FILE}, configuration and annotations differ; push with robotkube"])
    return PulledChart(metadata, files, manifest, archive)


def _inflated(where: str, archive: bytes) -> bytes:
    """The tar archive: one gzip member, nothing behind it, at most UNPACKED_BYTES_MAX."""
    inflating = zlib.decompressobj(_GZIP)
    try:
        data = inflating.decompress(archive, UNPACKED_BYTES_MAX + 1)
    except zlib.error:
        raise DocumentError(where, ["the archive is not readable as gzip"]) from None
    if len(data) > UNPACKED_BYTES_MAX:
        raise DocumentError(where, [f"the archive grows beyond {UNPACKED_BYTES_MAX} bytes"])
    if not inflating.eof or inflating.unused_data:
        raise DocumentError(where, ["the archive is cut off or has something behind its end"])
    return data


def _members(where: str, chart: str, data: bytes) -> dict[str, bytes]:
    """Path inside the chart -> content."""
    files: dict[str, bytes] = {}
    offset = 0
    block = tarfile.BLOCKSIZE
    while offset + block <= len(data):
        header = data[offset : offset + block]
        if not header.strip(b"\0"):
            break
        member = _member(where, header)
        offset += block
        if not 0 <= member.size <= len(data) - offset:
            raise DocumentError(where, [f"{member.name[:100]!r} is cut off"])
        path = _path(where, chart, member)
        if path in files or len(files) >= FILES_MAX:
            raise DocumentError(where, [f"{path} stands twice, or there are more than {FILES_MAX} files"])
        files[path] = data[offset : offset + member.size]
        offset += member.size + -member.size % block
    if len(data) - offset < 2 * block or data[offset:].strip(b"\0"):  # an archive ends with two empty blocks
        raise DocumentError(where, ["the archive is cut off or has something behind its end"])
    _refuse_clashes(where, files)
    return files


def _member(where: str, header: bytes) -> tarfile.TarInfo:
    try:
        member = tarfile.TarInfo.frombuf(header, "utf-8", "strict")
    except (tarfile.HeaderError, ValueError):
        raise DocumentError(where, ["the archive is not readable as tar"]) from None
    if member.type not in (tarfile.REGTYPE, tarfile.AREGTYPE):
        raise DocumentError(where, [f"{member.name[:100]!r} is no plain file; links, folders and the like are refused"])
    return member


def _path(where: str, chart: str, member: tarfile.TarInfo) -> str:
    folder, _, path = member.name.partition("/")
    parts = path.split("/")
    if folder != chart or not all(ARCHIVE_PART.fullmatch(part) and part.strip(".") for part in parts):
        raise DocumentError(where, [f"{member.name[:100]!r}: every file must be plainly below {chart}/"])
    if any(part.startswith(".") for part in parts):
        problem = "a hidden file; Argo CD takes settings from some, so leave it out of the chart"
        raise DocumentError(where, [f"{member.name!r}: {problem}"])
    return path


def _refuse_clashes(where: str, files: Mapping[str, bytes]) -> None:
    for path in files:
        parts = path.split("/")
        if any("/".join(parts[:length]) in files for length in range(1, len(parts))):
            raise DocumentError(where, [f"{path}: a file and a folder have the same name"])
