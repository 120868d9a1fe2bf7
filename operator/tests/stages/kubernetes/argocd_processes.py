"""Argo CD's own programs on an API server without nodes, each with the token, and so the rights, of its account."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from tests.stages.kubernetes.installed_chart import Cluster
from tests.stages.programs import free_port, program

NAMESPACE = "argocd"
END_SECONDS_MAX = 10


@contextmanager
def serving(cluster: Cluster, folder: Path) -> Iterator[str]:
    """argocd-server without its cache, which logins and hooks do not need; its URL, which answers a little later.

    It reads the hooks' secrets when it starts. A change that comes between that and its first listening is lost to it
    until the next one, and one of Azure DevOps' it does not notice at all (watchSettings in its server/server.go)."""
    port = free_port()
    ports = (f"--port={port}", f"--metrics-port={free_port()}")
    with _running(cluster, folder, "argocd-server", "--insecure", "--address=127.0.0.1", *ports):
        yield f"http://127.0.0.1:{port}"


@contextmanager
def generating(cluster: Cluster, folder: Path) -> Iterator[str]:
    """The ApplicationSet controller, which reads the hooks' secrets when it starts; its URL, which answers a little
    later."""
    port = free_port()
    ports = [f"--{name}-addr=127.0.0.1:{free_port()}" for name in ("metrics", "probe")]
    with _running(cluster, folder, "argocd-applicationset-controller", f"--webhook-addr=127.0.0.1:{port}", *ports):
        yield f"http://127.0.0.1:{port}"


@contextmanager
def rendering(cluster: Cluster, folder: Path, clients: Path) -> Iterator[int]:
    """The repo-server without its cache, which answers those who show a certificate of the file `clients`; its port,
    where it listens a little later."""
    port = free_port()
    options = (f"--port={port}", f"--metrics-port={free_port()}", f"--client-ca-path={clients}")
    with _running(cluster, folder, "argocd-repo-server", "--address=127.0.0.1", *options):
        yield port


@contextmanager
def _running(cluster: Cluster, folder: Path, name: str, *arguments: str) -> Iterator[None]:
    own = {"HOME": str(folder), "TMPDIR": str(folder), "NAMESPACE": NAMESPACE, "ARGOCD_GPG_ENABLED": "false"}
    environment = {**os.environ, **own, "KUBECONFIG": str(_kubeconfig(cluster, folder, name))}
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen([program(name), *arguments], env=environment, cwd=folder, stdout=log, stderr=log)
    try:
        yield
    finally:
        process.kill()
        process.wait(END_SECONDS_MAX)


def _kubeconfig(cluster: Cluster, folder: Path, account: str) -> Path:
    """A kubeconfig of the service account that is named like its program."""
    document = yaml.safe_load(cluster.kubeconfig.read_text())
    document["users"][0]["user"] = {"token": cluster.kubectl("create", "token", account, "-n", NAMESPACE).strip()}
    document["contexts"][0]["context"]["namespace"] = NAMESPACE
    path = folder / f"{account}.kubeconfig"
    path.write_text(yaml.safe_dump(document))
    return path
