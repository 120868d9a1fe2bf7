"""A real forge (Gitea on SQLite) on a loopback port, for tests: it starts with an empty data folder."""

import atexit
import functools
import os
import secrets
import shutil
import signal
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import httpx

from ci import toolchain
from ci.folders import PROJECT
from tests.stages import http_calls
from tests.stages.programs import SELDOM_COLLECTING, free_port, program

START_SECONDS_MAX = 60.0
STOP_SECONDS_MAX = 10.0
FILES = PROJECT / "charts" / "robotkube" / "files"
HOOKS = FILES / "forge-hooks"
RIGHTS = FILES / "forge-rights.ini"

APP_INI = """\
APP_NAME = forge
RUN_USER = {user}
WORK_PATH = {data}
[server]
HTTP_ADDR = 127.0.0.1
HTTP_PORT = {port}
ROOT_URL = {url}/
LOCAL_ROOT_URL = {url}/
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
PASSWORD_HASH_ALGO = pbkdf2$1000$50
SECRET_KEY = {secret}
INTERNAL_TOKEN = {token}
{rights}
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
[git.config]
core.hooksPath = {hooks}
maintenance.auto = false
[webhook]
ALLOWED_HOST_LIST = loopback,private
"""


class ForgeStartError(RuntimeError):
    """The forge did not start; the message ends with its log."""


ADMINISTRATOR = "administrator"  # of all forges of a process
PASSWORD = secrets.token_hex(12)


@functools.cache
def fresh_data() -> Path:
    """The data folder of a forge with its tables and its administrator. It is made once in a process, since two
    programs make it: what each forge begins with is a copy."""
    folder = Path(tempfile.mkdtemp(prefix="fresh-forge-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    ForgeProcess(folder).make_data()
    return folder


@dataclass
class ForgeProcess:
    """One forge: `start()` makes data folder and administrator and waits until it answers, `stop()` ends it."""

    data: Path
    administrator_password: str = PASSWORD
    administrator: str = ADMINISTRATOR
    port: int = field(default_factory=free_port)
    process: subprocess.Popen[bytes] | None = None
    environment: dict[str, str] = field(default_factory=dict)
    static: Path | None = None  # with what its pages load; None: as its module has it

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def _run(self, *arguments: str) -> str:
        command = [program("gitea"), "--config", str(self.data / "app.ini"), *arguments]
        answer = subprocess.run(
            command, env=self._environment(), capture_output=True, text=True, timeout=120, check=False
        )
        if answer.returncode:
            raise ForgeStartError(f"gitea {' '.join(arguments[:3])}: {answer.stdout[-500:]}{answer.stderr[-500:]}")
        return answer.stdout.strip()

    def _environment(self) -> dict[str, str]:
        return {
            "PATH": os.environ.get("PATH", ""),
            "HOME": str(self.data),
            "GITEA_I_AM_BEING_UNSAFE_RUNNING_AS_ROOT": "true",
            "FORGE_PROGRAM": program("gitea"),
            "FORGE_HOOK": program("forge-hook"),
            "FORGE_CONFIG": str(self.data / "app.ini"),
            **SELDOM_COLLECTING,
            **self.environment,
        }

    def start(self) -> None:
        """Raises ForgeStartError when it does not answer within START_SECONDS_MAX."""
        if not (self.data / "app.ini").exists():
            shutil.copytree(fresh_data(), self.data, dirs_exist_ok=True)
            self._write_configuration()
        log = (self.data / "forge.log").open("ab")
        command = [program("gitea"), "--config", str(self.data / "app.ini"), "web"]
        self.process = subprocess.Popen(command, env=self._environment(), stdout=log, stderr=log)
        log.close()
        self._wait_until_it_answers()

    def make_data(self) -> None:
        """Tables and administrator, in a folder that is there and empty."""
        self._write_configuration()
        self._run("migrate")
        self._run(
            *("admin", "user", "create", "--admin", "--username", self.administrator),
            *("--password", self.administrator_password, "--email", "administrator@forge.invalid"),
            "--must-change-password=false",
        )

    def _write_configuration(self) -> None:
        user = subprocess.run(["id", "-un"], capture_output=True, text=True, check=True).stdout.strip()
        static = self.static or toolchain.gitea_static("templates").parent
        text = APP_INI.format(
            user=user, data=self.data, port=self.port, url=self.url, static=static,
            secret=secrets.token_hex(32), token=secrets.token_hex(32), hooks=HOOKS, rights=RIGHTS.read_text().strip(),
        )  # fmt: skip
        (self.data / "app.ini").write_text(text)

    def _wait_until_it_answers(self) -> None:
        end = time.monotonic() + START_SECONDS_MAX
        while time.monotonic() < end:
            if self.process is None or self.process.poll() is not None:
                break
            try:
                if http_calls.get(f"{self.url}/api/healthz", timeout=2).status_code == 200:
                    return
            except httpx.HTTPError:
                time.sleep(0.1)
        log = (self.data / "forge.log").read_text(errors="replace")[-2000:]
        self.stop()
        raise ForgeStartError(f"the forge did not answer at {self.url} within {START_SECONDS_MAX:.0f} s:\n{log}")

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
