"""Keys and certificates of one cluster, made anew at every start with openssl (elliptic curve P-256, valid 30 days)."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from ci.cluster.embedded.network.addresses import AddressPlan
from ci.errors import SetUpError

VALID_DAYS = 30
OPENSSL_TIMEOUT_SECONDS = 30
CURVE = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]


@dataclass(frozen=True)
class Identity:
    """A certificate: file name, subject (`groups` are the organisations), alternative names, signing authority."""

    name: str
    user: str
    groups: tuple[str, ...] = ()
    alternative_names: tuple[str, ...] = ()
    authority: str = "ca"

    @property
    def subject(self) -> str:
        """The subject in openssl's form."""
        return "".join(f"/O={group}" for group in self.groups) + f"/CN={self.user}"


def control_plane_identities(plan: AddressPlan) -> tuple[Identity, ...]:
    """Who the host's processes are. etcd has an authority of its own: no client of the API server is one of etcd's."""
    gateway = f"IP:{plan.gateway}"
    served = [gateway, f"IP:{plan.kubernetes_service}", "DNS:localhost"]
    served += [f"DNS:kubernetes{suffix}" for suffix in ("", ".default", ".default.svc", ".default.svc.cluster.local")]
    return (
        Identity("etcd", "etcd", alternative_names=(gateway,), authority="etcd-ca"),
        Identity("apiserver-etcd", "apiserver", authority="etcd-ca"),
        Identity("apiserver", "kube-apiserver", alternative_names=tuple(served)),
        Identity("apiserver-kubelet", "robotkube:kubelet-client"),
        Identity("admin", "admin", ("system:masters",)),
        Identity("controller-manager", "system:kube-controller-manager"),
        Identity("scheduler", "system:kube-scheduler"),
        Identity("proxy", "system:kube-proxy"),
        Identity("name-service", "robotkube:name-service"),
    )


def node_identity(name: str, address: str) -> Identity:
    """A kubelet's certificate, for its server and as the Node authorizer wants it."""
    return Identity(name, f"system:node:{name}", ("system:nodes",), (f"IP:{address}", f"DNS:{name}"))


class Authority:
    """Makes the files NAME.key and NAME.crt below `folder` (mode 0700)."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def create(self) -> None:
        """The two authorities and the key that signs service account tokens."""
        self.folder.mkdir(parents=True, mode=0o700)
        for name in ("ca", "etcd-ca"):
            usage = ["-addext", "basicConstraints=critical,CA:TRUE", "-addext", "keyUsage=critical,keyCertSign,cRLSign"]
            files = ["-keyout", self._file(name, "key"), "-out", self._file(name, "crt")]
            subject = ["-subj", f"/CN=robotkube-{name}", "-days", str(VALID_DAYS)]
            self._openssl(["req", "-x509", *CURVE, *subject, *usage, *files])
        self._openssl(["ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", self._file("sa", "key")])

    def issue(self, identity: Identity) -> None:
        """One certificate for client and server use."""
        extensions = ["extendedKeyUsage=serverAuth,clientAuth"]
        if identity.alternative_names:
            extensions.append("subjectAltName=" + ",".join(identity.alternative_names))
        self._openssl(
            ["req", "-x509", *CURVE, "-subj", identity.subject, "-days", str(VALID_DAYS)]
            + ["-CA", self._file(identity.authority, "crt"), "-CAkey", self._file(identity.authority, "key")]
            + [argument for extension in extensions for argument in ("-addext", extension)]
            + ["-addext", "basicConstraints=critical,CA:FALSE"]
            + ["-keyout", self._file(identity.name, "key"), "-out", self._file(identity.name, "crt")]
        )

    def write_kubeconfig(self, identity: Identity, server: str, target: Path) -> None:
        """A kubeconfig (JSON is YAML) that refers to the certificate's files."""
        cluster = {"server": server, "certificate-authority": self._file("ca", "crt")}
        user = {
            "client-certificate": self._file(identity.name, "crt"),
            "client-key": self._file(identity.name, "key"),
        }
        document = {
            "apiVersion": "v1",
            "kind": "Config",
            "clusters": [{"name": "robotkube", "cluster": cluster}],
            "users": [{"name": identity.user, "user": user}],
            "contexts": [{"name": "robotkube", "context": {"cluster": "robotkube", "user": identity.user}}],
            "current-context": "robotkube",
        }
        target.write_text(json.dumps(document, indent=1), encoding="utf-8")
        target.chmod(0o600)

    def _file(self, name: str, suffix: str) -> str:
        return str(self.folder / f"{name}.{suffix}")

    def _openssl(self, arguments: list[str]) -> None:
        result = subprocess.run(
            ["openssl", *arguments], capture_output=True, text=True, timeout=OPENSSL_TIMEOUT_SECONDS, check=False
        )
        if result.returncode != 0:
            raise SetUpError(f"openssl {' '.join(arguments[:3])} failed: {result.stderr.strip()[-300:]}")
