"""Fast tests start no program but Python, git and openssl; a run of pytest on tests that try shows it."""

from __future__ import annotations

import subprocess
import sys
from xml.etree import ElementTree

import pytest

from tests.stages.paths import REPOSITORY

OPERATOR = REPOSITORY / "operator"
ALLOWED = {
    "by_name": "subprocess.run(['git', '--version'], check=True)",
    "as_bytes": "subprocess.run([b'git', b'--version'], check=True)",
    "by_path": "subprocess.run([shutil.which('git'), '--version'], check=True)",
    "openssl": "subprocess.run(['openssl', 'version'], check=True)",
    "python": "subprocess.run([sys.executable, '-c', ''], check=True)",
    "another_python": "subprocess.run(['python3', '-c', ''], check=True)",
    "string": "subprocess.run('git', check=False)",
}
REFUSED = {
    "popen": "subprocess.Popen(['true']).wait()",
    "executable": "subprocess.run(['git'], executable='true')",
    "shell": "subprocess.run('git --version', shell=True)",
    "system": "os.system('git --version')",
    "posix_spawn": "os.waitpid(os.posix_spawn('/bin/true', ['git'], os.environ), 0)",
    "spawn": "os.spawnvp(os.P_WAIT, 'true', ['git'])",
    "pty": "pty.spawn(['true'])",
    "fork": "pid = os.fork() or forked()\n    os.waitpid(pid, 0)",
    "swallowed": "try:\n        subprocess.run(['true'])\n    except BaseException:\n        pass",
}
BEGINNING = """
import os, pty, shutil, subprocess, sys
import pytest

def forked():
    try:
        os.execv("/bin/true", ["git"])
    finally:
        os._exit(0)

@pytest.fixture(params=["setup", "teardown"])
def fixture(request):
    if request.param == "setup":
        subprocess.run(["true"])
    yield
    if request.param == "teardown":
        subprocess.run(["true"])

def test_fixture(fixture):
    pass

@pytest.mark.processes
def test_of_another_tier():
    assert subprocess.run(["true"]).returncode == os.system("true") == 0
"""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Test -> its failures and errors, in a run of pytest with the plugin."""
    folder = tmp_path_factory.mktemp("tests")
    tests = "".join(f"\ndef test_{name}():\n    {text}\n" for name, text in {**ALLOWED, **REFUSED}.items())
    (folder / "test_programs.py").write_text(BEGINNING + tests, encoding="utf-8")
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = processes\n", encoding="utf-8")
    report = folder / "report.xml"
    command = [sys.executable, "-m", "pytest", "-p", "tests.stages.tiers", "-p", "no:cacheprovider"]
    subprocess.run(
        [*command, f"--junitxml={report}", str(folder)], cwd=OPERATOR, capture_output=True, timeout=120, check=False
    )
    cases = ElementTree.parse(report).iter("testcase")  # noqa: S314 - this test's own
    return {
        case.attrib["name"].removeprefix("test_"): "".join(f"{part.tag}: {part.attrib['message']}" for part in case)
        for case in cases
    }


@pytest.mark.parametrize("name", [*ALLOWED, "of_another_tier"])
def test_python_git_and_openssl_are_started_and_in_another_tier_any_program(
    outcomes: dict[str, str], name: str
) -> None:
    assert outcomes[name] == ""


@pytest.mark.parametrize("name", REFUSED)
def test_another_program_is_refused_however_it_is_started(outcomes: dict[str, str], name: str) -> None:
    assert outcomes[name].startswith("failure: ")
    assert outcomes[name].count("a fast test starts no other program; mark its module") == 1


@pytest.mark.parametrize("name", ["fixture[setup]", "fixture[teardown]"])
def test_a_program_that_a_fixture_starts_is_refused(outcomes: dict[str, str], name: str) -> None:
    assert outcomes[name].startswith("error: ")
    assert outcomes[name].count("true: a fast test starts no other program") == 1
