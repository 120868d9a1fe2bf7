"""A demand that is withdrawn before its plan was merged leaves nothing on main, and no pull request open."""

from __future__ import annotations

from tests.stages.platform.running_platform import Platform, asleep, eventually
from tests.stages.platform.table_one import Stage

RELEASE = "edge-0/object-detection-vehicle-02"
CLOSED_SECONDS_MAX = 60.0


def test_a_plan_that_nobody_wants_any_more_is_not_merged(platform: Platform, stage: Stage) -> None:
    with platform.forge(platform.scenario.story.person) as forge:

        def open_requests() -> set[int]:
            return {int(one["number"]) for one in forge.get("/pulls", params={"state": "open"}).json()}

        before = open_requests()
        with asleep(platform, "gate"):
            key = stage.submit(
                "cloud-0",
                "withdrawn-early",
                application="object-detection",
                parameters={"sensor": "vehicle-02"},
                placement={"roles": ["edge"]},
            )
            eventually("the plan is proposed", lambda: open_requests() - before)
            stage.withdraw(key)
            eventually("the task is gone", lambda: key not in stage.tasks("cloud-0"))
        eventually("no pull request is left open", lambda: open_requests() <= before, CLOSED_SECONDS_MAX)
    assert RELEASE not in stage.releases()
    named = [commit for commit in stage.commits() if key in commit.trailers.get("Task", ())]
    assert named == []
    assert stage.pods(RELEASE) == []
