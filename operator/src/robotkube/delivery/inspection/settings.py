"""Settings of the inspector (docs/reference/settings.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.delivery.inspection.loops.permitted import InstalledPlatform
from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import CHARTS_URL, IMAGE, NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.forge.connect import ForgeSettings, read_forge
from robotkube.foundation.runtime import settings_file as files
from robotkube.registry.admission.core.allowed import digests_of
from robotkube.registry.admission.core.domain import Domain


@dataclass(frozen=True)
class InspectorConfiguration:
    """Everything the process needs, secrets included. `verify`: whether kubelets have to show a certificate of the
    cluster."""

    listen: files.Listen
    log_level: str
    forge: ForgeSettings
    charts_url: str
    keys: Path
    namespace: str
    installation: InstalledPlatform
    verify: bool


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> InspectorConfiguration:
    """The settings document of the inspector."""
    keys = ["listen", "log_level", "forge", "oci_registry", "evidence", "namespaces", "images", "kubelets"]
    root = reader.mapping(document, "", keys)
    registry = reader.mapping(root.get("oci_registry") or {}, "oci_registry", ["charts"])
    evidence = reader.mapping(root.get("evidence") or {}, "evidence", ["keys"])
    kubelets = reader.mapping(root.get("kubelets") or {}, "kubelets", ["verify"])
    charts_url = reader.word(registry.get("charts"), "oci_registry.charts", CHARTS_URL)
    namespaces = reader.mapping(
        root.get("namespaces") or {}, "namespaces", ["agents", "tests", "platform", "gate", "argocd", "others"]
    )
    platform = reader.word(namespaces.get("platform"), "namespaces.platform", NAME)
    return InspectorConfiguration(
        listen=files.listen(reader, root.get("listen")),
        log_level=files.log_level(reader, root.get("log_level")),
        forge=read_forge(reader, root.get("forge")),
        charts_url=charts_url,
        keys=Path(reader.word(evidence.get("keys"), "evidence.keys", files.PATH)),
        namespace=platform,
        installation=_installation(reader, namespaces, platform, charts_url, root.get("images")),
        verify=reader.truth(kubelets.get("verify"), "kubelets.verify"),
    )


def _installation(
    reader: Reader, namespaces: Mapping[str, Any], platform: str, charts_url: str, images: Any
) -> InstalledPlatform:
    references = _words(reader, images, "images", IMAGE)
    by_digest = [reference for reference in references if "@" in reference]
    try:
        domain = Domain(
            agents=_words(reader, namespaces.get("agents"), "namespaces.agents", NAME),
            tests=_words(reader, namespaces.get("tests"), "namespaces.tests", NAME),
            charts=charts_url,
            platform=platform,
            gate=reader.word(namespaces.get("gate"), "namespaces.gate", NAME),
            argocd=reader.word(namespaces.get("argocd"), "namespaces.argocd", NAME),
            elsewhere=reader.truth(namespaces.get("others"), "namespaces.others"),
        )
        return InstalledPlatform(domain, digests_of(by_digest), frozenset(references) - frozenset(by_digest))
    except InputError as error:
        reader.problems.append(str(error))
        return InstalledPlatform(Domain((), (), "oci://none.invalid/none"), ())


def _words(reader: Reader, value: Any, path: str, pattern: Any) -> tuple[str, ...]:
    items = enumerate(reader.sequence(value, path))
    return tuple(reader.word(item, f"{path}[{index}]", pattern) for index, item in items)
