"""The list as an object of the API, for clusters whose API server reads no files: the ConfigMap that the policies ask.

A ConfigMap is read and written as a whole, and etcd takes 1.5 MiB. Each key stands in it twice: once as itself, once
among what the API server keeps of who wrote what.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.errors import InputError
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.core.lists import parameter_words
from robotkube.registry.admission.core.policies import LIST, for_api, list_entries

COMMIT = "robotkube.io/catalogue-commit"
WRITER = "robotkube-admission"
LABELS = {
    "app.kubernetes.io/name": "admission",
    "app.kubernetes.io/component": "admission",
    "app.kubernetes.io/part-of": "robotkube",
    "app.kubernetes.io/managed-by": WRITER,
}
KEYS_CHARACTERS_MAX = 600_000  # 8,571 images, or some 3,900 charts of one image each


def list_object(namespace: str, allowed: AllowedVersions) -> dict[str, Any]:
    """The ConfigMap LIST. InputError when it would not fit: half a list would let what was verified not start."""
    data = list_entries(allowed.charts, allowed.verified)
    characters = sum(map(len, data))
    if characters > KEYS_CHARACTERS_MAX:
        raise InputError(
            f"ConfigMap {LIST}: {len(allowed.charts)} charts and {len(allowed.verified)} images need {characters} "
            f"characters, and at most {KEYS_CHARACTERS_MAX} fit: withdraw old versions, or remove their entries"
        )
    metadata: dict[str, Any] = {"name": LIST, "namespace": namespace, "labels": LABELS}
    if allowed.commit:
        metadata["annotations"] = {COMMIT: allowed.commit}
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": metadata, "data": data}


def read_list(document: Mapping[str, Any]) -> AllowedVersions:
    """The list in such a ConfigMap; what is no entry of one is left out."""
    data = document.get("data") or {}
    annotations = document["metadata"].get("annotations") or {}
    charts, images = (parameter_words(prefix, data) for prefix in ("chart", "image"))
    return AllowedVersions(charts, images, commit=str(annotations.get(COMMIT, "")))


def documents_for_api(domain: Domain, allowed: AllowedVersions) -> list[dict[str, Any]]:
    """The list, and then the policies and bindings that ask for it."""
    policies = [{**item, "metadata": {**item["metadata"], "labels": LABELS}} for item in for_api(domain)]
    return [list_object(domain.platform, allowed), *policies]
