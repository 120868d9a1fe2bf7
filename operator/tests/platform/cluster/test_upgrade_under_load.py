"""The platform upgraded from an older chart while two vehicles are recorded, and brought back by `helm rollback` before
they part: robots go on in the pods that they had, and the recording has everything, or its audit names what a broker's
restart took.

Each way is played on the same cluster `test`, which is made for these tests and goes with them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import pytest
import yaml

from ci import publish
from ci.installation import ARGOCD, CHART, GATE, INSTALL_TIMEOUT_SECONDS, NAMESPACE
from scenarios.runner.platform.access import pod_ready
from tests.stages.platform.bare_platform import bare_platform, install
from tests.stages.platform.older_charts import (
    COLUMN,
    DEFINITIONS,
    PRESENT_VALUES,
    WAYS,
    Older,
    columns,
    older_chart,
    versions,
)
from tests.stages.platform.running_platform import SCENARIO, Platform, eventually, spoken
from tests.stages.platform.story import Story, play

pytestmark = pytest.mark.thorough

VARIANT = "upgraded"
INSTANCE = "app.kubernetes.io/instance"
CLOUD, RECORDER = "cloud-0", "recorder-vehicle-00-vehicle-01"
RECORDER_SECONDS_MAX = 900.0  # the bags of the long encounter are made first, and players and bridges start
RUN_SECONDS_MAX = 1800.0
SETTLED_SECONDS_MAX = 300.0  # the older chart's hooks are not made again by a rollback: everybody polls
VEHICLES = ("vehicle-00", "vehicle-01")
TURNS = 2
UNDER_WAY_MAX = 10  # poses of a vehicle in one frame or two
POSES_SHARE_MIN = 0.95
POSE_HZ_MIN = 50.0


Life = tuple[str, int]


@dataclass(frozen=True)
class Seen:
    """The platform at a moment: release (or component) and restarts of the pods of all releases and of the broker by
    UID, the tasks' demands by UID, and the definitions that the API server has, beside those of the chart that Helm has
    installed."""

    robots: Mapping[str, Life]
    broker: Mapping[str, Life]
    tasks: Mapping[str, Any]
    columns: Sequence[str]
    definitions: Mapping[str, Any]
    of_the_chart: Mapping[str, Any]


@dataclass(frozen=True)
class Played:
    """A run, and the platform while its recorder runs: with the older chart, upgraded, and back again."""

    older: Older
    story: Story
    before: Seen
    upgraded: Seen
    back: Seen

    def measured(self, name: str) -> Any:
        """What the report says of an expectation; it is an error when it could not be measured."""
        rows = {row["name"]: row["measured"] for row in self.story.report.get("expectations", ())}
        assert rows.get(name) is not None, f"{name} of {sorted(rows)}\n{self.story.talk[-3000:]}"
        return rows[name]


def look(platform: Platform) -> Seen:
    """The platform as it is now."""
    tasks = platform.get("taskdescriptions", "-A")["items"]
    definitions = platform.get("customresourcedefinitions", *DEFINITIONS)["items"]
    manifest = platform.installer.helm("get", "manifest", NAMESPACE, "-n", NAMESPACE)
    return Seen(
        lives(platform.get("pods", "-A", "-l", "robotkube.io/agent")["items"]),
        lives(platform.get("-n", NAMESPACE, "pods", "-l", "app.kubernetes.io/name=broker")["items"]),
        {task["metadata"]["uid"]: task["spec"] for task in tasks},
        columns(platform),
        versions(definitions),
        versions(one for one in yaml.load_all(manifest, Loader=yaml.CSafeLoader) if one),
    )


def lives(pods: Sequence[Mapping[str, Any]]) -> dict[str, Life]:
    """Of each pod by its UID, `<namespace>/<name>` of its release or component, and how often its containers were
    started again."""
    return {
        pod["metadata"]["uid"]: (
            f"{pod['metadata']['namespace']}/{pod['metadata']['labels'][INSTANCE]}",
            sum(one["restartCount"] for one in pod["status"].get("containerStatuses", ())),
        )
        for pod in pods
    }


def recorder_runs(platform: Platform) -> bool:
    """Return whether the recorder of the encounter is ready."""
    return any(
        pod_ready(pod) for pod in platform.access.pods(CLOUD) if (pod.metadata.labels or {}).get(INSTANCE) == RECORDER
    )


def go_back(platform: Platform) -> None:
    """`helm rollback`, until everything is rolled out."""
    platform.installer.helm("rollback", NAMESPACE, "-n", NAMESPACE, "--timeout", f"{INSTALL_TIMEOUT_SECONDS}s")
    for namespace in (NAMESPACE, GATE, ARGOCD):
        platform.installer.rollout(namespace)


def there_and_back(platform: Platform) -> tuple[Seen, Seen, Seen]:
    """The upgrade as soon as the recorder runs, and the rollback after it; the platform before, between and after."""
    eventually("the recorder runs", lambda: recorder_runs(platform), RECORDER_SECONDS_MAX)
    before = look(platform)
    install(platform, CHART, PRESENT_VALUES)
    upgraded = look(platform)
    go_back(platform)
    return before, upgraded, look(platform)


@pytest.fixture(scope="module")
def bare(pytestconfig: pytest.Config, no_demo: None) -> Iterator[Platform]:
    """A cluster with Argo CD, on which the platform is not installed yet."""
    with bare_platform(pytestconfig, VARIANT) as platform:
        yield platform


@pytest.fixture(scope="module", params=WAYS.values(), ids=list(WAYS))
def played(
    request: pytest.FixtureRequest,
    pytestconfig: pytest.Config,
    bare: Platform,
    tmp_path_factory: pytest.TempPathFactory,
) -> Played:
    """The older chart installed, and the long encounter played on it while it is upgraded and brought back."""
    older: Older = request.param
    chart = older_chart(tmp_path_factory.mktemp("older"), older.commit)
    with spoken(pytestconfig), ThreadPoolExecutor(max_workers=1) as beside:
        install(bare, chart)
        publish.publish(bare.installer.kubeconfig)
        turns = beside.submit(there_and_back, bare)
        story = play(bare, SCENARIO, VARIANT, tmp_path_factory.mktemp("story"), RUN_SECONDS_MAX)
    return Played(older, story, *turns.result())


def test_robots_go_on_in_the_pods_that_they_had(played: Played) -> None:
    """The recorder among them, so the encounter lasted longer than both turns."""
    releases = {release for release, _ in played.before.robots.values()}
    assert releases >= {f"{vehicle}/{name}" for vehicle in VEHICLES for name in ("mqtt-bridge", "bag-player")}
    assert releases >= {f"{CLOUD}/{name}" for name in ("mqtt-bridge", "event-detector", RECORDER)}
    assert played.upgraded.robots == played.before.robots
    assert played.back.robots == played.before.robots


def test_definitions_are_those_of_the_chart_and_tasks_stay(played: Played) -> None:
    assert COLUMN not in played.before.columns
    assert COLUMN in played.upgraded.columns
    assert COLUMN not in played.back.columns
    for seen in (played.before, played.upgraded, played.back):
        assert set(seen.of_the_chart) == set(DEFINITIONS)
        assert seen.definitions == seen.of_the_chart
    assert len(played.before.tasks) == 1
    assert played.upgraded.tasks == played.before.tasks
    assert played.back.tasks == played.before.tasks


def test_the_broker_restarts_where_its_pod_is_another_one(played: Played) -> None:
    moments = [played.before.broker, played.upgraded.broker, played.back.broker]
    assert [len(pods) for pods in moments] == [1, 1, 1]
    assert len({next(iter(pods)) for pods in moments}) == (3 if played.older.broker_restarts else 1)
    assert {restarts for pods in moments for _, restarts in pods.values()} == {0}


def test_one_recording_went_on_and_its_audit_is_complete(played: Played) -> None:
    assert played.measured("encounters") == 1
    assert played.measured("recordings") == 1
    assert played.measured("audit_complete") is True
    assert played.measured("releases_had_evidence") is True
    assert played.measured("duplicates") == 0
    assert played.measured("payloads_equal") is True
    assert played.measured("transforms_in_every_recording") is True
    assert played.measured("poses_recorded_share") >= POSES_SHARE_MIN


def test_nothing_is_lost_that_is_not_named(played: Played) -> None:
    """Where the broker restarts, clouds of the time that it is away may be lost: bridges keep 2 s of them."""
    assert played.measured("missing_unnamed") == 0
    assert played.measured("named_but_present") == 0
    assert played.older.broker_restarts or played.measured("lost") == 0


def test_poses_keep_coming(played: Played) -> None:
    """Bridges keep 60 s of them; what a broker had acknowledged and not passed on ends with it (decision 0013)."""
    if played.older.broker_restarts:
        assert played.measured("poses_lost") <= UNDER_WAY_MAX * len(VEHICLES) * TURNS
    else:
        assert played.measured("pose_hz_min") >= POSE_HZ_MIN


def test_what_the_encounter_led_to_goes_after_the_rollback(bare: Platform, played: Played) -> None:
    """Everything is as before the encounter, on the older chart."""
    gone = f"{CLOUD}-{RECORDER}"
    eventually("no task is left", lambda: not bare.access.tasks(), SETTLED_SECONDS_MAX)
    eventually("the recorder is gone", lambda: gone not in bare.access.applications(), SETTLED_SECONDS_MAX)
    eventually("all releases run", bare.settled, SETTLED_SECONDS_MAX)
    assert not recorder_runs(bare)
