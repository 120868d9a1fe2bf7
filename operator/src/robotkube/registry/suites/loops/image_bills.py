"""Looks for the bill of materials of an image and compares it with what is in the image's layers."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.registry.charts.ports import Attachment, ImageRegistry
from robotkube.registry.suites.core import image_checks
from robotkube.registry.suites.core.bill_comparison import differences
from robotkube.registry.suites.core.image_checks import ImageReference
from robotkube.registry.suites.core.image_contents import ImageContents, contents_of
from robotkube.registry.suites.core.pod_security import items
from robotkube.registry.suites.ports.suites import LayerReader

LAYERS_MAX = 128  # as many as container runtimes can mount
LAYER_BYTES_MAX = 4 << 30  # as it is stored


class ImageBills:
    """Bills in one OCI registry; `reader` reads layers."""

    def __init__(self, oci_registry: ImageRegistry, reader: LayerReader) -> None:
        self._oci_registry = oci_registry
        self._reader = reader

    def problems(self, reference: ImageReference, manifests: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
        """What is wrong: `manifests` are those of the image by digest, one for each platform. Each needs one bill that
        is attached to it, or to the index that names it, and lists what is in it."""
        attached = {digest: self._attached(reference, digest) for digest in {reference.digest, *manifests}}
        for digest, manifest in manifests.items():
            bills = [(of, bill) for of in dict.fromkeys((digest, reference.digest)) for bill in attached[of]]
            yield from self._image_problems(reference, digest, manifest, bills)

    def _attached(self, reference: ImageReference, digest: str) -> list[Attachment]:
        attachments = self._oci_registry.attachments(reference.repository, digest)
        return [attachment for attachment in attachments if attachment.artifact_type == image_checks.BILL_TYPE]

    def _image_problems(
        self,
        reference: ImageReference,
        digest: str,
        manifest: Mapping[str, Any],
        bills: Sequence[tuple[str, Attachment]],
    ) -> list[str]:
        """The problems of an image's bills, none when one is in order; the image is only read when one describes it."""
        name = str(ImageReference(reference.host, reference.repository, digest))
        problems = []
        try:
            for of, attachment in bills:
                wrong = list(image_checks.bill_problems(attachment.data, of))
                wrong = wrong or list(differences(read_json(attachment.data), self._contents(reference, manifest)))
                if not wrong:
                    return []
                problems += [f"{name}: the attached bill {problem}" for problem in wrong]
        except InputError as error:
            return [f"{name}: cannot be compared with its bill: {error}"]
        return problems or [f"{name}: no software bill of materials is attached to this digest"]

    def _contents(self, reference: ImageReference, manifest: Mapping[str, Any]) -> ImageContents:
        layers = items(manifest.get("layers"))
        if len(layers) > LAYERS_MAX:
            raise InputError(f"{len(layers)} layers; at most {LAYERS_MAX} are read")
        return contents_of(
            self._reader.contents(digest, functools.partial(self._pieces, reference.repository, digest))
            for digest in (str(layer.get("digest")) for layer in layers)
        )

    def _pieces(self, repository: str, digest: str) -> Iterator[bytes]:
        return self._oci_registry.blob_pieces(repository, digest, LAYER_BYTES_MAX)
