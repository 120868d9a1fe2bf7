"""A bundle put together from what was built: images with their bills, charts with their evidence, manifests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.registry.bundles.adapters.layouts import Layout, chunks, size
from robotkube.registry.bundles.core.contents import (
    CHART,
    CONTENTS,
    CONTENTS_TYPE,
    IMAGE,
    MANIFESTS,
    MANIFESTS_TYPE,
    Attached,
    BundleContents,
    BundleItem,
    write_contents,
)
from robotkube.registry.charts.adapters.oci import read_layout
from robotkube.registry.charts.core.packing import MANIFEST_TYPE, PackedChart
from robotkube.registry.charts.core.referrers import EMPTY, EMPTY_TYPE, artefact_manifest
from robotkube.registry.evidence.core.statements import ENVELOPE_MEDIA_TYPE, attachment_annotations
from robotkube.registry.images.adapters.bills import bill_annotations
from robotkube.registry.suites.core.image_checks import BILL_TYPE

NAME = "org.opencontainers.image.ref.name"
TITLE = "org.opencontainers.image.title"


class BundleMaker:
    """A bundle under construction. `version` is the platform's, `prefix` what its charts put before images' names."""

    def __init__(self, version: str, prefix: str) -> None:
        self._version = version
        self._prefix = prefix
        self._layout = Layout()
        self._items: list[BundleItem] = []

    def add_image(self, name: str, archive: Path, bill: Path, ground: Path | None = None) -> BundleItem:
        """The image of an OCI layout archive; layers that are not in it are in that of `ground`."""
        own, digest = read_layout(archive)
        blobs = {**read_layout(ground)[0], **own} if ground else own
        document = read_json(b"".join(own[digest].chunks()))
        parts = [str(part["digest"]) for part in (document["config"], *document["layers"])]
        missing = [part for part in parts if part not in blobs]
        if missing:
            raise InputError(f"{archive}: has no blob {missing[0]}; build the images again: make images")
        self._layout.blobs |= {part: blobs[part] for part in (digest, *parts)}
        attached = self._attach(digest, BILL_TYPE, bill.read_bytes(), bill_annotations(name))
        return self._named(IMAGE, name, self._version, digest, (attached,))

    def add_chart(self, chart: PackedChart, evidence: Mapping[str, bytes]) -> BundleItem:
        """A chart; `evidence`: suite (or `summary`) -> its envelope."""
        for blob in (chart.config, chart.archive, chart.manifest):
            self._layout.add(blob)
        attached = [
            self._attach(
                chart.digest, ENVELOPE_MEDIA_TYPE, envelope, attachment_annotations(suite), f"evidence: {suite}"
            )
            for suite, envelope in sorted(evidence.items())
        ]
        return self._named(CHART, chart.name, chart.version, chart.digest, tuple(attached))

    def add_manifests(self, name: str, version: str, text: str) -> BundleItem:
        """Kubernetes objects as YAML."""
        digest = self._document(MANIFESTS_TYPE, text.encode(), f"{name}.yaml")
        return self._named(MANIFESTS, name, version, digest, ())

    def write(self, path: Path) -> BundleContents:
        """Write the bundle with the list of its contents."""
        contents = BundleContents(self._version, self._prefix, tuple(self._items))
        digest = self._document(CONTENTS_TYPE, write_contents(contents), "contents.json")
        self._layout.name(digest, CONTENTS_TYPE, **{NAME: CONTENTS})
        self._layout.write(path)
        return contents

    def _named(self, kind: str, name: str, version: str, digest: str, attached: tuple[Attached, ...]) -> BundleItem:
        manifest = read_json(b"".join(chunks(self._layout.blobs[digest])))
        parts = {digest: size(self._layout.blobs[digest])}
        parts |= {part["digest"]: part["size"] for part in (manifest["config"], *manifest["layers"])}
        item = BundleItem(kind, name, version, digest, sum(parts.values()), attached)
        self._layout.name(digest, **{NAME: f"{item.repository}:{item.tag}"})
        for one in attached:
            self._layout.name(one.digest, one.artifact_type)
        self._items.append(item)
        return item

    def _attach(
        self, subject: str, artifact_type: str, data: bytes, annotations: Mapping[str, str], title: str = ""
    ) -> Attached:
        manifest = artefact_manifest(subject, size(self._layout.blobs[subject]), artifact_type, data, annotations)
        for blob in (EMPTY, data):
            self._layout.add(blob)
        return Attached(self._layout.add(manifest), artifact_type, title or annotations[TITLE])

    def _document(self, artifact_type: str, data: bytes, title: str) -> str:
        """Add bytes as an artefact of their own; the digest of its manifest."""
        layer = {"mediaType": artifact_type, "digest": self._layout.add(data), "size": len(data)}
        config = {"mediaType": EMPTY_TYPE, "digest": self._layout.add(EMPTY), "size": len(EMPTY)}
        manifest = {
            "schemaVersion": 2,
            "mediaType": MANIFEST_TYPE,
            "artifactType": artifact_type,
            "config": config,
            "layers": [{**layer, "annotations": {TITLE: title}}],
        }
        return self._layout.add(canonical_json(manifest))
