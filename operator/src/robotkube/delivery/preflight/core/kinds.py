"""Version and kinds of the API server, compared with what the chart asks for and renders."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from semver import Version

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem
from robotkube.delivery.preflight.core.renderings import RenderedChart, enabled, group_of
from robotkube.registry.suites.core.pod_security import mapping

AT_LEAST = re.compile(r"\s*>=\s*(\S+)\s*")
ADMISSION_API = "admissionregistration.k8s.io/v1"
ADMISSION_KIND = "ValidatingAdmissionPolicy"
BROUGHT = {
    "argoproj.io": "install Argo CD before the platform",
    "cert-manager.io": "install cert-manager before the platform, or set tls.mode: made",
}
Served = Mapping[str, frozenset[str]]
"""The kinds that are served, by `<group>/<version>`; empty for a version that is not."""


def kubernetes_version(chart: Mapping[str, Any], version: str) -> CheckVerdict:
    """The API server's version meets `kubeVersion` of the chart."""
    wanted = str(chart.get("kubeVersion", ""))
    constraint = AT_LEAST.fullmatch(wanted)
    least = read_version(constraint[1]) if constraint else None
    present = read_version(version)
    if least is None or present is None:
        return CheckVerdict("", unseen=f"{version} and the chart's kubeVersion {wanted!r} cannot be compared")
    says = f"{version}; the chart asks for {wanted}"
    if present >= least:
        return CheckVerdict(says)
    why = "Helm refuses the chart there, and kinds that it makes are missing"
    problem = Problem(f"Kubernetes {version} is older than {wanted}", "API server", why, "upgrade the control plane")
    return CheckVerdict(says, [problem])


def read_version(text: str) -> Version | None:
    """A version as Kubernetes and Helm write it, with or without `v` and a patch number; None when it is none."""
    try:
        return Version.parse(text.removeprefix("v"), optional_minor_and_patch=True)
    except ValueError:
        return None


def api_kinds(rendering: RenderedChart, settings: Mapping[str, Any], served: Served) -> CheckVerdict:
    """Every kind that the chart renders and does not define itself is served."""
    needed = {(str(item.get("apiVersion")), str(item.get("kind"))) for item in rendering.objects}
    needed -= {pair for pair in needed if (pair[0].partition("/")[0], pair[1]) in set(_defined(rendering))}
    policies = ADMISSION_KIND in served.get(ADMISSION_API, frozenset())
    if enabled(settings, "admission"):
        needed.add((ADMISSION_API, ADMISSION_KIND))
    missing = sorted(pair for pair in needed if pair[1] not in served.get(pair[0], frozenset()))
    words = "served" if policies else "not served, which admission.enabled: true would need"
    says = f"{len(needed) - len(missing)} of {len(needed)} kinds are served; {ADMISSION_KIND} v1 is {words}"
    return CheckVerdict(says, [_missing(version, kind) for version, kind in missing])


def _missing(version: str, kind: str) -> Problem:
    own = "admission.enabled: false, or a Kubernetes of 1.30 or later" if kind == ADMISSION_KIND else ""
    fix = own or BROUGHT.get(version.partition("/")[0], f"use a cluster that serves {version}")
    return Problem(
        f"kind {kind} of {version} is not served", "API server", "Helm refuses objects of unknown kinds", fix
    )


def _defined(rendering: RenderedChart) -> Iterator[tuple[str, str]]:
    for item in rendering.of_kind("CustomResourceDefinition"):
        spec = mapping(item.get("spec"))
        yield str(spec.get("group")), str(mapping(spec.get("names")).get("kind"))


def versions(rendering: RenderedChart) -> tuple[str, ...]:
    """The `<group>/<version>` that have to be asked for what they serve."""
    stated = {str(item.get("apiVersion")) for item in rendering.objects if group_of(item)}
    return tuple(sorted({*stated, "v1", ADMISSION_API}))
