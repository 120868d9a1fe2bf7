"""The command line on a real API server: data on stdout, talk on stderr, exit codes."""

import json

import pytest
from api_calls import Api
from api_server import ApiServerProcess

from robotkube.entrypoints.cli import main


class Line:
    """Runs commands with access to the test's server."""

    def __init__(self, server: ApiServerProcess, capture: pytest.CaptureFixture[str]) -> None:
        self._access, self._capture = ["--kubeconfig", str(server.kubeconfig)], capture

    def run(self, *words: str) -> tuple[int, str, str]:
        code = main([*words[:2], *self._access, *words[2:]])
        out, err = self._capture.readouterr()
        return code, out, err


@pytest.fixture
def line(server: ApiServerProcess, capsys: pytest.CaptureFixture[str]) -> Line:
    return Line(server, capsys)


def test_tasks(line: Line, api: Api) -> None:
    code, out, _ = line.run("task", "list")
    assert (code, out.split()) == (0, ["TASK", "APPLICATION", "STATE", "REASON", "PLAN", "PULL", "REQUEST"])
    api.task("one", reason="near")
    code, out, _ = line.run("task", "list")
    assert out.splitlines()[1].split() == ["cloud-0/one", "recording", "New", "near", "-", "-"]
    code, out, _ = line.run("task", "list", "--output", "json")
    assert json.loads(out)["tasks"][0]["task"] == "cloud-0/one"
    code, out, _ = line.run("task", "show", "cloud-0/one", "--output", "yaml")
    assert "application: recording" in out
    code, out, err = line.run("task", "withdraw", "cloud-0/one", "--dry-run")
    assert (code, out, err) == (0, "", "would withdraw: cloud-0/one\n")
    assert line.run("task", "withdraw", "cloud-0/one")[0] == 0
    code, out, err = line.run("task", "show", "cloud-0/one")
    assert code == 1
    assert "there is no task cloud-0/one" in err


def test_releases_without_any(line: Line) -> None:
    assert line.run("release", "list")[0] == 0


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("task", "show", "one"), 2, "must be <namespace>/<name>"),
        (("plan", "list"), 2, "no Service manager in namespace robotkube"),
        (("registry", "search", "--platform", "--platform-namespace", "elsewhere"), 2, "in namespace elsewhere"),
    ],
)
def test_wrong_usage(line: Line, words: tuple[str, ...], code: int, text: str) -> None:
    found, out, err = line.run(*words)
    assert (found, out) == (code, "")
    assert text in err


def test_submitting_finds_forge_account_and_images_in_the_cluster(line: Line, api: Api) -> None:
    """The forge of this cluster does not answer: what is asked of the cluster comes first, then nothing was sent."""
    words = ("registry", "submit", "mqtt-bridge", "--platform-namespace", "submitting", "--wait", "0")
    code, _, err = line.run(*words)
    assert (code, "no Service forge in namespace submitting" in err) == (2, True)
    api.post("/api/v1/namespaces", {"metadata": {"name": "submitting"}})
    core = "/api/v1/namespaces/submitting"
    api.post(f"{core}/services", {"metadata": {"name": "forge"}, "spec": {"ports": [{"port": 3000}]}})
    code, _, err = line.run(*words)
    assert (code, "no Secret forge-account-publisher in namespace submitting" in err) == (2, True)
    account = {"username": "publisher", "password": "p"}
    api.post(f"{core}/secrets", {"metadata": {"name": "forge-account-publisher"}, "stringData": account})
    code, _, err = line.run(*words)
    assert code == 2
    assert "spec.images: no reference of ros (known: none); give its reference in the file of --images" in err
    data = {"images.yaml": "platform: host/platform@sha256:1\n"}
    api.post(f"{core}/configmaps", {"metadata": {"name": "platform-images"}, "data": data})
    code, _, err = line.run(*words)
    assert code == 2
    assert "(known: platform)" in err


def test_an_unreachable_cluster(tmp_path: object, server: ApiServerProcess, capsys: pytest.CaptureFixture[str]) -> None:
    text = server.kubeconfig.read_text().replace(f":{server.port}", ":1")
    path = server.folder / "nowhere"
    path.write_text(text)
    assert main(["task", "list", "--kubeconfig", str(path)]) == 3
    assert "Connection refused" in capsys.readouterr().err


def test_grammar(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["task", "paint"])
    assert caught.value.code == 2
    assert "paint" in capsys.readouterr().err
