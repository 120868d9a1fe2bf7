"""`robotkube open`: the console's address of what is named, or the forge's, or the command that shows the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.cli.cluster import opening
from robotkube.errors import InputError
from tests.stages.live_platform import plan, pod, task

CONSOLE = "http://10.96.0.7:8080"
FORGE = "http://10.96.0.9:3000"


class PlatformInMemory:
    """What the command asks of a platform."""

    def __init__(self, services: Mapping[str, tuple[str, int]]) -> None:
        self.services = dict(services)

    def address(self, service: str) -> tuple[str, int]:
        if service not in self.services:
            raise InputError(f"no Service {service}")
        return self.services[service]

    def page(self, path: str) -> Mapping[str, Any]:
        known = plan("20261118-1", pull_request=4, commit="07a9365612abcdef07a9365612abcdef07a93656")
        return {"plans": [known, plan("20261118-2", tasks=[], events=[])]}

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        return [task("one")]

    def pods(self) -> Sequence[Mapping[str, Any]]:
        return [pod("cloud-0/recorder-1", "recorder")]


@pytest.fixture
def platform(monkeypatch: pytest.MonkeyPatch) -> PlatformInMemory:
    platform = PlatformInMemory({"robotkube-console": ("10.96.0.7", 8080), "forge": ("10.96.0.9", 3000)})
    monkeypatch.setattr(opening, "Platform", lambda options: platform)
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
        (["why", "cloud-0/one"], "/why/task/cloud-0/one"),
        (["why", "e1"], "/why/event/e1"),
        (["why", "0" * 32], f"/why/event/{'0' * 32}"),
        (["why", "20261118-1"], "/why/plan/20261118-1"),
        (["why", "cloud-0/recorder-1"], "/why/pod/cloud-0/recorder-1"),
        (["why", "cloud-0/recorder"], "/why/release/cloud-0/recorder"),
        (["why", "07a93656"], "/why/commit/07a93656"),
        (["plan", "4"], "/why/plan/20261118-1"),
        (["plan", "#4"], "/why/plan/20261118-1"),
        (["recording", "recorder 7"], "/why/recording/recorder%207"),
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
    platform.services["robotkube-console"] = ("10.96.0.7", 8443)
    assert cli.main(["open"]) == cli.EXIT_DONE
    assert capsys.readouterr().out == "https://fleet.example.com/\nhttps://10.96.0.7:8443/\n"


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
    del platform.services["robotkube-console"]
    assert cli.main(["open", *words]) == cli.EXIT_REFUSED
    out, err = capsys.readouterr()
    assert out == ""
    assert "there is no console: namespace robotkube has no Service robotkube-console" in err
    assert instead in err
    assert opened == []


def test_without_a_console_a_plan_is_seen_at_the_forge(
    platform: PlatformInMemory, opened: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    del platform.services["robotkube-console"]
    assert cli.main(["open", "plan", "4"]) == cli.EXIT_DONE
    out, err = capsys.readouterr()
    assert opened == [out.strip()] == [f"{FORGE}/robotkube/deployment/pulls/4"]
    assert "this is the forge's page of the plan" in err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["why"], cli.EXIT_USAGE, "open why: name which one, such as `robotkube open why cloud-0/meeting`"),
        (["fleet", "x"], cli.EXIT_USAGE, "the fleet has no ID"),
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
