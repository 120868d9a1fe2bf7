"""Artefacts attached to a manifest in an OCI registry, as documents (distribution specification 1.1).

An artefact is a manifest of its own with a `subject`. Registries list them by the referrers endpoint; for those without
it, they are listed in an index under a tag made of the subject's digest (the specification's fallback), which its
writers have to keep themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.charts.core.packing import MANIFEST_TYPE
from robotkube.registry.charts.core.unpacking import read_descriptor, read_json_object

INDEX_TYPE = "application/vnd.oci.image.index.v1+json"
EMPTY_TYPE = "application/vnd.oci.empty.v1+json"
EMPTY = b"{}"  # the configuration of an artefact without one
ARTEFACT_BYTES_MAX = 8 * 1024 * 1024
ATTACHED_BYTES_MAX = 32 * 1024 * 1024  # read at once: whoever may push could fill the reader's memory
ARTEFACT_MANIFEST_BYTES_MAX = 64 * 1024
ARTEFACTS_MAX = 256  # of one subject: a set per policy it was verified under
PAGES_MAX = 16  # of the registry's own list of them

Entry = Mapping[str, Any]
"""A descriptor of an artefact in the index: mediaType, digest, size, artifactType, annotations."""


def fallback_tag(subject: str) -> str:
    """The tag of the index: `sha256-<hex>`."""
    return subject.replace(":", "-")


def artefact_manifest(
    subject: str, subject_bytes: int, artifact_type: str, data: bytes, annotations: Mapping[str, str]
) -> bytes:
    """The manifest that attaches `data` to the manifest `subject`, which has that many bytes."""
    return canonical_json(
        {
            "schemaVersion": 2,
            "mediaType": MANIFEST_TYPE,
            "artifactType": artifact_type,
            "config": {"mediaType": EMPTY_TYPE, "digest": sha256(EMPTY), "size": len(EMPTY)},
            "layers": [{"mediaType": artifact_type, "digest": sha256(data), "size": len(data)}],
            "subject": {"mediaType": MANIFEST_TYPE, "digest": subject, "size": subject_bytes},
            "annotations": dict(annotations),
        }
    )


def entry_of(manifest: bytes, where: str) -> Entry:
    """The line of an artefact in the index."""
    document = read_json_object(manifest, where)
    annotations = document.get("annotations")
    return {
        "mediaType": MANIFEST_TYPE,
        "digest": sha256(manifest),
        "size": len(manifest),
        "artifactType": str(document.get("artifactType", "")),
        "annotations": dict(annotations) if isinstance(annotations, Mapping) else {},
    }


def read_index(index: bytes | None, where: str) -> list[Entry]:
    """The lines of an index in their order; none when there is no index. DocumentError when it is not one of ours."""
    if index is None:
        return []
    manifests = read_json_object(index, where).get("manifests")
    if not isinstance(manifests, list) or len(manifests) > ARTEFACTS_MAX:
        raise DocumentError(where, [f"no index of at most {ARTEFACTS_MAX} artefacts"])
    for value in manifests:
        read_descriptor(value, where, ARTEFACT_MANIFEST_BYTES_MAX)
    return manifests


def read_pages(pages: Sequence[bytes], where: str) -> list[Entry]:
    """The lines of the list that the registry keeps itself, page after page; DocumentError as for an index."""
    entries = [entry for page in pages for entry in read_index(page, where)]
    if len(entries) > ARTEFACTS_MAX:
        raise DocumentError(where, [f"more than {ARTEFACTS_MAX} artefacts are attached"])
    return entries


def extended(entries: Sequence[Entry], more: Sequence[Entry], where: str) -> bytes | None:
    """The index of `entries` and those of `more` that are missing; None when none is."""
    listed = {entry["digest"] for entry in entries}
    added = [entry for entry in more if entry["digest"] not in listed]
    if not added:
        return None
    if len(entries) + len(added) > ARTEFACTS_MAX:
        raise DocumentError(where, [f"more than {ARTEFACTS_MAX} artefacts would be attached"])
    return canonical_json({"schemaVersion": 2, "mediaType": INDEX_TYPE, "manifests": [*entries, *added]})


def read_artefact(manifest: bytes, subject: str, where: str) -> tuple[str, int, str, dict[str, str]]:
    """Digest and size of the one layer, artifact type and annotations; DocumentError unless it is attached to
    `subject`."""
    document = read_json_object(manifest, where)
    layers = document.get("layers")
    stated = document.get("subject")
    if not isinstance(stated, Mapping) or stated.get("digest") != subject:
        raise DocumentError(where, [f"it is not attached to {subject}"])
    if not isinstance(layers, list) or len(layers) != 1:
        raise DocumentError(where, ["an artefact has exactly one layer"])
    layer = read_descriptor(layers[0], where, ARTEFACT_BYTES_MAX)
    stated_annotations = document.get("annotations")
    annotations = stated_annotations if isinstance(stated_annotations, Mapping) else {}
    kind = str(document.get("artifactType") or layer.media_type)
    return layer.digest, layer.size, kind, {str(key): str(value) for key, value in annotations.items()}
