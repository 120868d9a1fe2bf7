"""Manifests that a publisher pushed: what is no image is refused before anything of it is used."""

from __future__ import annotations

import json
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.registry.charts.adapters.oci import read_image_manifest

PART: dict[str, Any] = {"digest": f"sha256:{'1' * 64}", "size": 5}
IMAGE: dict[str, Any] = {"config": PART, "layers": [PART]}


@pytest.mark.parametrize("document", [IMAGE, {"manifests": [PART]}, {"manifests": []}])
def test_images_and_indexes_are_read(document: dict[str, Any]) -> None:
    assert read_image_manifest(json.dumps(document).encode(), "here") == document


@pytest.mark.parametrize(
    "document",
    [
        [],
        {},
        {"layers": [PART]},
        {**IMAGE, "manifests": [PART]},
        {**IMAGE, "layers": [{"digest": PART["digest"]}]},
        {**IMAGE, "layers": [{**PART, "digest": "sha256:../../etc/passwd"}]},
        {**IMAGE, "config": {**PART, "size": -1}},
        {**IMAGE, "config": {**PART, "size": "5"}},
        {"manifests": [{"size": 5}]},
        {"manifests": PART},
    ],
)
def test_what_is_neither_or_both_or_says_no_digest_and_size_is_refused(document: Any) -> None:
    with pytest.raises(InputError, match="here: is neither the manifest of an image nor an index"):
        read_image_manifest(json.dumps(document).encode(), "here")
