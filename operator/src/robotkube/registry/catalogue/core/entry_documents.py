"""The entries of a catalogue as plain documents: what the manager's page and the command line show."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from robotkube.registry.catalogue.core.applications import Application, ChartRequirement
from robotkube.registry.catalogue.core.catalogue import NONE, VERIFIED, Catalogue
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.versions import version_key

SOURCE = "source"
UNVERIFIED = "unverified"


def entry_documents(catalogue: Catalogue, published: bool = True) -> list[dict[str, Any]]:
    """Applications by name, then charts by name and version; what is not `published` yet has the state `source`.

    An application's state is `verified` when its evidence holds now, else `unverified`."""
    applications = [_application(a, published) for _, a in sorted(catalogue.applications.items())]
    charts = [
        _chart(version, catalogue)
        for _, versions in sorted(catalogue.charts.items())
        for version in sorted(versions, key=lambda candidate: version_key(candidate.version))
    ]
    return applications + charts


def _application(application: Application, published: bool) -> dict[str, Any]:
    state = VERIFIED if application.assured else UNVERIFIED
    return {
        "kind": "application",
        "name": application.name,
        "description": application.description,
        "provides": list(application.provides),
        "needs": _distinct(_needs_of_application(application)),
        "initialFor": application.initial_for,
        "state": state if published else SOURCE,
        "digest": application.digest,
        "evidence": application.evidence or NONE,
        "assured": application.assured,
        "evidence_problem": application.evidence_problem if published and not application.assured else "",
        "parameters": dict(application.parameters),
        "services": [
            {"name": s.name, "chart": s.chart.name, "provides": s.chart.provides, "version": s.chart.version}
            | {"requirements": [str(requirement) for requirement in s.chart.requirements]}
            for s in application.services
        ],
    }


def _needs_of_application(application: Application) -> Iterable[str]:
    """Charts or what they provide, capabilities of agents, bridges."""
    for service in application.services:
        yield _chart_word(service.chart)
        yield from service.placement.capabilities
    yield from (f"link/{link.kind}" for link in application.links if link.kind != "ros")


def _chart_word(requirement: ChartRequirement) -> str:
    return requirement.name or requirement.provides


def _chart(version: ChartVersion, catalogue: Catalogue) -> dict[str, Any]:
    published = {
        "state": version.state or SOURCE,
        "digest": version.digest,
        "imageReferences": list(version.image_references),
        "evidence": catalogue.evidence_of(version),
        "policy": version.policy,
        "findings": [dict(finding) for finding in version.findings],
        "assured": version.assured,
        "evidence_problem": version.evidence_problem if version.state and catalogue.assurance != "none" else "",
    }
    return {
        "kind": "chart",
        "name": version.chart,
        "version": version.version,
        "description": version.description,
        "channel": version.channel,
        **published,
        "platforms": list(version.platforms),
        "images": list(version.images),
        "settings": version.settings,
        "provides": list(version.provides),
        "needs": _distinct(_needs_of_chart(version)),
        "replaces": version.replaces,
        "skips": list(version.skips),
        "resources": dict(version.resources),
        "guarantees": [dict(guarantee.document) for guarantee in version.guarantees],
        "success": version.success.document() if version.success else None,
        "interfaces": [dict(interface) for interface in version.interfaces],
    }


def _needs_of_chart(version: ChartVersion) -> Iterable[str]:
    """Media besides ROS, and the types it takes in where they are fixed."""
    for interface in version.interfaces:
        if interface["medium"] != "ros":
            yield str(interface["medium"])
        if interface["direction"] == "in" and "{{" not in interface.get("type", "{{"):
            yield str(interface["type"])


def _distinct(words: Iterable[str]) -> list[str]:
    return sorted(set(words))
