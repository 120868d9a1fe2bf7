"""`robotkube open`: the console's address of what is named, or the forge's, or the command that shows the same."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator, Mapping, Sequence
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.cli.cluster import opening
from robotkube.errors import InputError
from tests.stages.live_platform import plan, pod, task

CONSOLE = "http://10.96.0.7:8080"
FORGE = "http://10.96.0.9:3000"
INSIDE = "http://forge.robotkube.svc.cluster.local:3000/robotkube/deployment/pulls/4"


class PlatformInMemory:
    """What the command asks of a platform."""

    def __init__(self, services: Mapping[str, tuple[str, int]]) -> None:
        self.services = dict(services)
        self.viewers: set[str] = set()
        self.console: dict[str, Any] = {"anybody_reads": True}

    def settings(self, process: str) -> Mapping[str, Any]:
        assert process == "console"
        return self.console

    def address(self, service: str) -> tuple[str, int]:
        if service not in self.services:
            raise InputError(f"no Service {service}")
        return self.services[service]

    def forge_url(self) -> str:
        host, port = self.address("forge")
        return f"http://{host}:{port}"

    def forge_secret(self, account: str) -> str:
        return f"-n robotkube get secret forge-account-{account}" if account in self.viewers else ""

    def page(self, path: str) -> Mapping[str, Any]:
        known = plan("20261118-1", pull_request=4, commit="07a9365612abcdef07a9365612abcdef07a93656", url=INSIDE)
        return {"plans": [known, plan("20261118-2", tasks=[], events=[])]}

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        return [task("one")]

    def pods(self) -> Sequence[Mapping[str, Any]]:
        return [pod("cloud-0/recorder-1", "recorder")]


@pytest.fixture
def platform(monkeypatch: pytest.MonkeyPatch) -> PlatformInMemory:
    platform = PlatformInMemory({"console": ("10.96.0.7", 8080), "forge": ("10.96.0.9", 3000)})
    monkeypatch.setattr(opening, "Platform", lambda options: platform)
    monkeypatch.setattr(opening, "lacks_pages", lambda forge: False)
    return platform


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    opened: list[str] = []
    monkeypatch.setattr(opening.webbrowser, "open", lambda address: opened.append(address) or True)
    return opened


@pytest.mark.parametrize(
    ("words", "path"),
    [
        ([], "/"),
        (["fleet"], "/"),
        (["why", "cloud-0/one"], "/#/why/task/cloud-0/one"),
        (["why", "e1"], "/#/why/event/e1"),
        (["why", "0" * 32], f"/#/why/event/{'0' * 32}"),
        (["why", "20261118-1"], "/#/why/plan/20261118-1"),
        (["why", "cloud-0/recorder-1"], "/#/why/pod/cloud-0/recorder-1"),
        (["why", "cloud-0/recorder"], "/#/why/release/cloud-0/recorder"),
        (["why", "07a93656"], "/#/why/commit/07a93656"),
        (["plan", "4"], "/#/why/plan/20261118-1"),
        (["plan", "#4"], "/#/why/plan/20261118-1"),
        (["recording", "encounter-3e07ce"], "/#/recordings/encounter-3e07ce"),
    ],
)
def test_the_consoles_address_is_printed_and_opened(
    platform: PlatformInMemory,
    opened: list[str],
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    path: str,
) -> None:
    assert cli.main(["open", *words]) == cli.EXIT_DONE
    assert capsys.readouterr() == (f"{CONSOLE}{path}\n", "")
    assert opened == [f"{CONSOLE}{path}"]


def test_it_is_only_printed_when_that_is_asked_for(platform: PlatformInMemory, opened: list[str]) -> None:
    assert cli.main(["open", "--print"]) == cli.EXIT_DONE
    assert opened == []


def test_a_machine_without_a_browser(
    platform: PlatformInMemory, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(opening.webbrowser, "open", lambda address: False)
    assert cli.main(["open"]) == cli.EXIT_DONE
    assert capsys.readouterr() == (
        f"{CONSOLE}/\n",
        "robotkube: no browser could be opened here; open the address yourself\n",
    )


def test_a_console_behind_an_ingress_or_with_tls(
    platform: PlatformInMemory, opened: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["open", "--console-url", "https://fleet.example.com/"]) == cli.EXIT_DONE
    platform.services["console"] = ("10.96.0.7", 8443)
    assert cli.main(["open"]) == cli.EXIT_DONE
    assert capsys.readouterr().out == "https://fleet.example.com/\nhttps://10.96.0.7:8443/\n"


def test_where_people_sign_in_the_consoles_own_address_is_opened(platform: PlatformInMemory, opened: list[str]) -> None:
    platform.console = {"sign_in": {"url": "https://fleet.example.com"}}
    assert cli.main(["open", "why", "e1"]) == cli.EXIT_DONE
    assert opened == ["https://fleet.example.com/#/why/event/e1"]


def test_a_console_that_answers_forwards_alone_is_opened_when_there_is_one(
    platform: PlatformInMemory, opened: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    platform.console = {"by_forward": True}
    with socket.create_server(("127.0.0.1", 0)) as forward:
        port = forward.getsockname()[1]
        platform.services["console"] = ("10.96.0.7", port)
        assert cli.main(["open"]) == cli.EXIT_DONE
    assert capsys.readouterr() == (f"http://localhost:{port}/\n", "")
    assert opened == [f"http://localhost:{port}/"]
    assert cli.main(["open", "--context", "a"]) == cli.EXIT_DONE
    out, err = capsys.readouterr()
    assert out == f"http://localhost:{port}/\n"
    command = f"kubectl --context a -n robotkube port-forward service/console {port}"
    assert err == f"robotkube: nothing answers there: run `{command}`, and keep it running\n"
    assert len(opened) == 1


@pytest.mark.parametrize(
    ("words", "instead"),
    [
        ([], "`robotkube watch` shows the fleet in the terminal"),
        (["why", "cloud-0/one"], "`robotkube trace cloud-0/one` lists the same in the terminal"),
        (["recording", "r1"], "`robotkube recording show r1` shows it in the terminal"),
        (["plan", "20261118-2"], "and plan 20261118-2 has no pull request yet"),
    ],
)
def test_without_a_console_it_says_what_shows_the_same(
    platform: PlatformInMemory,
    opened: list[str],
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    instead: str,
) -> None:
    del platform.services["console"]
    assert cli.main(["open", *words]) == cli.EXIT_REFUSED
    out, err = capsys.readouterr()
    assert out == ""
    assert "there is no console: namespace robotkube has no Service console" in err
    assert instead in err
    assert opened == []


def test_without_a_console_a_plan_is_seen_at_the_forge(
    platform: PlatformInMemory, opened: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    del platform.services["console"]
    assert cli.main(["open", "plan", "4"]) == cli.EXIT_DONE
    out, err = capsys.readouterr()
    assert opened == [out.strip()] == [f"{FORGE}/robotkube/deployment/pulls/4"]
    assert "this is the forge's page of the plan" in err
    assert "make web" not in err
    assert "sign in" not in err


def test_the_forges_page_is_had_beside_a_console(
    platform: PlatformInMemory, opened: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """At the Service's address: its name, which the forge gives, is known in the cluster alone."""
    platform.viewers.add("viewer")
    assert cli.main(["open", "plan", "4", "--forge"]) == cli.EXIT_DONE
    out, err = capsys.readouterr()
    assert opened == [out.strip()] == [f"{FORGE}/robotkube/deployment/pulls/4"]
    assert "sign in as viewer; the password: kubectl -n robotkube get secret forge-account-viewer -o json" in err


def test_a_forge_outside_the_cluster_says_where_its_page_is(platform: PlatformInMemory, opened: list[str]) -> None:
    del platform.services["forge"]
    assert cli.main(["open", "plan", "4", "--forge"]) == cli.EXIT_DONE
    assert opened == [INSIDE]


def test_a_forge_that_was_built_without_its_pages_says_what_builds_them(
    platform: PlatformInMemory, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(opening, "lacks_pages", lambda forge: forge == FORGE)
    assert cli.main(["open", "plan", "4", "--forge", "--print"]) == cli.EXIT_DONE
    said = "`make web` builds them, the next `make demo` serves them; `robotkube trace 20261118-1` shows the plan here"
    assert said in capsys.readouterr().err


@pytest.fixture
def forge() -> Iterator[tuple[str, set[str]]]:
    """The address of a server, and the paths that it has."""
    paths: set[str] = set()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200 if self.path in paths else 404)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", paths
        server.shutdown()
        thread.join()


def test_whether_a_forge_has_its_pages_is_asked(forge: tuple[str, set[str]]) -> None:
    address, paths = forge
    assert opening.lacks_pages(address)
    paths.add("/assets/licenses.txt")
    assert not opening.lacks_pages(address)
    assert not opening.lacks_pages("http://127.0.0.1:9")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["why"], cli.EXIT_USAGE, "open why: name which one, such as `robotkube open why cloud-0/meeting`"),
        (["fleet", "x"], cli.EXIT_USAGE, "the fleet has no ID"),
        (["fleet", "--forge"], cli.EXIT_USAGE, "open fleet --forge: the forge has pages of plans alone"),
        (["plan", "20261118-2", "--forge"], cli.EXIT_REFUSED, "plan 20261118-2 has no pull request yet"),
        (["why", "nothing"], cli.EXIT_REFUSED, "no event, task, plan, pod, release or commit nothing is known"),
        (["plan", "99"], cli.EXIT_REFUSED, "the manager remembers no plan 99"),
    ],
)
def test_what_is_not_there_is_refused(
    platform: PlatformInMemory, opened: list[str], capsys: pytest.CaptureFixture[str], words: list[str], code: int,
    said: str,
) -> None:  # fmt: skip
    assert cli.main(["open", *words]) == code
    assert said in capsys.readouterr().err
    assert opened == []
