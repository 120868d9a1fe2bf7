"""The small program as the forge's hooks: it says what Gitea's own says, and refuses whatever it cannot ask about."""

from __future__ import annotations

import os
import random
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from tests.stages import http_calls
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.programs import free_port, program

pytestmark = pytest.mark.toolchain

ZERO = "0" * 40
KINDS = ("pre-receive", "post-receive", "proc-receive")
RANDOM_STREAMS = 200
HOOK_SECONDS_MAX = 10
FILLED_SECONDS_MAX = 10.0


def git(folder: Path, *arguments: str, code: int = 0) -> str:
    environment = {**os.environ, "GIT_CONFIG_GLOBAL": os.devnull, "GIT_TERMINAL_PROMPT": "0"}
    command = ["git", "-c", "user.name=a", "-c", "user.email=a@a.invalid", *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == code, done.stderr
    return done.stdout + done.stderr


@dataclass(frozen=True)
class Stage:
    """A forge whose hooks run by one of the two programs, and a clone with one commit on main."""

    forge: ForgeProcess
    clone: Path

    @property
    def account(self) -> tuple[str, str]:
        return self.forge.administrator, self.forge.administrator_password

    def api(self, method: str, path: str, **body: object) -> httpx.Response:
        url = f"{self.forge.url}/api/v1/{path}"
        return http_calls.request(method, url, auth=self.account, json=body or None, timeout=30).raise_for_status()

    def commit(self, text: str) -> str:
        (self.clone / "file").write_text(text)
        git(self.clone, "add", "file")
        git(self.clone, "commit", "-q", "-m", text)
        return git(self.clone, "rev-parse", "HEAD").strip()


@pytest.fixture(scope="module", params=["forge-hook", pytest.param("gitea", marks=pytest.mark.thorough)])
def stage(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("forge")
    hook = program("forge-hook") if request.param == "forge-hook" else str(folder / "none")
    forge = ForgeProcess(folder / "data", environment={"FORGE_HOOK": hook})
    forge.start()
    (folder / "clone").mkdir()
    made = Stage(forge, folder / "clone")
    made.api("POST", "user/repos", name="r", default_branch="main")
    git(made.clone, "init", "-q", "-b", "main")
    remote = forge.url.replace("//", f"//{forge.administrator}:{forge.administrator_password}@")
    git(made.clone, "remote", "add", "origin", f"{remote}/{forge.administrator}/r.git")
    made.commit("first")
    git(made.clone, "push", "-q", "origin", "main")
    deadline = time.monotonic() + FILLED_SECONDS_MAX
    while made.api("GET", f"repos/{forge.administrator}/r").json()["empty"]:  # the forge notes it after the push
        assert time.monotonic() < deadline
        time.sleep(0.05)
    yield made
    forge.remove()


def test_a_push_arrives_and_its_branch_is_offered_for_a_pull_request(stage: Stage) -> None:
    head = stage.commit("second")
    said = git(stage.clone, "push", "origin", "main", "main:topic")
    assert "Create a new pull request for 'topic':" in said
    assert f"{stage.forge.url}/{stage.forge.administrator}/r/pulls/new/topic" in said
    branches = stage.api("GET", f"repos/{stage.forge.administrator}/r/branches").json()
    assert {branch["name"]: branch["commit"]["id"] for branch in branches} == {"main": head, "topic": head}


def test_a_proposal_becomes_a_pull_request_with_its_words(stage: Stage) -> None:
    git(stage.clone, "checkout", "-q", "-B", "work", "origin/main")
    head = stage.commit("proposed")
    words = ["-o", "topic=plan", "-o", "title=A plan", "-o", "description=a=b and more"]
    said = git(stage.clone, "push", "origin", f"{head}:refs/for/main", *words)
    [pull] = stage.api("GET", f"repos/{stage.forge.administrator}/r/pulls").json()
    assert (pull["title"], pull["body"], pull["head"]["sha"]) == ("A plan", "a=b and more", head)
    assert "Visit the existing pull request:" in said or "Create a new pull request" in said
    assert pull["html_url"] in said
    refused = git(stage.clone, "push", "origin", f"{head}:refs/for/nothing", *words, code=1)
    assert "pre-receive hook declined" in refused
    git(stage.clone, "checkout", "-q", "main")


def test_a_protected_branch_stays(stage: Stage) -> None:
    stage.api("POST", f"repos/{stage.forge.administrator}/r/branch_protections", rule_name="kept", enable_push=False)
    git(stage.clone, "checkout", "-q", "main")
    stage.commit("third")
    refused = git(stage.clone, "push", "origin", "main:kept", code=1)
    assert "Not allowed to push to protected branch kept" in refused
    assert "pre-receive hook declined" in refused
    refused = git(stage.clone, "push", "origin", "+main:refs/pull/1/head", code=1)
    assert "[remote rejected]" in refused


def ask(kind: str, given: bytes, folder: Path, **environment: str) -> tuple[int, str]:
    """Exit code and errors of the program in an empty repository."""
    variables = {"PATH": os.environ["PATH"], "FORGE_CONFIG": str(folder / "app.ini"), **environment}
    done = subprocess.run(
        [program("forge-hook"), kind],
        input=given, cwd=folder, env=variables, capture_output=True, timeout=HOOK_SECONDS_MAX, check=False,
    )  # fmt: skip
    return done.returncode, done.stderr.decode()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    git(tmp_path, "init", "-q", "--bare", ".")
    (tmp_path / "app.ini").write_text(
        f"[server]\nLOCAL_ROOT_URL = http://127.0.0.1:{free_port()}/\n[security]\nINTERNAL_TOKEN = x\n"
    )
    return tmp_path


PUSHED = {"SSH_ORIGINAL_COMMAND": "gitea-internal", "GITEA_REPO_USER_NAME": "u", "GITEA_REPO_NAME": "r"}
MOVED = f"{ZERO} {'1' * 40} refs/heads/main\n".encode()
GREETING = b"000eversion=1\n00000000"


@pytest.mark.parametrize("kind", KINDS)
def test_what_did_not_come_through_the_forge_is_refused(folder: Path, kind: str) -> None:
    code, said = ask(kind, MOVED, folder)
    assert (code, "did not come through the forge" in said) == (1, True)
    internal = ask(kind, MOVED, folder, GITEA_INTERNAL_PUSH="true")[0]
    assert internal == (1 if kind == "proc-receive" else 0)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("[server]\n[security]\nINTERNAL_TOKEN = x\n", "app.ini: [server] LOCAL_ROOT_URL is missing"),
        ("[server]\nLOCAL_ROOT_URL = http://127.0.0.1:1/\n", "app.ini: [security] INTERNAL_TOKEN is missing"),
        (None, "the forge's settings: open"),
    ],
)
def test_settings_that_lack_something_are_named(folder: Path, text: str | None, found: str) -> None:
    (folder / "app.ini").unlink()
    if text is not None:
        (folder / "app.ini").write_text(text)
    code, said = ask("pre-receive", MOVED, folder, **PUSHED)
    assert (code, found in said) == (1, True), said


@pytest.mark.parametrize(
    ("kind", "given"), [("pre-receive", MOVED), ("post-receive", MOVED), ("proc-receive", GREETING)]
)
def test_a_forge_that_does_not_answer_is_a_refusal(folder: Path, kind: str, given: bytes) -> None:
    code, said = ask(kind, given, folder, **PUSHED)
    assert (code, "the forge does not answer its hook" in said) == (1, True), said


@pytest.mark.parametrize(
    ("kind", "given", "found"),
    [
        ("pre-receive", b"one two\n", "is not `<old> <new> <reference>`"),
        ("proc-receive", b"", "git ended in the middle"),
        ("proc-receive", b"000eversion=2\n0000", 'git speaks "version=2'),
        ("proc-receive", b"0000", "greeting is not one line"),
        ("proc-receive", b"0003", 'packet of length "0003"'),
        ("proc-receive", b"fffffff", 'packet of length "ffff"'),
        ("proc-receive", b"000eversion=1\n00000007a b0000", "is not `<old> <new> <reference>`"),
    ],
)
def test_what_git_would_never_say_is_refused(folder: Path, kind: str, given: bytes, found: str) -> None:
    code, said = ask(kind, given, folder, **PUSHED)
    assert (code, found in said) == (1, True), said


def test_random_streams_end_in_a_refusal(folder: Path) -> None:
    chosen = random.Random(1)  # noqa: S311 - not for secrets
    for _ in range(RANDOM_STREAMS):
        given = bytes(chosen.choices(b"0123456789abcdef \n\0version=", k=chosen.randrange(200)))
        code, said = ask("proc-receive", chosen.choice((b"", b"000eversion=1\n0000")) + given, folder, **PUSHED)
        assert code == 1
        assert "panic" not in said
