"""etcd and kube-apiserver of the tool chain on loopback ports, without nodes and controllers, for tests."""

from __future__ import annotations

import os
import secrets
import ssl
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import yaml

from tests.stages import http_calls
from tests.stages.programs import SELDOM_COLLECTING, free_port, program

START_SECONDS_MAX = 60.0
POLL_SECONDS = 0.1


@dataclass
class ApiServerProcess:
    """One control plane below `folder`; `stop_server` and `start_server` take only the API server away and back.
    `options`: further ones of the API server; `environment`: further variables of both; `signed_by`: the file of who
    signed its certificate, where an option gives it one, and `host` a name or address that is in that."""

    folder: Path
    options: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    signed_by: Path | None = None
    host: str = "127.0.0.1"
    gives_tokens: bool = False  # to pods, as every cluster does: then a pod's account has to be there first
    etcd_port: int = field(default_factory=free_port)
    port: int = field(default_factory=free_port)
    token: str = field(default_factory=lambda: secrets.token_hex(16))
    etcd: subprocess.Popen[bytes] | None = None
    server: subprocess.Popen[bytes] | None = None

    @property
    def kubeconfig(self) -> Path:
        return self.folder / "kubeconfig"

    @property
    def authority(self) -> Path:
        """The file of who signed the API server's certificate, which it makes itself when it starts first, unless it
        was given one."""
        return self.signed_by or self.folder / "certificates" / "apiserver.crt"

    def start(self) -> None:
        key = self.folder / "account.key"
        subprocess.run(["openssl", "genrsa", "-out", str(key), "2048"], check=True, capture_output=True, timeout=30)
        (self.folder / "tokens.csv").write_text(f"{self.token},administrator,administrator,system:masters\n")
        self._write_kubeconfig()
        peer, url = f"http://127.0.0.1:{free_port()}", f"http://127.0.0.1:{self.etcd_port}"
        self.etcd = self._run(
            "etcd", f"--data-dir={self.folder}/etcd", "--unsafe-no-fsync", f"--listen-client-urls={url}",
            f"--advertise-client-urls={url}", f"--listen-peer-urls={peer}", f"--initial-advertise-peer-urls={peer}",
            f"--initial-cluster=default={peer}",
        )  # fmt: skip
        self.start_server()

    def start_server(self) -> None:
        key = self.folder / "account.key"
        disabled = "TaintNodesByCondition" if self.gives_tokens else "ServiceAccount,TaintNodesByCondition"
        self.server = self._run(
            "kube-apiserver", f"--etcd-servers=http://127.0.0.1:{self.etcd_port}", "--bind-address=127.0.0.1",
            f"--secure-port={self.port}", f"--cert-dir={self.folder}/certificates", "--authorization-mode=RBAC",
            f"--token-auth-file={self.folder}/tokens.csv", "--service-cluster-ip-range=10.255.0.0/24",
            f"--disable-admission-plugins={disabled}", "--endpoint-reconciler-type=none",
            "--enable-bootstrap-token-auth",  # as kubeadm starts it
            "--enable-priority-and-fairness=false",  # nobody waits for others here; it is an eighth of the start
            "--service-account-issuer=https://kubernetes.default.svc", f"--service-account-key-file={key}",
            f"--service-account-signing-key-file={key}", *self.options,
        )  # fmt: skip
        self._until(self.authority.with_suffix(".key").exists)  # written after the certificate
        with self.client() as client:
            self._until(lambda: _ready(client))

    def _until(self, reached: Callable[[], bool]) -> None:
        deadline = time.monotonic() + START_SECONDS_MAX
        while not reached():
            assert self.server is not None
            assert self.server.poll() is None, self._log()
            assert time.monotonic() < deadline, self._log()
            time.sleep(POLL_SECONDS)

    def client(self) -> httpx.Client:
        """Requests of the administrator."""
        headers = {"Authorization": f"Bearer {self.token}"}
        base = f"https://{self.host}:{self.port}"
        return httpx.Client(base_url=base, headers=headers, verify=believing(self.authority), timeout=30)

    def stop_server(self) -> None:
        """Killed: asked to end, it waits for its open watches."""
        if self.server is not None:
            self.server.kill()
            self.server.wait(10)

    def compact(self) -> None:
        """etcd forgets everything but the newest: a watch of the API server cannot go on from an older position."""
        base = f"http://127.0.0.1:{self.etcd_port}/v3"
        revision = http_calls.post(f"{base}/maintenance/status", json={}).json()["header"]["revision"]
        http_calls.post(f"{base}/kv/compaction", json={"revision": revision, "physical": True}).raise_for_status()

    def stop(self) -> None:
        self.stop_server()
        if self.etcd is not None:
            self.etcd.kill()
            self.etcd.wait(10)

    def _run(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.log").open("ab") as log:
            variables = {**os.environ, **SELDOM_COLLECTING, **self.environment}
            return subprocess.Popen([program(name), *arguments], stdout=log, stderr=log, env=variables)

    def _log(self) -> str:
        return (self.folder / "kube-apiserver.log").read_text()[-2000:]

    def _write_kubeconfig(self) -> None:
        server = {"server": f"https://{self.host}:{self.port}", "certificate-authority": str(self.authority)}
        document = {
            "apiVersion": "v1",
            "kind": "Config",
            "clusters": [{"name": "test", "cluster": server}],
            "users": [{"name": "test", "user": {"token": self.token}}],
            "contexts": [{"name": "test", "context": {"cluster": "test", "user": "test"}}],
            "current-context": "test",
        }
        self.kubeconfig.write_text(yaml.safe_dump(document))


def believing(authority: Path) -> ssl.SSLContext:
    """What a client verifies servers by: this authority alone."""
    return ssl.create_default_context(cafile=str(authority))


def _ready(client: httpx.Client) -> bool:
    try:
        return client.get("/readyz").is_success
    except httpx.HTTPError:
        return False
