"""The paper's use case, all fifteen vehicles, while every certificate of the platform lives 60 s: those of servers and
those that prove accounts at the broker.

Values give lives of hours, so the chart is a copy whose templates say 60 s; and since kubelets bring a changed Secret
within two minutes, those of this cluster look every 5 s.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from ci import publish
from ci.cluster.embedded.nodes import node_processes
from ci.folders import PROJECT
from ci.installation import CHART, NAMESPACE
from tests.stages.platform.bare_platform import bare_platform, install
from tests.stages.platform.running_platform import SCENARIO, Platform, spoken
from tests.stages.platform.story import Story, play

pytestmark = pytest.mark.thorough

LIFE_SECONDS, SYNC_SECONDS = 60, 5
WRITTEN = "life_seconds: {{ mul (int $tls.hours) 3600 }}"
SERVERS_AND_ACCOUNTS = 2  # places of the templates that say so
RUN_SECONDS_MAX = 900.0
REPLACED_MIN = 2  # the run takes 90 s, and each is replaced every 40 s

Lives = Mapping[str, tuple[str, int]]


@dataclass(frozen=True)
class Played:
    """The run; and of the platform's own pods by UID, their names and restarts before and after it, and how many
    certificates each account had been given."""

    story: Story
    before: Lives
    after: Lives
    given_before: Mapping[str, int]
    given_after: Mapping[str, int]


def short_lived(folder: Path) -> Path:
    """A copy of the platform's chart whose certificates live `LIFE_SECONDS`."""
    chart = folder / CHART.relative_to(PROJECT)
    shutil.copytree(CHART, chart)
    template = chart / "templates" / "_tls.tpl"
    text = template.read_text()
    assert text.count(WRITTEN) == SERVERS_AND_ACCOUNTS
    template.write_text(text.replace(WRITTEN, f"life_seconds: {LIFE_SECONDS}"))
    return chart


def lives(platform: Platform) -> Lives:
    """Names and restarts of the platform's pods that run."""
    return {
        pod["metadata"]["uid"]: (
            pod["metadata"]["name"],
            sum(one["restartCount"] for one in pod["status"].get("containerStatuses", ())),
        )
        for pod in platform.get("-n", NAMESPACE, "pods")["items"]
        if pod["status"]["phase"] == "Running"
    }


def given(platform: Platform) -> Mapping[str, int]:
    """How many certificates the process `certificates` says it has issued, by account."""
    counted: dict[str, int] = {}
    for line in platform.kubectl("-n", NAMESPACE, "logs", "deployment/certificates", "--tail=-1").splitlines():
        entry: dict[str, Any] = json.loads(line) if line.startswith("{") else {}
        if entry.get("event") == "certificate issued" and "account" in entry:
            counted[entry["account"]] = counted.get(entry["account"], 0) + 1
    return counted


@pytest.fixture(scope="module")
def played(pytestconfig: pytest.Config, no_demo: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Played]:
    """The use case on a platform of such certificates."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(node_processes, "SYNC_SECONDS", SYNC_SECONDS)
        with bare_platform(pytestconfig) as platform:
            with spoken(pytestconfig):
                install(platform, short_lived(tmp_path_factory.mktemp("short-lived")))
                publish.publish(platform.installer.kubeconfig)
                before = lives(platform)
                given_before = given(platform)
                story = play(platform, SCENARIO, "", tmp_path_factory.mktemp("story"), RUN_SECONDS_MAX)
            yield Played(story, before, lives(platform), given_before, given(platform))


def test_every_expectation_holds(played: Played) -> None:
    """Nothing is lost or doubled, and latencies are those of every other run."""
    rows = {row["name"]: row for row in played.story.report.get("expectations", ())}
    assert rows, played.story.talk[-3000:]
    assert {name: row["measured"] for name, row in rows.items() if not row["passed"]} == {}
    assert (rows["lost"]["measured"], rows["duplicates"]["measured"]) == (0, 0)
    assert played.story.code == 0


def test_certificates_were_replaced_meanwhile(played: Played) -> None:
    new = {account: played.given_after[account] - count for account, count in played.given_before.items()}
    agents = {pod["metadata"]["namespace"] for pod in played.story.pods.values()}
    assert agents
    assert agents <= set(new)
    assert {account: count for account, count in new.items() if count < REPLACED_MIN} == {}


def test_nobody_started_again_for_it(played: Played) -> None:
    assert played.before
    assert played.after == played.before
