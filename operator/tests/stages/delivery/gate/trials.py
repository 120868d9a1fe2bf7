"""A catalogue with one chart whose objects follow from its values, and trials of applications that use it."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.delivery.gate.loops.application_trials import CompositionTrials
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader
from robotkube.registry.charts.core.references import ChartReference
from tests.stages.registry.signed_evidence import artefact, entry, signing_key, trusting
from tests.stages.registry.submissions import CATALOGUE

IMAGE = "forge.invalid/robotkube/ros@sha256:" + "1" * 64
FOREIGN = "docker.io/library/busybox@sha256:" + "2" * 64
SCHEMA = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "rate": {"type": "integer", "maximum": 1000},
        "image": {"type": "string"},
        "pod": {"type": "object"},
        "container": {"type": "object"},
        "metadata": {"type": "object"},
        "kind": {"type": "string"},
        "broken": {"type": "boolean"},
        "away": {"type": "boolean"},
        "placement": {"type": "object"},
        "global": {"type": "object"},
    },
}
PROBE = {"exec": {"command": ["true"]}}
RESOURCES = {"requests": {"cpu": "10m", "memory": "10Mi"}, "limits": {"memory": "20Mi"}}
CONFINED = {"allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}}
USER = {"runAsNonRoot": True, "runAsUser": 10001, "seccompProfile": {"type": "RuntimeDefault"}}


def relay(version: str = "0.1.0", **schema: Any) -> dict[str, str]:
    """A submitted version of the chart `relay` (path -> text), with `schema` changed."""
    about = artefact("relay", version)
    return {
        **entry(about, "staged", images=(IMAGE,)),
        f"charts/relay/{version}.schema.json": json.dumps({**SCHEMA, "default": {}, **schema}),
    }


def reference(version: str = "0.1.0") -> ChartReference:
    """The version as `relay` writes it."""
    about = artefact("relay", version)
    return ChartReference("relay", version, about.digest)


def application(
    properties: Mapping[str, Any] | None = None, values: Mapping[str, Any] | None = None, **changes: Any
) -> dict[str, str]:
    """The application `relaying` with one service (path -> text); `changes` of its spec."""
    service = {
        "name": "relay",
        "release": "relay",
        "chart": {"name": "relay", "version": ">=0.1.0"},
        "placement": {"role": "cloud"},
        "values": values or {},
    }
    spec = {
        "description": "Relays",
        "provides": ["relaying"],
        "parameters": {"type": "object", "additionalProperties": False, "properties": properties or {}},
        "services": [service],
        **changes,
    }
    head = {"apiVersion": "registry.robotkube.io/v1alpha1", "kind": "Application", "metadata": {"name": "relaying"}}
    return {"applications/relaying.yaml": write_mapping({**head, "spec": spec})}


def catalogue(*parts: Mapping[str, str]) -> dict[str, str]:
    """The files of a catalogue whose policy asks for the static suite among others."""
    files = dict(CATALOGUE)
    for part in parts or (relay(), application()):
        files |= part
    return files


def objects(
    chart: ChartReference, values: Mapping[str, Any], plan: str, release: str, namespace: str
) -> Sequence[Mapping[str, Any]]:
    """One Deployment that meets the static suite but for what the values say."""
    if values.get("broken"):
        raise InputError("the chart cannot be rendered: no such template")
    if values.get("away"):
        raise UnavailableError("the OCI registry is away")
    agent = values["placement"]["agent"]
    labels = {"app.kubernetes.io/name": chart.name, "app.kubernetes.io/instance": release, "robotkube.io/agent": agent}
    container = {"name": "relay", "image": values.get("image", IMAGE), "resources": RESOURCES}
    container |= {"startupProbe": PROBE, "readinessProbe": PROBE, "livenessProbe": PROBE}
    pod = {"serviceAccountName": "application", "nodeSelector": {"robotkube.io/agent": agent}, "securityContext": USER}
    pod |= {"containers": [{**container, "securityContext": CONFINED, **values.get("container", {})}]}
    template = {"metadata": {"labels": labels}, "spec": {**pod, **values.get("pod", {})}}
    return [
        {
            "apiVersion": "apps/v1",
            "kind": values.get("kind", "Deployment"),
            "metadata": {"name": release, "labels": labels, **values.get("metadata", {})},
            "spec": {"template": template},
        }
    ]


def trials(
    folder: Path, made: Callable[..., Any] = objects, seconds_each: float = 0.0, check: Callable[..., Any] = validate
) -> CompositionTrials:
    """Trials as the gate has them; every look at the clock takes `seconds_each`."""
    keys = trusting(folder / "keys", signing_key(folder / "key"))
    ticks = itertools.count()
    return CompositionTrials(
        EvidenceReader(keys), Jinja2Templates().render, check, made, lambda: next(ticks) * seconds_each
    )
