"""Settings of the suite-runner (docs/reference/settings.md), read by the runner and by every suite's process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.foundation.certificates.adapters.issuing import throw_away
from robotkube.foundation.certificates.settings import read_authorities
from robotkube.foundation.documents.core.former_keys import FormerKey
from robotkube.foundation.documents.core.patterns import CHARTS_URL, HTTP_URL, IMAGE, NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file as files
from robotkube.registry.suites.loops.cluster_namespace import SuiteNamespaceSettings

TEST_NAMESPACES_MAX = 16
DOMAIN_ID_MAX = 101  # above, ports of DDS collide with those that systems give away
DATABASES = ("mongo", "ferretdb", "")
FORMER_KEYS = (FormerKey("rooms", "test_namespaces"), files.OCI_REGISTRY)


@dataclass(frozen=True)
class RunnerConfiguration:
    """Everything the process needs, secrets included; `staging`, `verified`, `images_registry` are oci://
    URLs, `authorities` a file with those that may have signed the forge's certificate besides the usual ones."""

    listen: files.Listen
    log_level: str
    forge_url: str
    account: files.Credentials
    staging: str
    verified: str
    images_registry: str
    token: str
    test_namespaces: tuple[SuiteNamespaceSettings, ...]
    observer_image: str
    verify_kubelets: bool = True
    authorities: Path | None = None


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> RunnerConfiguration:
    """The settings document of the suite-runner."""
    keys = ["listen", "log_level", "forge", "oci_registry", "token", "test_namespaces", "agent", "images", "database"]
    root = reader.mapping(document, "", [*keys, "platform_namespace"], ["kubelets", "tls"])
    forge = reader.mapping(root.get("forge") or {}, "forge", ["url", "credentials"], ["authorities"])
    oci_registry = reader.mapping(root.get("oci_registry") or {}, "oci_registry", ["staging", "verified", "images"])
    images = reader.mapping(root.get("images") or {}, "images", ["observer", "broker", "database"])
    return RunnerConfiguration(
        listen=files.listen(reader, root.get("listen"), encrypts=True),
        log_level=files.log_level(reader, root.get("log_level")),
        forge_url=reader.word(forge.get("url"), "forge.url", HTTP_URL),
        authorities=read_authorities(reader, forge, "forge"),
        account=files.credentials(reader, forge.get("credentials"), "forge.credentials"),
        staging=reader.word(oci_registry.get("staging"), "oci_registry.staging", CHARTS_URL),
        verified=reader.word(oci_registry.get("verified"), "oci_registry.verified", CHARTS_URL),
        images_registry=reader.word(oci_registry.get("images"), "oci_registry.images", CHARTS_URL),
        token=files.secret(reader, root.get("token"), "token"),
        test_namespaces=_test_namespaces(reader, root, images),
        observer_image=reader.word(images.get("observer"), "images.observer", IMAGE),
        verify_kubelets=_verify_kubelets(reader, root.get("kubelets") or {}),
    )


def _verify_kubelets(reader: Reader, value: Any) -> bool:
    verify = reader.mapping(value, "kubelets", [], ["verify"]).get("verify", True)
    if not isinstance(verify, bool):
        reader.problems.append("kubelets.verify: must be true or false")
    return verify is not False


def _test_namespaces(
    reader: Reader, root: Mapping[str, Any], images: Mapping[str, Any]
) -> tuple[SuiteNamespaceSettings, ...]:
    agent = reader.word(root.get("agent"), "agent", NAME)
    database = reader.mapping(root.get("database") or {}, "database", ["kind", "arguments"])
    kind = database.get("kind")
    if kind not in DATABASES:
        reader.problems.append("database.kind: must be mongo, ferretdb or empty")
    arguments = tuple(str(word) for word in reader.sequence(database.get("arguments"), "database.arguments"))
    tls = reader.truth(root.get("tls", False), "tls")
    items = reader.sequence(root.get("test_namespaces"), "test_namespaces")
    if len(items) > TEST_NAMESPACES_MAX:
        reader.problems.append(f"test_namespaces: more than {TEST_NAMESPACES_MAX}")
    return tuple(
        SuiteNamespaceSettings(
            *_namespace_and_domain(reader, item, f"test_namespaces[{index}]"),
            agent=agent,
            observer_image=str(images.get("observer") or ""),
            broker_image=reader.word(images.get("broker"), "images.broker", IMAGE),
            database_kind=str(kind or ""),
            database_image=reader.word(images.get("database") or None, "images.database", IMAGE, default=""),
            database_arguments=arguments,
            certify=throw_away if tls else None,
        )
        for index, item in enumerate(items[:TEST_NAMESPACES_MAX])
    )


def _namespace_and_domain(reader: Reader, value: Any, path: str) -> tuple[str, int]:
    test_namespace = reader.mapping(value, path, ["namespace", "domain_id"])
    domain_id = test_namespace.get("domain_id")
    if not isinstance(domain_id, int) or isinstance(domain_id, bool) or not 0 <= domain_id <= DOMAIN_ID_MAX:
        reader.problems.append(f"{path}.domain_id: must be a whole number from 0 to {DOMAIN_ID_MAX}")
        domain_id = 0
    return reader.word(test_namespace.get("namespace"), f"{path}.namespace", NAME), domain_id
