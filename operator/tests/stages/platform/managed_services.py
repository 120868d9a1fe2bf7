"""A broker and a database of others, in a namespace of their own beside the platform: certificates, accounts and rights
are of their owner's making, by the examples of docs/how-to/use-a-managed-broker-and-database.md."""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ci.images import preparation
from ci.installation import NAMESPACE as PLATFORM
from ci.installation import RESTRICTED
from robotkube.foundation.certificates.adapters.issuing import issue, new_authority
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.foundation.database.adapters.connection import DatabaseLogin, connect
from tests.stages.paths import DOCS
from tests.stages.platform.running_platform import Platform

PAGE = DOCS / "how-to" / "use-a-managed-broker-and-database.md"
NAMESPACE = "managed"
BROKER, DATABASE = (f"{name}.{NAMESPACE}.svc.cluster.local" for name in ("mqtt", "mongo"))
OWNER = ("owner", "known to nobody else")  # who administers both
LIFE_SECONDS = 86_400.0
READY_SECONDS, ADDRESS_SECONDS_MAX = 90, 120.0
BROKERS_PORT, DATABASES_PORT = 8883, 27017
PROGRAM = (
    "cp -f /given/* /etc/mosquitto/ && chmod 600 /etc/mosquitto/* "
    "&& mosquitto_passwd -U /etc/mosquitto/passwords && exec mosquitto -c /etc/mosquitto/mosquitto.conf"
)
FERRETDB = (
    "--handler=sqlite",
    "--sqlite-url=file:/data/db/",
    "--state-dir=/data/db",
    "--debug-addr=-",
    "--telemetry=disable",
    "--setup-database=admin",
    "--log-level=warn",
    "--listen-addr=",
    f"--listen-tls=:{DATABASES_PORT}",
    "--listen-tls-cert-file=/tls/tls.crt",
    "--listen-tls-key-file=/tls/tls.key",
)


def example(name: str) -> str:
    """The example of the page that begins with a comment of this name."""
    [found] = re.findall(rf"^```\w+\n# {re.escape(name)}\b.*\n((?s:.*?))^```$", PAGE.read_text("utf-8"), re.MULTILINE)
    return str(found)


def command_for_an_account() -> dict[str, Any]:
    """What the page has the database's owner run."""
    [found] = re.findall(r"\.runCommand\((\{.*?\})\)", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return dict(yaml.safe_load(found))


@dataclass
class ManagedServices:
    """Both, and who owns them: `authorities` are who signs for each, and for the forge, by name."""

    platform: Platform
    folder: Path
    authorities: Mapping[str, Pair] = field(
        default_factory=lambda: {name: new_authority(name, time.time()) for name in ("mqtt", "mongo", "forge")}
    )

    def start(self) -> None:
        """Run them, with no account but the owner's."""
        self.platform.installer.namespace(NAMESPACE, RESTRICTED)
        references = preparation.everything().references()
        secrets = [
            self._certificate("mqtt", "mqtt-certificate", NAMESPACE, [BROKER]),
            self._certificate("mongo", "mongo-certificate", NAMESPACE, [DATABASE]),
            self._files_of_broker({OWNER[0]: OWNER[1]}, ""),
        ]
        self._apply(*secrets, *_broker(references["mosquitto"]), *_database(references["ferretdb"]))
        for name in ("mqtt", "mongo"):
            self._rolled_out(name)

    def values(self) -> dict[str, Any]:
        """The page's example for both, with hosts, authorities and the place where they stand here."""
        given = yaml.safe_load(example("managed.yaml"))
        given["broker"]["external"]["host"], given["database"]["external"]["host"] = BROKER, DATABASE
        given["tls"]["authorities"] = "".join(pair.certificate for pair in self.authorities.values())
        named = {"namespaceSelector": {"matchLabels": {"kubernetes.io/metadata.name": NAMESPACE}}}
        given["networkPolicies"]["outside"]["to"] = [named]
        return dict(given)

    @contextmanager
    def certificate_of_forge(self) -> Iterator[None]:
        """Make the certificate of the platform's own forge as soon as its Service has an address."""
        making = threading.Thread(target=self._certify_forge)
        making.start()
        yield
        making.join()

    def _certify_forge(self) -> None:
        asked = ("-n", PLATFORM, "get", "service", "forge", "--ignore-not-found", "-o", "jsonpath={.spec.clusterIP}")
        end = time.monotonic() + ADDRESS_SECONDS_MAX
        while not (address := self.platform.kubectl(*asked).strip()) and time.monotonic() < end:
            time.sleep(1)
        service = f"forge.{PLATFORM}"
        names = [f"{service}.svc.cluster.local", f"{service}.svc", service, "forge", "localhost", "127.0.0.1", address]
        self._apply(self._certificate("forge", "forge-certificate", PLATFORM, names))

    def make_accounts(self) -> None:
        """Make those of the platform's Secrets, by what stands in these."""
        accounts = self._accounts_at_broker()
        self._apply(self._files_of_broker({OWNER[0]: OWNER[1], **accounts}, self._rights()))
        self.platform.kubectl("-n", NAMESPACE, "rollout", "restart", "deployment", "mqtt")
        self._rolled_out("mqtt")
        for agent in self.platform.agents:
            if values := self._secret(agent, "database-account"):
                self._make_database_account(values)

    def _accounts_at_broker(self) -> dict[str, str]:
        secrets = [self._secret(PLATFORM, f"broker-account-{name}") for name in ("manager", "observer")]
        secrets += [self._secret(agent, "broker-account") for agent in self.platform.agents]
        assert {(one["host"], one["port"], one["tls"], one["identity"]) for one in secrets} == {
            (BROKER, str(BROKERS_PORT), "required", "password")
        }
        return {one["username"]: one["password"] for one in secrets}

    def _rights(self) -> str:
        """The page's file of rights, with what it gives one vehicle for each."""
        text = example("acl")
        first, of_vehicle, last = re.split(r"^(?=user vehicle-00$|user cloud-0$)", text, flags=re.MULTILINE)
        vehicles = [agent for agent in self.platform.agents if agent.startswith("vehicle-")]
        own = [
            of_vehicle.replace("vehicle-00", name).replace("vehicle_00", name.replace("-", "_")) for name in vehicles
        ]
        return "".join([first, *own, last])

    def _make_database_account(self, values: Mapping[str, str]) -> None:
        assert (values["host"], values["port"], values["tls"]) == (DATABASE, str(DATABASES_PORT), "required")
        command = command_for_an_account()
        database, page = values["database"], command["createUser"]
        text = json.dumps({**command, "pwd": values["password"]}).replace(page, values["username"])
        authorities = self.folder / "ca.crt"
        authorities.write_text(self.authorities["mongo"].certificate)
        address = self.platform.access.service("mongo", NAMESPACE)[0].address
        proof = ServerVerification(authorities, DATABASE)
        with connect(DatabaseLogin(address, DATABASES_PORT, database, *OWNER, "admin", proof)).client as owner:
            owner[database].command(json.loads(text))

    def _files_of_broker(self, accounts: Mapping[str, str], rights: str) -> dict[str, Any]:
        passwords = "".join(f"{name}:{password}\n" for name, password in accounts.items())
        files = {"mosquitto.conf": example("mosquitto.conf"), "acl": rights, "passwords": passwords}
        return secret_object("mqtt-files", NAMESPACE, files)

    def _certificate(self, authority: str, name: str, namespace: str, names: list[str]) -> dict[str, Any]:
        pair = issue(self.authorities[authority], names, time.time(), LIFE_SECONDS)
        return secret_object(name, namespace, {"tls.crt": pair.certificate, "tls.key": pair.key})

    def _secret(self, namespace: str, name: str) -> dict[str, str]:
        """A Secret's values; none when it is not there."""
        found = self.platform.kubectl("-n", namespace, "get", "secret", name, "--ignore-not-found", "-o", "name")
        return self.platform.access.secret(namespace, name) if found else {}

    def _apply(self, *objects: Mapping[str, Any]) -> None:
        self.platform.kubectl("apply", "--server-side", "-f", "-", text=yaml.safe_dump_all(objects))

    def _rolled_out(self, name: str) -> None:
        wait = ("-n", NAMESPACE, "rollout", "status", f"deployment/{name}", f"--timeout={READY_SECONDS}s")
        self.platform.kubectl(*wait, seconds=READY_SECONDS + 10)


def secret_object(name: str, namespace: str, values: Mapping[str, str]) -> dict[str, Any]:
    metadata = {"name": name, "namespace": namespace}
    return {"apiVersion": "v1", "kind": "Secret", "metadata": metadata, "stringData": dict(values)}


def _broker(image: str) -> list[dict[str, Any]]:
    volumes = {
        "/given": {"secret": {"secretName": "mqtt-files", "defaultMode": 0o440}},
        "/etc/mosquitto": {"emptyDir": {}},
        "/etc/mosquitto-tls": {"secret": {"secretName": "mqtt-certificate", "defaultMode": 0o440}},
        "/tmp": {"emptyDir": {}},  # noqa: S108 - of the pod
    }
    return served("mqtt", BROKERS_PORT, {"image": image, "command": ["sh", "-ec", PROGRAM]}, volumes)


def _database(image: str) -> list[dict[str, Any]]:
    set_up = zip(("FERRETDB_SETUP_USERNAME", "FERRETDB_SETUP_PASSWORD"), OWNER, strict=True)
    environment = [{"name": name, "value": value} for name, value in (*set_up, ("HOME", "/tmp"))]  # noqa: S108
    volumes = {
        "/tls": {"secret": {"secretName": "mongo-certificate", "defaultMode": 0o440}},
        "/data/db": {"emptyDir": {}},
        "/tmp": {"emptyDir": {}},  # noqa: S108 - of the pod
    }
    return served("mongo", DATABASES_PORT, {"image": image, "args": [*FERRETDB], "env": environment}, volumes)


def served(
    name: str, port: int, container: Mapping[str, Any], volumes: Mapping[str, Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """A Deployment of one pod, as restricted as all others, and its Service; `volumes` by the place of each."""
    metadata, labels = {"name": name, "namespace": NAMESPACE}, {"app": name}
    named = {place: place.strip("/").replace("/", "-") for place in volumes}
    restricted = {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    main = {
        "name": name,
        **container,
        "ports": [{"containerPort": port}],
        "readinessProbe": {"tcpSocket": {"port": port}, "periodSeconds": 1},
        "securityContext": restricted,
        "volumeMounts": [{"name": volume, "mountPath": place} for place, volume in named.items()],
    }
    pod = {
        "automountServiceAccountToken": False,
        "enableServiceLinks": False,
        "nodeSelector": {"robotkube.io/role": "platform"},
        "tolerations": [{"key": "robotkube.io/role", "operator": "Exists"}],
        "securityContext": {
            "runAsNonRoot": True,
            "runAsUser": 10001,
            "fsGroup": 10001,
            "seccompProfile": {"type": "RuntimeDefault"},
        },
        "containers": [main],
        "volumes": [{"name": named[place], **source} for place, source in volumes.items()],
    }
    template = {"metadata": {"labels": labels}, "spec": pod}
    spec = {"replicas": 1, "strategy": {"type": "Recreate"}, "selector": {"matchLabels": labels}, "template": template}
    return [
        {"apiVersion": "apps/v1", "kind": "Deployment", "metadata": metadata, "spec": spec},
        {
            "apiVersion": "v1",
            "kind": "Service",
            "metadata": metadata,
            "spec": {"selector": labels, "ports": [{"port": port}]},
        },
    ]
