"""The view on a terminal: who is fine and who is not, how far tasks have come, what may be old."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from robotkube.cli.live import fleet
from robotkube.cli.live.feed import PlatformPicture
from robotkube.cli.live.view import view
from robotkube.cli.live.ways import way
from robotkube.foundation.kubernetes.core.node_agents import NodeAgent
from tests.stages.live_platform import NOW, SECOND, node, plan, pod, task


@pytest.fixture
def picture() -> PlatformPicture:
    picture = PlatformPicture(is_read=True)
    for number in range(3):
        agent = f"vehicle-{number:02}"
        picture.nodes[agent] = fleet.look_at_node(node(agent))
        picture.pods[f"{agent}/b"] = fleet.look_at_pod(pod(f"{agent}/b", "mqtt-bridge"))
    picture.nodes["platform-0"] = fleet.look_at_node(node("platform-0", role="platform"))
    return picture


def drawn(picture: PlatformPicture, lines: int = 40, now: int = NOW) -> str:
    console = Console(file=io.StringIO(), force_terminal=True, width=110, color_system=None)
    console.print(view(picture, now, lines))
    return console.file.getvalue()  # type: ignore[attr-defined,no-any-return]


def test_the_fleet_at_rest(picture: PlatformPicture) -> None:
    assert [line.rstrip() for line in drawn(picture).splitlines()] == [
        "11:06:40  3 of 3 agents ready, 0 tasks",
        "AGENT       ROLE     NODE   PODS  RUNS",
        "vehicle-00  vehicle  ready  1/1   mqtt-bridge",
        "vehicle-01  vehicle  ready  1/1   mqtt-bridge",
        "vehicle-02  vehicle  ready  1/1   mqtt-bridge",
    ]


def test_a_silent_agent_is_silent_since_when_and_stands_on_top(picture: PlatformPicture) -> None:
    picture.nodes["vehicle-02"] = fleet.look_at_node(node("vehicle-02", "Unknown", "2026-11-18T11:05:10Z"))
    picture.nodes["vehicle-01"] = fleet.look_at_node(node("vehicle-01", "False", "2026-11-18T11:05:30Z"))
    picture.pods["vehicle-00/c"] = fleet.look_at_pod(pod("vehicle-00/c", "bag-player", "Pending", ready=False))
    lines = drawn(picture).splitlines()
    assert lines[0].startswith("11:06:40  0 of 3 agents ready")
    assert lines[2].split()[:6] == ["vehicle-00", "vehicle", "ready", "1/2", "bag-player,", "mqtt-bridge"]
    assert "not ready since 11:05:30" in lines[3]
    assert "silent since 11:05:10" in lines[4]
    assert " ?/1 " in lines[4], "its pods are not taken for ready"


def test_a_low_terminal_shows_who_needs_to_be_looked_at_and_counts_the_rest(picture: PlatformPicture) -> None:
    for number in range(3, 100):
        picture.nodes[f"v-{number}"] = fleet.look_at_node(node(f"v-{number}"))
    picture.nodes["v-77"] = fleet.look_at_node(node("v-77", "Unknown"))
    lines = drawn(picture, lines=20).splitlines()
    assert lines[2].startswith("v-77 ")
    assert lines[-1].rstrip() == "and 94 more, 94 of them ready"
    assert len(lines) < 20


def test_agents_that_share_a_node_are_rows_of_their_own_and_that_is_said(picture: PlatformPicture) -> None:
    assert "trial mode" not in drawn(picture)
    shared = node("cloud-0", "Unknown", role="cloud")
    shared["metadata"]["labels"] |= NodeAgent("platform", "platform", frozenset(), 1).labels
    shared["metadata"]["labels"] |= NodeAgent("edge-7", "edge", frozenset(), 2).labels
    picture.nodes["cloud-0"] = fleet.look_at_node(shared)
    lines = drawn(picture).splitlines()
    assert "3 of 5 agents ready" in lines[0]
    assert "trial mode: agents share Nodes (Node cloud-0 is cloud-0, platform, edge-7)" in lines[1]
    silent = [line.split()[:3] for line in lines if "silent" in line]
    assert silent == [["cloud-0", "cloud", "silent"], ["edge-7", "edge", "silent"]], "both are as their Node is"


def test_a_task_that_goes_its_way(picture: PlatformPicture) -> None:
    picture.tasks["cloud-0/one"] = task("one", ("Accepted", "True", "Accepted"))
    picture.plans["p1"] = plan("p1", proposed=0.1, merged=0.4)
    shown = drawn(picture, now=NOW + 3 * SECOND)
    assert "1 task, 1 plan under way" in shown
    assert "cloud-0/one  event 11:06:39  proposed +0.6 s  merged +0.9 s  observed … 4 s" in shown


def test_a_refused_task_says_why_and_awaits_nothing() -> None:
    shown = way("cloud-0/one", task("one", ("Accepted", "False", "NoCapableNode")), [])
    assert shown
    assert (shown.awaits, shown.problem) == ("", "NoCapableNode: words")


def test_what_is_not_read_yet_is_no_empty_fleet() -> None:
    assert drawn(PlatformPicture()).split("\n")[0].rstrip() == "the platform is being read"


def test_what_is_old_says_so(picture: PlatformPicture) -> None:
    picture.problem = "the manager does not answer"
    assert "what is shown may be old: the manager does not answer" in drawn(picture)


def test_rates_and_names_that_look_like_markup(picture: PlatformPicture) -> None:
    picture.rates = {"/vehicles/{agent}/pose": 1500.2, "/[bold]x": 3.0}
    assert "detectors receive /vehicles/{agent}/pose 1500/s, /[bold]x 3/s" in drawn(picture)
