"""The forge as the chart starts it with `forge.tls`: its rendered files in a real Gitea, with a certificate of an
authority of the test's."""

from __future__ import annotations

import os
import signal
import socket
import ssl
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ci import toolchain
from robotkube.foundation.certificates.adapters.issuing import issue, new_authority
from robotkube.foundation.certificates.core.lives import Pair
from tests.stages.paths import CHARTS
from tests.stages.programs import SELDOM_COLLECTING, free_port, program
from tests.stages.waiting import WAIT_SECONDS_MAX, until

PLATFORM = CHARTS / "robotkube"


@dataclass
class EncryptedForge:
    """The containers of the forge's pod, as processes of what the chart renders, on their files. `localhost` stands for
    the name of its Service."""

    folder: Path
    rendered: Any
    port: int = field(default_factory=free_port)
    authority: Pair = field(default_factory=lambda: new_authority("ours", time.time()))

    @property
    def url(self) -> str:
        return f"https://localhost:{self.port}"

    @property
    def names(self) -> list[str]:
        """Those that the process `certificates` is told."""
        settings = yaml.safe_load(self.rendered.one("ConfigMap", "certificates")["data"]["config.yaml"])
        [certificate] = [one for one in settings["certificates"] if "service" in one]
        assert (certificate["secret"], certificate["service"]) == ("forge-tls", "forge")
        return list(certificate["names"])

    def moved(self, text: str) -> str:
        """A file of the pod with its places moved to the test's."""
        places = {
            " /data": f" {self.folder}/data",
            "/run/forge": f"{self.folder}/run",
            "/etc/forge-tls": str(self.folder),
            "/etc/robotkube/authorities": str(self.folder),
            "/etc/forge-hooks": str(PLATFORM / "files" / "forge-hooks"),
            "/etc/gitea": str(self.folder),
            "/var/run/secrets/robotkube": str(self.folder),
            "HTTP_PORT = 3000": f"HTTP_PORT = {self.port}",
            "127.0.0.1:3000": f"127.0.0.1:{self.port}",
            "forge.robotkube.svc.cluster.local:3000": f"localhost:{self.port}",
            "/opt/gitea": str(toolchain.gitea_static("templates").parent),
            "pause=5": "pause=0.5",
            "ALLOWED_HOST_LIST = private": "ALLOWED_HOST_LIST = loopback",
        }
        for old, new in places.items():
            text = text.replace(old, new)
        return text

    def start(self) -> None:
        for name in ("data", "run"):
            (self.folder / name).mkdir(parents=True)
        account = self.rendered.one("Secret", "forge-account-administrator")["stringData"]
        scripts = self.rendered.one("ConfigMap", "forge")["data"]
        settings = self.rendered.one("Secret", "forge")["stringData"]
        scripts["run.sh"] = scripts.pop("run")
        for name, text in {**account, **scripts, **settings}.items():
            (self.folder / name).write_text(self.moved(text))
        (self.folder / "ca.crt").write_text(self.authority.certificate)
        self.show(3600)
        subprocess.run(["sh", str(self.folder / "prepare")], env=self.environment(), capture_output=True, check=True)
        [container] = dict(self.rendered.pods)["StatefulSet/forge"]["containers"]
        assert container["command"] == ["sh", "/prepare/run"]
        with (self.folder / "log").open("ab") as log:
            command = ["sh", str(self.folder / "run.sh")]
            self.process = subprocess.Popen(
                command, env=self.environment(), stdout=log, stderr=log, start_new_session=True
            )
        until(self.answers, "the forge", state=lambda: (self.folder / "log").read_text())

    def environment(self) -> Mapping[str, str]:
        return {
            "PATH": f"{Path(program('gitea')).parent}:{os.environ['PATH']}",
            "HOME": str(self.folder / "data"),
            "GITEA_I_AM_BEING_UNSAFE_RUNNING_AS_ROOT": "true",
            "FORGE_CONFIG": str(self.folder / "app.ini"),
            "SSL_CERT_DIR": str(self.folder),
            **SELDOM_COLLECTING,
        }

    def answers(self) -> bool:
        try:
            return bool(self.shown())
        except OSError:
            return False

    def show(self, seconds: float, began: float = 0.0, authority: Pair | None = None) -> None:
        """Another certificate in the mounted files, both at once as a kubelet does it."""
        pair = issue(authority or self.authority, self.names, time.time() - began, seconds)
        for name, text in (("tls.key", pair.key), ("tls.crt", pair.certificate)):
            (self.folder / f"{name}.new").write_text(text)
        for name in ("tls.key", "tls.crt"):
            (self.folder / f"{name}.new").replace(self.folder / name)

    def shown(self) -> bytes:
        """The certificate that a client sees now, valid or not."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
        with socket.create_connection(("127.0.0.1", self.port), 10) as plain, context.wrap_socket(plain) as encrypted:
            return encrypted.getpeercert(binary_form=True) or b""

    def renewed(self) -> Callable[[], bool]:
        """Show another one; whether the forge does."""
        before = self.shown()
        self.show(3600)
        return lambda: self.shows_another_than(before)

    def shows_another_than(self, before: bytes) -> bool:
        """Return whether a client sees another certificate than `before`; False while the forge ends what looks."""
        try:
            return self.shown() != before
        except OSError:
            return False

    def administrator(self) -> tuple[str, str]:
        return (self.folder / "username").read_text(), (self.folder / "password").read_text()

    def stop(self) -> None:
        """Killed with all that it started: asked to end, its shell looks twice, a second apart, whether one serves."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait(WAIT_SECONDS_MAX)
