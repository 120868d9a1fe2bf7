"""The forge's rendered app.ini and its preparation, in a real Gitea: read-only settings, accounts, closed doors. By
TLS: test_forge_certificate.py."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest

from ci import toolchain
from tests.stages import http_calls
from tests.stages.paths import CHARTS
from tests.stages.programs import free_port

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
EMBEDDED = (PLATFORM / "values-embedded.yaml", Path(__file__).parent / "profiles" / "embedded.yaml")
PREPARE_SECONDS_MAX = 60
START_SECONDS_MAX = 30.0


@dataclass(frozen=True)
class Forge:
    """A prepared forge on a folder: the rendered files with their places and its port moved to the test's."""

    folder: Path
    port: int
    environment: Mapping[str, str]

    def prepare(self) -> None:
        """What the init container does."""
        done = subprocess.run(
            ["sh", str(self.folder / "prepare")],
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=PREPARE_SECONDS_MAX,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr

    def serve(self) -> subprocess.Popen[bytes]:
        with (self.folder / "log").open("ab") as log:
            command = ["gitea", "--config", str(self.folder / "app.ini"), "web"]
            process = subprocess.Popen(command, env=self.environment, stdout=log, stderr=log)
        deadline = time.monotonic() + START_SECONDS_MAX
        while not self._healthy():
            assert process.poll() is None, (self.folder / "log").read_text()
            assert time.monotonic() < deadline, (self.folder / "log").read_text()
            time.sleep(0.05)
        return process

    def _healthy(self) -> bool:
        try:
            return self.get("/api/healthz").status_code == 200
        except httpx.HTTPError:
            return False

    def get(self, path: str, account: tuple[str, str] | None = None) -> httpx.Response:
        return http_calls.get(f"http://127.0.0.1:{self.port}{path}", auth=account, timeout=5)


@pytest.fixture(scope="module")
def forge(helm: Any, tmp_path_factory: pytest.TempPathFactory) -> Forge:
    """In clear text; by TLS: test_forge_certificate.py."""
    embedded = helm.template(PLATFORM, *EMBEDDED, forge={"tls": False})
    folder = tmp_path_factory.mktemp("forge")
    port = free_port()
    account = embedded.one("Secret", "forge-account-administrator")["stringData"]
    for key, value in account.items():
        (folder / key).write_text(value)
    static = toolchain.gitea_static("templates").parent
    settings = embedded.one("Secret", "forge")["stringData"]["app.ini"]
    for old, new in (
        (" /data", f" {folder}/data"),
        ("HTTP_PORT = 3000", f"HTTP_PORT = {port}"),
        ("127.0.0.1:3000", f"127.0.0.1:{port}"),
        ("/opt/gitea", str(static)),
    ):
        assert old in settings
        settings = settings.replace(old, new)
    (folder / "app.ini").write_text(settings)
    (folder / "app.ini").chmod(0o440)
    script = embedded.one("ConfigMap", "forge")["data"]["prepare"]
    script = script.replace("/etc/gitea", str(folder)).replace("/var/run/secrets/robotkube", str(folder))
    (folder / "prepare").write_text(script)
    environment = {
        "PATH": f"{Path(helm.binary).parent}:{os.environ['PATH']}",
        "HOME": str(folder / "data"),
        "GITEA_I_AM_BEING_UNSAFE_RUNNING_AS_ROOT": "true",
    }
    (folder / "data").mkdir()
    return Forge(folder, port, environment)


@pytest.fixture(scope="module")
def served(forge: Forge) -> Iterator[Forge]:
    forge.prepare()
    process = forge.serve()
    yield forge
    process.terminate()
    process.wait(15)


def administrator(forge: Forge) -> tuple[str, str]:
    return (forge.folder / "username").read_text(), (forge.folder / "password").read_text()


def test_the_administrator_may_enter_and_nobody_else(served: Forge) -> None:
    assert served.get("/api/v1/user", administrator(served)).json()["is_admin"] is True
    assert served.get("/api/v1/user", ("administrator", "wrong")).status_code == 401
    assert served.get("/api/v1/repos/search").status_code in {401, 403}
    assert served.get("/v2/").status_code == 401


def test_the_registry_takes_the_account(served: Forge) -> None:
    token = served.get("/v2/token?service=container_registry&scope=*", administrator(served))
    assert token.status_code == 200
    assert token.json()["token"]


def test_it_is_no_provider_unless_the_console_asks_for_it(served: Forge) -> None:
    assert served.get("/.well-known/openid-configuration").status_code == 404
    assert served.get("/login/oauth/authorize", administrator(served)).status_code == 403


def test_an_account_makes_no_repository_and_no_organisation(served: Forge) -> None:
    account = ("somebody", "password-of-somebody")
    base = f"http://127.0.0.1:{served.port}/api/v1"
    new = {"username": account[0], "password": account[1], "email": "a@b.invalid", "must_change_password": False}
    made = http_calls.post(f"{base}/admin/users", json=new, auth=administrator(served), timeout=5)
    assert made.status_code == 201, made.text
    repository = http_calls.post(f"{base}/user/repos", json={"name": "own"}, auth=account, timeout=5)
    assert (repository.status_code, "maximum limit of repositories" in repository.text) == (403, True), repository.text
    organisation = http_calls.post(f"{base}/orgs", json={"username": "own"}, auth=account, timeout=5)
    assert organisation.status_code == 403, organisation.text


def test_the_settings_file_was_not_written_to(served: Forge) -> None:
    log = (served.folder / "log").read_text()
    assert (served.folder / "app.ini").stat().st_mode & 0o777 == 0o440
    assert "failed" not in log.lower(), log
    assert "JWT_SECRET" not in log, log


def test_preparing_again_gives_the_administrator_its_password(served: Forge) -> None:
    (served.folder / "password").write_text("another-password-of-the-administrator")
    served.prepare()
    assert served.get("/api/v1/user", administrator(served)).status_code == 200
