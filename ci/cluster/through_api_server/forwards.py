"""Ways from this machine to Services of a cluster that only its API server leads to: `kubectl port-forward`, started
again whenever it ends, at the port that it had. kubectl follows one pod, and ends when that one is gone."""

from __future__ import annotations

import atexit
import contextlib
import socket
import subprocess
import threading
from collections.abc import Sequence

from ci.cluster_contract.provider import ServicePort
from ci.errors import SetUpError

HOST = "localhost"  # a name, since the forge's certificate has it
READY_SECONDS_MAX = 60.0
AGAIN_SECONDS = 0.5
END_SECONDS_MAX = 5.0
BEGUN = "Forwarding from "


class Forwards:
    """Forwards by Service, begun when somebody asks for one, until `end` or the end of this process. `kubectl` is the
    command with what names the cluster."""

    def __init__(self, kubectl: Sequence[str]) -> None:
        self._kubectl = kubectl
        self._begun: dict[ServicePort, Forward] = {}
        self._lock = threading.Lock()
        atexit.register(self.end)

    def address(self, service: ServicePort) -> tuple[str, int]:
        """Host and port; SetUpError with what kubectl says where nothing answers."""
        with self._lock:
            if service not in self._begun:
                self._begun[service] = Forward(self._kubectl, service)
        return HOST, self._begun[service].ready()

    def end(self) -> None:
        """End all forwards."""
        with self._lock:
            begun, self._begun = list(self._begun.values()), {}
        for forward in begun:
            forward.end()


class Forward:
    """One forward, kept going by a thread of its own."""

    def __init__(self, kubectl: Sequence[str], service: ServicePort) -> None:
        self._service = service
        self._port = _free_port()
        target = ("-n", service.namespace, "port-forward", f"service/{service.name}", f"{self._port}:{service.port}")
        self._command = [*kubectl, *target]
        self._listening, self._ending = threading.Event(), threading.Event()
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._said = ""
        self._thread = threading.Thread(target=self._keep, name=f"forward to {service.name}", daemon=True)
        self._thread.start()

    def ready(self) -> int:
        """Its port, once kubectl listens there; SetUpError."""
        if not self._listening.wait(READY_SECONDS_MAX):
            where = f"Service {self._service.namespace}/{self._service.name}, port {self._service.port}"
            raise SetUpError(f"{where}: kubectl port-forward does not reach it: {self._said.strip()[-500:]}")
        return self._port

    def end(self) -> None:
        """End kubectl, and do not start it again."""
        self._ending.set()
        with self._lock:
            if self._process is not None:
                self._process.terminate()
        self._thread.join(END_SECONDS_MAX)

    def _keep(self) -> None:
        while not self._ending.is_set():
            self._run()
            self._listening.clear()
            self._ending.wait(AGAIN_SECONDS)

    def _run(self) -> None:
        """Run kubectl until it ends."""
        with self._lock:
            if self._ending.is_set():
                return
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(self._command, stdout=pipe, stderr=subprocess.STDOUT, text=True)
        with self._process as process, contextlib.suppress(ValueError):
            for line in process.stdout or ():
                if line.startswith(BEGUN):
                    self._listening.set()
                else:
                    self._said = line if self._listening.is_set() else f"{self._said}{line}"[-2000:]


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
