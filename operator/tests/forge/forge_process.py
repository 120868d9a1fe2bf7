"""A real forge (Gitea on SQLite) on a loopback port, for tests: it starts with an empty data folder."""

import os
import secrets
import shutil
import signal
import socket
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

import httpx

START_SECONDS_MAX = 60.0
STOP_SECONDS_MAX = 10.0
REPOSITORY_ROOT = Path(__file__).resolve().parents[3]
FORGE_MODULE = REPOSITORY_ROOT / "ci" / "toolchain" / "gitea"

APP_INI = """\
APP_NAME = forge
RUN_USER = {user}
WORK_PATH = {data}
[server]
HTTP_ADDR = 127.0.0.1
HTTP_PORT = {port}
ROOT_URL = {url}/
STATIC_ROOT_PATH = {static}
DISABLE_SSH = true
OFFLINE_MODE = true
LFS_START_SERVER = false
[database]
DB_TYPE = sqlite3
PATH = {data}/forge.db
SQLITE_JOURNAL_MODE = WAL
[security]
INSTALL_LOCK = true
SECRET_KEY = {secret}
INTERNAL_TOKEN = {token}
[service]
DISABLE_REGISTRATION = true
[repository]
ROOT = {data}/repositories
DEFAULT_BRANCH = main
[packages]
ENABLED = true
[actions]
ENABLED = false
[mailer]
ENABLED = false
[cron]
ENABLED = false
[log]
MODE = console
LEVEL = Warn
[indexer]
ISSUE_INDEXER_TYPE = db
[cache]
ADAPTER = memory
[queue]
TYPE = channel
[webhook]
ALLOWED_HOST_LIST = loopback,private
"""


class ForgeMissingError(RuntimeError):
    """The forge program or its files are missing, or it did not start; the message says what to build."""


def find_program() -> Path:
    """The `gitea` of the tool chain: folder ROBOTKUBE_TOOLCHAIN_BIN, else the newest one in the user's cache."""
    folder = os.environ.get("ROBOTKUBE_TOOLCHAIN_BIN")
    if folder:
        candidates = [Path(folder) / "gitea"]
    else:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robotkube"
        candidates = sorted(cache.glob("toolchain/**/gitea"), key=lambda path: path.stat().st_mtime, reverse=True)
    for candidate in candidates:
        if candidate.is_file() and os.access(candidate, os.X_OK):
            return candidate
    raise ForgeMissingError(
        "the forge program `gitea` was not found: set ROBOTKUBE_TOOLCHAIN_BIN to the folder of the built tool chain, "
        "or build it with ci/toolchain/gitea/build.sh FOLDER"
    )


def find_static_files() -> Path:
    """The folder with the forge's templates: ROBOTKUBE_FORGE_STATIC, else the Go module's source folder."""
    folder = os.environ.get("ROBOTKUBE_FORGE_STATIC")
    if not folder:
        command = ["go", "list", "-mod=readonly", "-m", "-f", "{{.Dir}}", "code.gitea.io/gitea"]
        answer = subprocess.run(command, cwd=FORGE_MODULE, capture_output=True, text=True, timeout=60, check=False)
        folder = answer.stdout.strip()
    if not folder or not (Path(folder) / "templates").is_dir():
        raise ForgeMissingError(
            "the forge's templates were not found: set ROBOTKUBE_FORGE_STATIC, "
            f"or run `go mod download code.gitea.io/gitea` in {FORGE_MODULE}"
        )
    return Path(folder)


def free_port() -> int:
    """A loopback TCP port nobody listens on at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class ForgeProcess:
    """One forge: `start()` makes data folder and administrator and waits until it answers, `stop()` ends it."""

    data: Path
    administrator_password: str = field(default_factory=lambda: secrets.token_hex(12))
    administrator: str = "administrator"
    port: int = field(default_factory=free_port)
    process: subprocess.Popen[bytes] | None = None
    environment: dict[str, str] = field(default_factory=dict)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def _run(self, *arguments: str) -> str:
        command = [str(find_program()), "--config", str(self.data / "app.ini"), *arguments]
        answer = subprocess.run(
            command, env=self._environment(), capture_output=True, text=True, timeout=120, check=False
        )
        if answer.returncode:
            raise ForgeMissingError(f"gitea {' '.join(arguments[:3])}: {answer.stdout[-500:]}{answer.stderr[-500:]}")
        return answer.stdout.strip()

    def _environment(self) -> dict[str, str]:
        return {
            "PATH": os.environ.get("PATH", ""),
            "HOME": str(self.data),
            "GITEA_I_AM_BEING_UNSAFE_RUNNING_AS_ROOT": "true",
            **self.environment,
        }

    def start(self) -> None:
        """Raises ForgeMissingError when it does not answer within START_SECONDS_MAX."""
        self.data.mkdir(parents=True, exist_ok=True)
        if not (self.data / "app.ini").exists():
            self._write_configuration()
            self._run("migrate")
            self._run(
                *("admin", "user", "create", "--admin", "--username", self.administrator),
                *("--password", self.administrator_password, "--email", "administrator@forge.invalid"),
                "--must-change-password=false",
            )
        log = (self.data / "forge.log").open("ab")
        command = [str(find_program()), "--config", str(self.data / "app.ini"), "web"]
        self.process = subprocess.Popen(command, env=self._environment(), stdout=log, stderr=log)
        log.close()
        self._wait_until_it_answers()

    def _write_configuration(self) -> None:
        user = subprocess.run(["id", "-un"], capture_output=True, text=True, check=True).stdout.strip()
        token = subprocess.run(
            [str(find_program()), "generate", "secret", "INTERNAL_TOKEN"],
            capture_output=True, text=True, check=True, env=self._environment(), timeout=60,
        ).stdout.strip()  # fmt: skip
        text = APP_INI.format(
            user=user, data=self.data, port=self.port, url=self.url, static=find_static_files(),
            secret=secrets.token_hex(32), token=token,
        )  # fmt: skip
        (self.data / "app.ini").write_text(text)

    def _wait_until_it_answers(self) -> None:
        end = time.monotonic() + START_SECONDS_MAX
        while time.monotonic() < end:
            if self.process is None or self.process.poll() is not None:
                break
            try:
                if httpx.get(f"{self.url}/api/healthz", timeout=2).status_code == 200:
                    return
            except httpx.HTTPError:
                time.sleep(0.1)
        log = (self.data / "forge.log").read_text(errors="replace")[-2000:]
        self.stop()
        raise ForgeMissingError(f"the forge did not answer at {self.url} within {START_SECONDS_MAX:.0f} s:\n{log}")

    def stop(self) -> None:
        """SIGTERM, then SIGKILL after STOP_SECONDS_MAX; the data folder stays."""
        if self.process is None:
            return
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(STOP_SECONDS_MAX)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(STOP_SECONDS_MAX)
        self.process = None

    def remove(self) -> None:
        """Stops it and deletes its data."""
        self.stop()
        shutil.rmtree(self.data, ignore_errors=True)
