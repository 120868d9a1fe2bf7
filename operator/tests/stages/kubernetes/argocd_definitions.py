"""The kinds of Argo CD on an API server of the tests, in short or as its manifests have them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import httpx

from ci import toolchain
from tests.stages.waiting import until

DEFINITIONS = "/apis/apiextensions.k8s.io/v1/customresourcedefinitions"
KINDS = {"applications": "Application", "applicationsets": "ApplicationSet", "appprojects": "AppProject"}
Object = dict[str, Any]


def short(plural: str) -> Object:
    """A kind without Argo CD's schema: any content. The whole ones cost an API server 4 core seconds."""
    kind = KINDS[plural]
    anything = {"type": "object", "x-kubernetes-preserve-unknown-fields": True}
    version: Object = {"name": "v1alpha1", "served": True, "storage": True, "schema": {"openAPIV3Schema": anything}}
    if kind == "ApplicationSet":
        version["subresources"] = {"status": {}}
    names = {"kind": kind, "listKind": f"{kind}List", "plural": plural, "singular": kind.lower()}
    return {
        "apiVersion": "apiextensions.k8s.io/v1",
        "kind": "CustomResourceDefinition",
        "metadata": {"name": f"{plural}.argoproj.io"},
        "spec": {"group": "argoproj.io", "scope": "Namespaced", "names": names, "versions": [version]},
    }


def whole(plural: str) -> bytes:
    """A kind as in the manifests of the version that the tool chain pins."""
    folder = toolchain.module_dir("github.com/argoproj/argo-cd/v3") / "manifests" / "crds"
    return (folder / f"{KINDS[plural].lower()}-crd.yaml").read_bytes()


def define(client: httpx.Client, kinds: Sequence[str] = tuple(KINDS), schemas: bool = False) -> None:
    """Define these kinds, with their schemas or any content; the API server takes a moment to serve them."""
    for plural in kinds:
        content = whole(plural) if schemas else json.dumps(short(plural)).encode()
        answer = client.post(DEFINITIONS, content=content, headers={"Content-Type": "application/yaml"})
        assert answer.is_success, answer.text
    for plural in kinds:
        until(lambda plural=plural: client.get(f"/apis/argoproj.io/v1alpha1/{plural}").is_success, f"{plural} served")
