"""The objects of a test namespace: the chart's own, moved into it, and the helper pods that run there.

A chart's objects are changed only so: namespace, ROS_DOMAIN_ID on every container, and the label robotkube.io/suite
(on the object and on its pods), which separates the chart's objects from the helpers'.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.certificates.core.lives import Issued, Pair
from robotkube.foundation.documents.core.patterns import NAME

LABEL = "robotkube.io/suite"
SUBJECT, HELPER = "subject", "helper"
AGENT_LABEL = "robotkube.io/agent"
PEER = {"robotkube.io/peer": "true"}  # of all pods: by it the namespace's Service has their addresses (ros-peers)
HELPER_PREFIX = "suite-"  # names of helpers' objects; a chart's object of such a name is refused
DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
OBJECTS_MAX = 50
FILES_BYTES_MAX = 900 * 1024
FILES_FOLDER = "/suite"
SCRATCH_VOLUME_CLAIM = "scratch"
SCRATCH_FOLDER = "/var/lib/robotkube/scratch"
ACCOUNT_FOLDER = "/var/run/secrets/robotkube/broker"
BROKER_SECRET, DATABASE_SECRET = "broker-account", "database-account"
AUTHORITIES, AUTHORITY_FILE = "robotkube-ca", "ca.crt"
SUITE_DATABASE = "recordings_suite"
KINDS: Mapping[str, tuple[str, str]] = {
    "ConfigMap": ("v1", "/api/v1/namespaces/{}/configmaps"),
    "Deployment": ("apps/v1", "/apis/apps/v1/namespaces/{}/deployments"),
}
MQTT_PORT, MQTT_TLS_PORT, DATABASE_PORT, DATABASE_TLS_PORT = 1883, 8883, 27017, 27018
USER = 10001
TEMPORARY = "/tmp"  # noqa: S108 - a volume of the pod's own
KEY_BYTES = 64
HASH_ROUNDS = 101

_SANDBOX = {
    "allowPrivilegeEscalation": False,
    "readOnlyRootFilesystem": True,
    "capabilities": {"drop": ["ALL"]},
}
_POD = {
    "runAsNonRoot": True,
    "runAsUser": USER,
    "runAsGroup": USER,
    "fsGroup": USER,
    "fsGroupChangePolicy": "OnRootMismatch",
    "seccompProfile": {"type": "RuntimeDefault"},
}


@dataclass(frozen=True)
class HelperPod:
    """A helper pod of a test namespace, on its node, Pod Security restricted, without a token."""

    name: str
    image: str
    agent: str
    domain_id: int
    command: Sequence[str] = ()
    environment: Sequence[Mapping[str, Any]] = ()
    volumes: Sequence[Mapping[str, Any]] = ()
    mounts: Sequence[Mapping[str, Any]] = ()
    port: int = 0
    seconds: int = 0
    memory: str = "512Mi"
    arguments: Sequence[str] = field(default=())

    def document(self) -> dict[str, Any]:
        """The pod; with a `port` it is ready when it takes connections, with `seconds` it is ended after them."""
        container: dict[str, Any] = {
            "name": self.name,
            "image": self.image,
            "imagePullPolicy": "IfNotPresent",
            "env": [*_variables(HOME=TEMPORARY, ROS_LOG_DIR=f"{TEMPORARY}/ros"), *self.environment],
            "resources": {"requests": {"cpu": "20m", "memory": "32Mi"}, "limits": {"cpu": "1", "memory": self.memory}},
            "securityContext": _SANDBOX,
            "volumeMounts": [{"name": "tmp", "mountPath": TEMPORARY}, *self.mounts],
        }
        container["env"] += _variables(**{DOMAIN_VARIABLE: str(self.domain_id)})
        if self.command:
            container["command"] = list(self.command)
        if self.arguments:
            container["args"] = list(self.arguments)
        if self.port:
            probe = {"tcpSocket": {"port": self.port}, "periodSeconds": 1}
            container |= {"startupProbe": {**probe, "failureThreshold": 120}, "readinessProbe": probe}
        return {"apiVersion": "v1", "kind": "Pod", "metadata": own_metadata(self.name), "spec": self._spec(container)}

    def _spec(self, container: Mapping[str, Any]) -> dict[str, Any]:
        spec: dict[str, Any] = {
            "restartPolicy": "Never",
            "automountServiceAccountToken": False,
            "enableServiceLinks": False,
            "terminationGracePeriodSeconds": 2,
            "nodeSelector": {AGENT_LABEL: self.agent},
            "securityContext": dict(_POD),
            "containers": [container],
            "volumes": [{"name": "tmp", "emptyDir": {"sizeLimit": "64Mi"}}, *self.volumes],
        }
        if self.seconds:
            spec["activeDeadlineSeconds"] = self.seconds
        return spec


def _variables(**values: str) -> list[dict[str, str]]:
    return [{"name": name, "value": value} for name, value in values.items()]


def own_metadata(name: str) -> dict[str, Any]:
    """Metadata of helpers' objects."""
    return {"name": name, "labels": {LABEL: HELPER, **PEER}}


def placed(item: Mapping[str, Any], namespace: str, domain_id: int, agent: str) -> dict[str, Any]:
    """A chart's object in the test namespace. InputError for kinds and names that are not allowed there, and for pods
    that would run elsewhere than on the node of `agent`."""
    kind = str(item.get("kind"))
    metadata = dict(item.get("metadata") or {})
    name = str(metadata.get("name", ""))
    if kind not in KINDS or item.get("apiVersion") != KINDS[kind][0]:
        raise InputError(
            f"{kind} {name} ({item.get('apiVersion')}): a chart may hold Deployment (apps/v1) and ConfigMap (v1) only"
        )
    refuse_name(kind, name)
    _refuse_holds(kind, name, metadata)
    if metadata.get("namespace") not in (None, "", namespace):
        raise InputError(f"{kind} {name}: namespace {metadata['namespace']!r}: leave it out, it is the release's")
    document = {**item, "metadata": _labelled({**metadata, "namespace": namespace})}
    if kind == "Deployment":
        document["spec"] = _deployment(name, item.get("spec"), domain_id)
        _refuse_places(name, document["spec"]["template"]["spec"], agent)
    return document


def refuse_name(kind: str, name: str) -> None:
    """InputError when an object of a chart, or of its test set, may not have this name."""
    if not NAME.fullmatch(name) or name.startswith(HELPER_PREFIX):
        raise InputError(
            f"{kind} {name!r}: not a name for a chart's object; {HELPER_PREFIX}... is for the test namespace's own"
        )
    if kind == "ConfigMap" and name == AUTHORITIES:
        raise InputError(f"{kind} {name}: this name is the platform's: who may sign its certificates. Use another name")


def _refuse_holds(kind: str, name: str, metadata: Mapping[str, Any]) -> None:
    """InputError for what keeps an object from being deleted, and so the test namespace from being emptied."""
    held = [key for key in ("finalizers", "ownerReferences") if metadata.get(key)]
    if held:
        raise InputError(f"{kind} {name}: {' and '.join(held)}: leave them out, they keep it from being deleted")


def _refuse_places(name: str, pod: Mapping[str, Any], agent: str) -> None:
    """InputError for a pod that would run on another node than the test namespace's, or push others off it: the chart
    is not verified yet."""
    chosen = (pod.get("nodeSelector") or {}).get(AGENT_LABEL)
    if chosen != agent or pod.get("nodeName"):
        fix = f"write nodeSelector: {{{AGENT_LABEL}: {{{{ .Values.placement.agent }}}}}} and no nodeName"
        raise InputError(f"Deployment {name}: would not run on the test namespace's node, that of {agent}; {fix}")
    if pod.get("priorityClassName"):
        raise InputError(f"Deployment {name}: priorityClassName: leave it out, it pushes others off the node")


def _labelled(metadata: Mapping[str, Any]) -> dict[str, Any]:
    return {**metadata, "labels": {**(metadata.get("labels") or {}), LABEL: SUBJECT, **PEER}}


def _deployment(name: str, spec: Any, domain_id: int) -> dict[str, Any]:
    spec = spec if isinstance(spec, Mapping) else {}
    template = spec.get("template") or {}
    pod = dict(template.get("spec") or {})
    for key in ("containers", "initContainers"):
        if key in pod:
            pod[key] = [_with_domain(container, domain_id) for container in pod[key] or ()]
    metadata = _labelled(template.get("metadata") or {})
    _refuse_holds("pods of Deployment", name, metadata)
    return {**spec, "template": {**template, "metadata": metadata, "spec": pod}}


def _with_domain(container: Mapping[str, Any], domain_id: int) -> dict[str, Any]:
    kept = [entry for entry in container.get("env") or () if entry.get("name") != DOMAIN_VARIABLE]
    return {**container, "env": [*kept, {"name": DOMAIN_VARIABLE, "value": str(domain_id)}]}


def files_map(name: str, files: Mapping[str, bytes]) -> dict[str, Any]:
    """The ConfigMap that carries files into a helper pod; InputError beyond FILES_BYTES_MAX."""
    size = sum(map(len, files.values()))
    if size > FILES_BYTES_MAX:
        raise InputError(f"the files of pod {name} have {size} bytes; a pod takes at most {FILES_BYTES_MAX}")
    data = {path: base64.b64encode(content).decode() for path, content in files.items()}
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": own_metadata(name), "binaryData": data}


def files_volume(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Volume and mount of the files."""
    volume = {"name": "files", "configMap": {"name": name}}
    return volume, {"name": "files", "mountPath": FILES_FOLDER, "readOnly": True}


def scratch_volume() -> tuple[dict[str, Any], dict[str, Any]]:
    """Volume and mount of the volume claim `scratch`."""
    volume = {"name": "scratch", "persistentVolumeClaim": {"claimName": SCRATCH_VOLUME_CLAIM}}
    return volume, {"name": "scratch", "mountPath": SCRATCH_FOLDER}


def account_volume() -> tuple[dict[str, Any], dict[str, Any]]:
    """Volume and mount of the broker's account; empty when no broker was started."""
    authorities = {"name": AUTHORITIES, "optional": True, "items": [{"key": AUTHORITY_FILE, "path": AUTHORITY_FILE}]}
    sources = [{"secret": {"name": BROKER_SECRET, "optional": True}}, {"configMap": authorities}]
    volume = {"name": "account", "projected": {"defaultMode": 0o440, "sources": sources}}
    return volume, {"name": "account", "mountPath": ACCOUNT_FOLDER, "readOnly": True}


def authorities(certificate: str) -> dict[str, Any]:
    """The ConfigMap that says who signed certificates of broker and database, as in an agent's namespace."""
    metadata = own_metadata(AUTHORITIES)
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": metadata, "data": {AUTHORITY_FILE: certificate}}


def secret(name: str, data: Mapping[str, str]) -> dict[str, Any]:
    """A Secret of a helper."""
    return {"apiVersion": "v1", "kind": "Secret", "metadata": own_metadata(name), "stringData": dict(data)}


def password_line(username: str, password: str, salt: bytes) -> str:
    """A line of mosquitto's password file: PBKDF2 with SHA-512."""
    key = hashlib.pbkdf2_hmac("sha512", password.encode(), salt, HASH_ROUNDS, KEY_BYTES)
    parts = (base64.b64encode(part).decode() for part in (salt, key))
    return f"{username}:$7${HASH_ROUNDS}${'$'.join(parts)}\n"


BROKER_FOLDER = "/etc/mosquitto"
BROKER_CONFIGURATION = """\
allow_anonymous false
password_file /tmp/passwords
persistence false
message_size_limit 16777216
log_dest stderr
log_type all
"""


def broker_files(passwords: str, certificate: Pair | None) -> dict[str, str]:
    """The files of a broker; with a certificate it speaks TLS."""
    if certificate is None:
        listener = f"listener {MQTT_PORT}\n"
        more = {}
    else:
        files = f"certfile {BROKER_FOLDER}/tls.crt\nkeyfile {BROKER_FOLDER}/tls.key\n"
        listener = f"listener {MQTT_TLS_PORT}\n{files}"
        more = {"tls.crt": certificate.certificate, "tls.key": certificate.key}
    return {"mosquitto.conf": listener + BROKER_CONFIGURATION, "passwords": passwords, **more}


def broker_pod(name: str, image: str, agent: str, domain_id: int, port: int = MQTT_PORT) -> HelperPod:
    """A broker; Secret `name` has its files. mosquitto wants a password file of its own."""
    folder = BROKER_FOLDER
    start = f"umask 077; cat {folder}/passwords > /tmp/passwords; exec mosquitto -c {folder}/mosquitto.conf"
    return HelperPod(
        name, image, agent, domain_id,
        command=["sh", "-ec", start],
        volumes=[{"name": "settings", "secret": {"secretName": name, "defaultMode": 0o440}}],
        mounts=[{"name": "settings", "mountPath": folder, "readOnly": True}],
        port=port,
        memory="128Mi",
    )  # fmt: skip


DATABASE_FOLDER = "/etc/database-tls"
DATABASE_LISTENERS: Mapping[tuple[str, bool], Sequence[str]] = {  # by kind, and whether it speaks TLS
    ("mongo", False): (),
    ("mongo", True): (
        f"--port={DATABASE_TLS_PORT}", "--tlsMode=requireTLS", f"--tlsCertificateKeyFile={DATABASE_FOLDER}/tls.pem",
        f"--tlsCAFile={DATABASE_FOLDER}/{AUTHORITY_FILE}", "--tlsAllowConnectionsWithoutCertificates",
    ),
    ("ferretdb", False): (f"--listen-addr=:{DATABASE_PORT}",),
    ("ferretdb", True): (
        "--listen-addr=", f"--listen-tls=:{DATABASE_TLS_PORT}", f"--listen-tls-cert-file={DATABASE_FOLDER}/tls.crt",
        f"--listen-tls-key-file={DATABASE_FOLDER}/tls.key",
    ),
}  # fmt: skip


def database_files(issued: Issued | None) -> dict[str, str]:
    """The files of a database that speaks TLS, in each form that one reads; none without a certificate."""
    if issued is None:
        return {}
    pair = issued.pair
    both = pair.certificate + pair.key
    return {"tls.crt": pair.certificate, "tls.key": pair.key, "tls.pem": both, AUTHORITY_FILE: issued.authority}


def database_pod(
    name: str, kind: str, image: str, arguments: Sequence[str], agent: str, domain_id: int, tls: bool = False
) -> HelperPod:
    """A database as the platform runs it, without a volume claim; Secret `name` has its administrator and, with `tls`,
    its files."""
    volumes: list[dict[str, Any]] = [{"name": "data", "emptyDir": {"sizeLimit": "512Mi"}}]
    mounts: list[dict[str, Any]] = [{"name": "data", "mountPath": "/data/db"}]
    if tls:
        files = ("tls.crt", "tls.key", "tls.pem", AUTHORITY_FILE)
        items = [{"key": file, "path": file} for file in files]
        volumes.append({"name": "certificate", "secret": {"secretName": name, "defaultMode": 0o440, "items": items}})
        mounts.append({"name": "certificate", "mountPath": DATABASE_FOLDER, "readOnly": True})
    prefix = "MONGO_INITDB_ROOT" if kind == "mongo" else "FERRETDB_SETUP"
    if kind == "mongo":
        volumes.append({"name": "configdb", "emptyDir": {"sizeLimit": "16Mi"}})
        mounts.append({"name": "configdb", "mountPath": "/data/configdb"})
    environment = [
        {"name": f"{prefix}_{key.upper()}", "valueFrom": {"secretKeyRef": {"name": name, "key": key}}}
        for key in ("username", "password")
    ]
    return HelperPod(
        name, image, agent, domain_id,
        arguments=[*arguments, *DATABASE_LISTENERS[kind, tls]],
        environment=environment,
        volumes=volumes,
        mounts=mounts,
        port=DATABASE_TLS_PORT if tls else DATABASE_PORT,
        memory="1Gi",
    )  # fmt: skip


def mounts_scratch(pod: Mapping[str, Any]) -> bool:
    """Return whether a pod's spec mounts the volume claim `scratch`."""
    volumes = pod.get("volumes") or ()
    volume_claims = (volume.get("persistentVolumeClaim") or {} for volume in volumes)
    return any(claim.get("claimName") == SCRATCH_VOLUME_CLAIM for claim in volume_claims)
